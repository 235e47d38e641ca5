"""Parameters of a fit: settings of a config by their path, and how they are scaled for a search.

A path is written as in a config, with points: `simulation.contact.friction`, `simulation.actuators.rest_pressure.7`
(entries of a list count from 0), `backend.impratio`, `robot.links.trunk.mass`. A search sees each parameter between 0
and 1.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError, model_validator

from imolo.config.experiment import ExperimentConfig
from imolo.config.links import link_as_it_is
from imolo.config.loading import backend_options, body_of
from imolo.config.model import Model, Searched
from imolo.config.reading import explain
from imolo.errors import ConfigError, did_you_mean

Array = NDArray[np.float64]
Settings = Mapping[str, float]
Config = TypeVar("Config", bound=Model)

BACKEND = "backend."
LINKS = "robot.links."


class ParameterConfig(Model):
    """What a study says of one parameter; what it leaves out, an option that declares a search range says itself.

    Attributes:
        range: Lowest and highest value.
        scale: Whether steps or ratios of it matter.
        prior: What is believed before, mean and standard deviation; on a log scale the latter is relative.
        start: Where the search begins; the value of the config if not given.
    """

    range: tuple[float, float] | None = None
    scale: Literal["linear", "log"] | None = None
    prior: tuple[float, float] | None = None
    start: float | None = None

    @model_validator(mode="after")
    def _check(self) -> "ParameterConfig":
        if self.range is not None and not self.range[0] < self.range[1]:
            raise ValueError(f"range is {list(self.range)}; give the lower bound first")
        if self.prior is not None and not self.prior[1] > 0:
            raise ValueError(f"the standard deviation of the prior is {self.prior[1]:g}; give a positive one")
        return self


@dataclass(frozen=True)
class Parameter:
    """One parameter of a fit in one engine.

    Attributes:
        path: Of the setting.
        low: Lowest value.
        high: Highest value.
        scale: Whether steps or ratios of it matter.
        start: Where the search begins.
        prior: Mean and standard deviation believed before; None where nothing is.
    """

    path: str
    low: float
    high: float
    scale: Literal["linear", "log"]
    start: float
    prior: tuple[float, float] | None = None

    def to_unit(self, value: float) -> float:
        """Return where a value lies between the bounds, 0 to 1."""
        low, high, value = (self._scaled(one) for one in (self.low, self.high, value))
        return (value - low) / (high - low)

    def from_unit(self, unit: float) -> float:
        """Return the value at a place between the bounds, cut off at them."""
        low, high = self._scaled(self.low), self._scaled(self.high)
        scaled = low + min(max(unit, 0.0), 1.0) * (high - low)
        value = math.exp(scaled) if self.scale == "log" else scaled
        return min(max(value, self.low), self.high)

    def surprise(self, value: float) -> float:
        """Return half the squared distance from the prior in standard deviations; 0 where there is none."""
        if self.prior is None:
            return 0.0
        mean, deviation = self.prior
        off = math.log(value / mean) * mean / deviation if self.scale == "log" else (value - mean) / deviation
        return 0.5 * off**2

    def _scaled(self, value: float) -> float:
        return math.log(value) if self.scale == "log" else value


def to_units(parameters: Sequence[Parameter], settings: Settings) -> Array:
    """Return the place of each parameter between its bounds, shape (n,)."""
    return np.array([parameter.to_unit(settings[parameter.path]) for parameter in parameters])


def from_units(parameters: Sequence[Parameter], units: Array) -> dict[str, float]:
    """Return the settings at places between the bounds, shape (n,)."""
    pairs = zip(parameters, units.tolist(), strict=True)
    return {parameter.path: parameter.from_unit(unit) for parameter, unit in pairs}


def declared(config: Any) -> dict[str, Searched]:
    """Return the settings that declare a search range, by path; entries of lists one by one."""
    return {**dict(_marks(backend_options(config), BACKEND)), **dict(_marks(config.simulation, "simulation."))}


def _marks(model: BaseModel, prefix: str) -> Iterator[tuple[str, Searched]]:
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from _marks(value, f"{prefix}{name}.")
            continue
        # A subclass that gives a setting another default keeps the range.
        kinds = [kind for kind in type(model).__mro__ if issubclass(kind, BaseModel) and name in kind.model_fields]
        fields = [kind.model_fields[name] for kind in kinds]
        whole = next((mark for field in fields for mark in field.metadata if isinstance(mark, Searched)), None)
        entries = get_args(fields[0].annotation)
        for index in range(len(value)) if isinstance(value, tuple) else ():
            own = getattr(entries[index], "__metadata__", ()) if index < len(entries) else ()
            mark = next((mark for mark in own if isinstance(mark, Searched)), whole)
            if mark is not None:
                yield f"{prefix}{name}.{index}", mark
        if whole is not None and not isinstance(value, tuple):
            yield f"{prefix}{name}", whole


def resolve(config: Any, path: str, said: ParameterConfig, options: Mapping[str, Searched]) -> Parameter:
    """Return a parameter of a config with its bounds.

    Args:
        config: Where it is set.
        path: Of the setting.
        said: What the study says.
        options: What the options of the backend declare.

    Raises:
        ConfigError: The setting is unknown or no number, it has no range, or it starts outside of it.
    """
    value = said.start if said.start is not None else read_setting(config, path)
    mark = options.get(path)
    bounds = said.range or ((mark.low, mark.high) if mark else None)
    if bounds is None:
        raise ConfigError(f"parameter {path!r} has no range; give one, such as range: [{0.5 * value:g}, {2 * value:g}]")
    scale = said.scale or (mark.scale if mark else "linear")
    if scale == "log" and bounds[0] <= 0:
        raise ConfigError(f"parameter {path!r} has a log scale from {bounds[0]:g} on; give a positive lower bound")
    if not bounds[0] <= value <= bounds[1]:
        raise ConfigError(
            f"parameter {path!r} starts at {value:g}, outside its range {bounds[0]:g} to {bounds[1]:g}; widen it, or "
            "give a start"
        )
    for bound in bounds:  # a config that refuses a bound would refuse it in mid-search
        apply(config, {path: bound})
    return Parameter(path, bounds[0], bounds[1], scale, value, said.prior)


def read_setting(config: Any, path: str) -> float:
    """Return the number a path leads to.

    Raises:
        ConfigError: It leads to nothing, or to no number.
    """
    place, key = _place(_content(config, [path]), path)
    value = place[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"parameter {path!r} is {value!r}, no number; only numbers can be fitted")
    return float(value)


def apply(config: Config, settings: Settings) -> Config:
    """Return a config with other settings.

    Raises:
        ConfigError: A path leads to nothing, or the config refuses a value.
    """
    content = _content(config, settings)
    for path, value in settings.items():
        place, key = _place(content, path)
        place[key] = value
    where = ", ".join(f"{path} = {value:.6g}" for path, value in settings.items())
    try:
        changed = type(config).model_validate(content)
    except ValidationError as error:
        raise ConfigError(explain(error, type(config), where)) from error
    backend_options(changed)  # type: ignore[arg-type]
    return changed


def patch(settings: Settings, config: Any) -> dict[str, Any]:
    """Return settings as the part of a config that sets them; a list is written whole."""
    content = _content(config, settings)
    result: dict[str, Any] = {}
    for path, value in settings.items():
        *parts, last = path.split(".")
        target, source = result, content
        for part in parts:
            if isinstance(source[part], list):
                target.setdefault(part, list(source[part]))
                target[part][int(last)] = value
                break
            target, source = target.setdefault(part, {}), source[part]
        else:
            target[last] = value
    return result


def _content(config: Any, paths: Iterable[str]) -> dict[str, Any]:
    """Return a config with all options of its backend, and the links that paths lead to as the model says they are."""
    content: dict[str, Any] = config.model_dump(mode="json")
    content["backend"].update(backend_options(config).model_dump(mode="json"))
    if isinstance(config, ExperimentConfig):  # whose dump leaves out what most never set
        content["simulation"]["mocap"]["clock_offset"] = config.simulation.mocap.clock_offset
        links = content["robot"].setdefault("links", {})
        unchanged = body_of(config.robot.model_copy(update={"links": {}})).urdf
        for name in {path.removeprefix(LINKS).split(".")[0] for path in paths if path.startswith(LINKS)}:
            given = {key: value for key, value in links.get(name, {}).items() if value is not None}
            links[name] = {**link_as_it_is(unchanged, name).model_dump(mode="json"), **given}
    return content


def _place(content: Any, path: str) -> tuple[Any, Any]:
    """Return what holds a setting, and its key or index there."""
    parts = path.split(".")
    place = content
    for depth, part in enumerate(parts):
        last = depth == len(parts) - 1
        if isinstance(place, dict) and part in place:
            key: Any = part
        elif isinstance(place, list) and part.isascii() and part.isdigit() and int(part) < len(place):
            key = int(part)
        else:
            known = (
                list(place)
                if isinstance(place, dict)
                else [str(i) for i in range(len(place))]
                if isinstance(place, list)
                else []
            )
            hint = f"{did_you_mean(part, known)}; known: {', '.join(known)}" if known else ""
            raise ConfigError(
                f"parameter {path!r}: there is no {part!r} in {'.'.join(parts[:depth]) or 'the config'}{hint}"
            )
        if last:
            return place, key
        place = place[key]
    raise ConfigError("a parameter has an empty path; name a setting, such as simulation.contact.friction")
