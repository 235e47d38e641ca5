"""Read a model from YAML, and say in one line what is wrong with it."""

from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails, to_json

from imolo.config.yaml_file import MOST_QUOTED, YamlError, load_yaml
from imolo.errors import ConfigError, did_you_mean

AnyModel = TypeVar("AnyModel", bound=BaseModel)
Place = tuple[int | str, ...]

UNKNOWN = "extra_forbidden"  # pydantic's name for a key that is not known

MOVED = {
    "simulation.pneumatics": "simulation.actuators",
    "simulation.pressure_noise": "simulation.actuators.pressure_noise",
    "simulation.pressure_rate": "simulation.sensor_rate",
    "simulation.sole": "robot.sole",
    "robot.hand_marker": "the first of the effectors of the robot's `Body`",
    "robot.other_hand_marker": "the second of the effectors of the robot's `Body`",
    "motion.u_m": "motion.phases[].target",
    "motion.fixed_target": "motion.phases[].target",
    "motion.fixed_switch_time": "motion.phases[].until",
    "motion.u_k": "motion.varied[].direction",
    "motion.k_range": "motion.varied[].range",
    "motion.changed_phase": "motion.varied[].phase",
    "motion.switch_phase": "motion.varied[].phase",
    "grid.k": "grid.parameters.k",
    "grid.t_w": "grid.parameters.t_w",
    "hit.plate_width": "hit.effector_width",
}
"""Where keys of earlier versions are now, by section and name."""


def read_yaml(path: Path, least: str) -> dict[str, Any]:
    """Read the settings of a YAML file.

    Args:
        path: The file.
        least: What to tell the author of a file without any settings.

    Raises:
        ConfigError: The file cannot be read, or holds no settings.
    """
    try:
        content = load_yaml(path)
    except OSError as error:
        raise ConfigError(f"cannot read the config {path}: {error.strerror}") from error
    except YamlError as error:
        raise ConfigError(f"{path} {error}") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{path} holds no settings; {least}")
    return content


def read_model(path: Path, model: type[AnyModel], least: str) -> AnyModel:
    """Read and check a YAML file.

    Args:
        path: The file.
        model: What it must hold.
        least: What to tell the author of a file without any settings.

    Raises:
        ConfigError: The file cannot be read, a key is unknown, or a value is out of range.
    """
    return check_model(read_yaml(path, least), model, str(path))


def check_model(content: Mapping[str, Any], model: type[AnyModel], where: str) -> AnyModel:
    """Return a model of plain values; texts and booleans are no numbers.

    Args:
        content: As `load_yaml` returns it.
        model: What it must hold.
        where: Named in errors.

    Raises:
        ConfigError: A key is unknown, or a value is out of range.
    """
    try:
        # Of JSON a list is a tuple also for pydantic's strict mode.
        return model.model_validate_json(to_json(content), strict=True)
    except ValidationError as error:
        raise ConfigError(explain(error, model, where)) from error


def explain(error: ValidationError, model: type[BaseModel], where: str) -> str:
    """Return one line that names the first wrong key or value, the nearest right key, and how many more there are."""
    mistakes = _mistakes(error, model)
    place, first = next(((at, one) for at, one in mistakes if one["type"] == UNKNOWN), mistakes[0])
    key = ".".join(map(str, place))
    if first["type"] == UNKNOWN:
        known = _known_keys(model, first["loc"])
        moved = MOVED.get(".".join(map(str, place[-2:])))
        hint = f"; it is now {moved}" if moved else did_you_mean(str(place[-1]), known)
        message = f"unknown key {_short(key)}{hint}"
        if known:
            message += f" (known: {', '.join(known)})"
    elif first["type"] == "missing":
        message = f"{key!r} is missing"
    else:
        reason = first["msg"].removeprefix("Value error, ").replace("an object", "a valid dictionary")
        whole = isinstance(first["input"], Mapping) and first["input"]
        value = repr(key) if whole else f"{key!r} is {_short(first['input'])}"
        message = f"{value}: {reason}" if key else reason
        if first["type"] == "bool_type":
            message += "; write true or false"
    others = len(mistakes) - 1
    return f"{where}: {message}" + (f" (and {others} more)" if others else "")


def _mistakes(error: ValidationError, model: type[BaseModel]) -> list[tuple[Place, ErrorDetails]]:
    """Return what the author has to mend, by place; what only follows from another mistake is none.

    A list is too short because its elements are wrong, every branch of a union complains for itself, and a key is
    missing where it was misspelt.
    """
    found: dict[Place, ErrorDetails] = {}
    for each in error.errors():
        found.setdefault(tuple(part for part, _ in _path(model, each["loc"])), each)
    inner = {place for other in found for place in (other[:length] for length in range(len(other)))}
    unknown = [place for place, each in found.items() if each["type"] == UNKNOWN]
    meant = {
        (*place[:-1], *get_close_matches(str(place[-1]), _known_keys(model, found[place]["loc"]), n=1))
        for place in unknown
    }
    return [
        (place, each)
        for place, each in found.items()
        if place not in inner and not (each["type"] == "missing" and place in meant)
    ]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MOST_QUOTED else f"{text[:MOST_QUOTED]} ..."


def _known_keys(model: type[BaseModel], location: Place) -> list[str]:
    """Return the keys that are known where a location ends."""
    path = _path(model, location)
    return sorted(getattr(path[-1][1], "model_fields", {})) if path else []


def _path(model: type[BaseModel], location: Place) -> list[tuple[int | str, Any]]:
    """Return the keys and indices that lead to a location, each beside the type that it is looked up in.

    pydantic's locations name the branches of unions as well, which no author of a file knows.
    """
    path: list[tuple[int | str, Any]] = []
    current: Any = model
    for part in location:
        branches = _branches(current)
        if len(branches) > 1:
            current = next((branch for branch in branches if getattr(branch, "__name__", None) == part), None)
            continue
        current = branches[0] if branches else None
        path.append((part, current))
        arguments = get_args(current)
        if get_origin(current) is dict:
            current = arguments[1]
        elif isinstance(part, int) and arguments:
            current = arguments[0] if arguments[-1] is Ellipsis or part >= len(arguments) else arguments[part]
        else:
            field = getattr(current, "model_fields", {}).get(part)
            current = None if field is None else field.annotation
    return path


def _branches(annotation: Any) -> list[Any]:
    """Return the types that a value may have, without None and what is said about them."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) not in (Union, UnionType):
        return [annotation]
    return [branch for each in get_args(annotation) if each is not NoneType for branch in _branches(each)]
