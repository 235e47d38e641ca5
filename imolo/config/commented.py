"""A config in full, as YAML that says what every setting means: the descriptions of the models beside their values."""

from collections.abc import Iterator, Mapping
from inspect import getdoc
from typing import Any

import yaml
from pydantic import BaseModel

from imolo.config.experiment import ExperimentConfig, PluginConfig
from imolo.config.loading import backend_options, plugin_options, task_options
from imolo.config.model import Model
from imolo.contracts.registry import PLANNERS

WIDTH = 120  # [characters] of a line, from which on a comment stands above
INDENT = "  "


def commented(config: ExperimentConfig) -> str:
    """Return YAML that holds every setting of a config; options of plug-ins that are not chosen stand in comments."""
    lines = _Writer(config).section(config, config.model_dump(mode="json"), "")
    return "\n".join(("# Every setting; what has its default may be deleted.", *lines, ""))


class _Writer:
    """Writes models; what a field means is said where it first stands."""

    def __init__(self, config: ExperimentConfig) -> None:
        self._config = config
        self._told: set[str] = set()

    def section(self, model: BaseModel, content: Mapping[str, Any], margin: str) -> Iterator[str]:
        """Yield the lines of a model: its content as it was dumped, which leaves out what need not be said."""
        for name, value in content.items():
            yield from self._setting(name, getattr(model, name), value, self._about(model, name), margin)
        if isinstance(model, PluginConfig):
            for line in self._options(model):
                yield f"{margin}# {line}"

    def _setting(self, name: str, held: Any, value: Any, about: str, margin: str) -> Iterator[str]:
        models = held if isinstance(held, Mapping) and held and _are_models(held.values()) else {}
        if isinstance(held, BaseModel) or models:
            yield from _with_comment(f"{margin}{name}:", about, margin)
            if isinstance(held, BaseModel):
                yield from self.section(held, value, margin + INDENT)
            for key, each in models.items():
                yield f"{margin}{INDENT}{key}:"
                yield from self.section(each, value[key], margin + 2 * INDENT)
            return
        line = f"{margin}{name}: {_flow(value)}"
        if isinstance(value, list) and (len(line) > WIDTH or _are_models(held)):
            yield from _with_comment(f"{margin}{name}:", about, margin)
            yield from (f"{margin}{INDENT}- {_flow(each)}" for each in value)
        else:
            yield from _with_comment(line, about, margin)

    def _options(self, chosen: PluginConfig) -> Iterator[str]:
        """Yield the options that are not chosen, with the defaults of the plug-in."""
        if chosen is self._config.backend:
            options = backend_options(self._config)
        elif chosen is self._config.task:
            options = task_options(self._config)
        else:
            options = plugin_options(chosen, PLANNERS.load(chosen.name).options, "controller")
        content = options.model_dump(mode="json", exclude=set(chosen.model_extra or {}))
        yield from self.section(options, content, "")

    def _about(self, model: BaseModel, name: str) -> str:
        """Return what a setting means, the first time."""
        field = type(model).model_fields.get(name)
        known = f"{type(model).__module__}.{type(model).__qualname__}.{name}"
        if field is None or known in self._told:
            return ""
        self._told.add(known)
        held = getattr(model, name)
        doc = getdoc(type(held)) or "" if isinstance(held, Model) else ""
        return field.description or doc.partition("\n")[0]


def _are_models(values: Any) -> bool:
    return all(isinstance(value, BaseModel) for value in values)


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, sort_keys=False, width=float("inf"))
    return text.removesuffix("\n").removesuffix("\n...")


def _with_comment(line: str, about: str, margin: str) -> Iterator[str]:
    together = f"{line}  # {about}"
    if about and len(together) > WIDTH:
        yield f"{margin}# {about}"
    yield together if about and len(together) <= WIDTH else line
