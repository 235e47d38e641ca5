"""The reference of the configuration, from the models: every key with its type, default, unit and meaning."""

import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Interval, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from imolo.config.experiment import ExperimentConfig
from imolo.contracts.registry import BACKENDS, ROBOTS, TASKS, Registry
from imolo.identification.facts_study import FactsStudy
from imolo.identification.robot_log_study import RobotLogStudy
from imolo.identification.study_file import FreeBodyStudy
from imolo_drivers.board.config import BoardConfig

Model = type[BaseModel]

UNIT = re.compile(r" ?\[([^\]\s]{1,12})\]")
WORDS = {float: "number", int: "integer", str: "text", bool: "true or false", Any: "anything", NoneType: "null"}
LONGEST_DEFAULT = 60  # characters; a longer one is in the model


def page() -> str:
    """Return all keys, by where they are written, as Markdown."""
    seen: set[Model] = set()
    lines = []
    for title, roots in chapters().items():
        lines.append(f"## {title}\n")
        for path, model in roots:
            lines += [line for place, one in models(path, model, seen) for line in _section(place, one)]
    return "\n".join(lines)


def chapters() -> dict[str, list[tuple[str, Model]]]:
    """Return by chapter the models that a file may begin with, and under which key."""
    return {
        "Every config": [("", ExperimentConfig)],
        **{f"Robot {name}": [("", robot.config)] for name, robot in _ready(ROBOTS)},
        "Backends": [(f"backend: {name}", plugin.options) for name, plugin in _ready(BACKENDS)],
        "Tasks": [(f"task: {name}", plugin.options) for name, plugin in _ready(TASKS)],
        "Studies": [(model.__name__, model) for model in (FreeBodyStudy, RobotLogStudy, FactsStudy)],
        "The valve board": [("", BoardConfig)],
    }


def models(path: str, model: Model, seen: set[Model]) -> Iterator[tuple[str, Model]]:
    """Yield a model and those of its keys, each once, with where it is written; mark them as seen."""
    if model in seen:
        return
    seen.add(model)
    yield path, model
    for key, field in model.model_fields.items():
        for inner in _models_in(field.annotation):
            yield from models(f"{path}.{key}".lstrip("."), inner, seen)


def meaning(model: Model, key: str) -> str:
    """Return what a key means: its description, the model's docstring, or what the model that is its value is for."""
    field = model.model_fields[key]
    if field.description:
        return field.description
    for base in model.__mro__:
        found = re.search(rf"^    {key}: (.*(?:\n     +.*)*)", inspect.cleandoc(base.__doc__ or ""), re.MULTILINE)
        if found:
            return " ".join(found[1].split())
    return next((_summary(inner) for inner in _models_in(field.annotation)), "")


def _ready(registry: Registry[Any]) -> list[tuple[str, Any]]:
    found = [(name, registry.status(name).plugin) for name in registry.names()]
    return [(name, plugin) for name, plugin in found if plugin is not None]


def _section(path: str, model: Model) -> Iterator[str]:
    yield f"### {path or model.__name__}\n\n{_summary(model)}\n"
    if not model.model_fields:
        return
    yield "| key | type | default | unit | meaning |\n|---|---|---|---|---|"
    for key, field in model.model_fields.items():
        text = meaning(model, key)
        unit = ", ".join(dict.fromkeys(UNIT.findall(text)))
        cells = (f"`{key}`", kind(field.annotation, field.metadata), _default(field), unit, UNIT.sub("", text))
        yield f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
    yield ""


def _summary(model: Model) -> str:
    return inspect.cleandoc(model.__doc__ or "").split("\n\n")[0].replace("\n", " ")


def _models_in(annotation: Any) -> Iterator[Model]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


def kind(annotation: Any, metadata: Sequence[Any] = ()) -> str:
    """Return in words what a key may hold."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return kind(arguments[0], [*arguments[1:], *metadata])
    if origin is Literal:
        return " or ".join(f"`{value}`" for value in arguments)
    if origin in (Union, UnionType):
        return " or ".join(kind(argument) for argument in arguments)
    if origin in (tuple, list):
        length = "" if Ellipsis in arguments or origin is list else f"{len(arguments)} of "
        return f"list of {length}{kind(arguments[0])}"
    if origin is dict:
        return f"map to {kind(arguments[1])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "section"
    return WORDS.get(annotation, getattr(annotation, "__name__", str(annotation)).lower()) + _bounds(metadata)


def _bounds(metadata: Sequence[Any]) -> str:
    signs = {Gt: (">", "gt"), Ge: ("≥", "ge"), Lt: ("<", "lt"), Le: ("≤", "le")}
    bounds = []
    for item in metadata:
        parts = list(item) if isinstance(item, Interval) else getattr(item, "metadata", [item])
        for part in parts:
            if type(part) in signs:
                sign, name = signs[type(part)]
                bounds.append(f"{sign} {getattr(part, name):g}")
    return f" {' and '.join(bounds)}" if bounds else ""


def _default(field: FieldInfo) -> str:
    value = field.default
    if value is PydanticUndefined:
        return "*required*" if field.is_required() else "*of the others*"
    if isinstance(value, BaseModel):
        return ""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, Mapping) and not value:
        return "`{}`"
    text = re.sub(r"^\((.*?),?\)$", r"[\1]", f"{value:g}" if isinstance(value, float) else str(value))
    return f"`{text}`" if len(text) <= LONGEST_DEFAULT else "*see the model*"
