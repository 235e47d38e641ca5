"""Read a model from YAML, and say in one line what is wrong with it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import to_json

from imolo.config.yaml_file import MOST_QUOTED, YamlError, load_yaml
from imolo.errors import ConfigError, did_you_mean

AnyModel = TypeVar("AnyModel", bound=BaseModel)

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
    """Return one line that names the first wrong key or value, and the nearest right key."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        known = _keys_beside(model, first["loc"])
        moved = MOVED.get(".".join(str(part) for part in first["loc"][-2:]))
        hint = f"; it is now {moved}" if moved else did_you_mean(str(first["loc"][-1]), known)
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
    others = len(error.errors()) - 1
    return f"{where}: {message}" + (f" (and {others} more)" if others else "")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MOST_QUOTED else f"{text[:MOST_QUOTED]} ..."


def _keys_beside(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys that are known where `location` ends."""
    current: Any = model
    for part in location[:-1]:
        if get_origin(current) is dict:
            current = get_args(current)[1]
            continue
        fields = getattr(current, "model_fields", {})
        if part not in fields:
            return []
        current = fields[part].annotation
    return sorted(getattr(current, "model_fields", {}))
