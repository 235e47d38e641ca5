"""What every study says, whatever its recordings are."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from imolo.config.experiment import PluginConfig
from imolo.config.loading import backend_options
from imolo.config.model import Model
from imolo.contracts.registry import ready_simulations
from imolo.errors import ConfigError, did_you_mean
from imolo.identification.evaluation import Bench
from imolo.identification.experiment import Experiment
from imolo.identification.parameters import BACKEND, Parameter, ParameterConfig, declared, resolve


class EngineConfig(PluginConfig):
    """Which engine; every key but these is an option of it.

    Attributes:
        label: What it is called; its name if not given, so that an engine which is there twice needs one.
    """

    label: Annotated[str, Field(pattern=r"^\w[\w .+-]{0,62}$")] | None = None


class StudyConfig(Model):
    """What every study says.

    Attributes:
        kind: Which kind of study this is.
        title: Of the report; the name of the file if not given.
        engines: Names of backends, or name, label and options; every physics engine that is ready if not given.
        parameters: What is fitted, by path of the setting; `backend.…` in the engines that have such an option.
        simplest: Which of them make the simplest fit; the first one if not given.
        declared: Whether all options for which an engine declares a search range are fitted as well.
        training: How many recordings are fitted.
        held_out: How many it is judged on; all others if not given.
        seed: Of the draw of both, and of the search.
        evaluations: How many sets of settings a search may play.
        halve_timestep: Whether to look if the optimum depends on the time step.
    """

    kind: str
    title: str = ""
    engines: tuple[EngineConfig | str, ...] = ()
    parameters: Annotated[dict[str, ParameterConfig], Field(min_length=1)]
    simplest: tuple[str, ...] = ()
    declared: bool = False
    training: Annotated[int, Field(ge=1)] = 50
    held_out: Annotated[int, Field(ge=1)] | None = None
    seed: Annotated[int, Field(ge=0)] = 1
    evaluations: Annotated[int, Field(ge=4)] = 100
    halve_timestep: bool = True

    @abstractmethod
    def experiment(self, folder: Path) -> Experiment:
        """Read and check the recordings; paths are relative to a folder."""

    def prepared(
        self, bench: Bench, engine: str, parameters: list[Parameter], training: Sequence[int]
    ) -> list[Parameter]:
        """Return the parameters with better starts, if the kind of study has a quick way to them."""
        return parameters

    def backends(self) -> dict[str, PluginConfig]:
        """Return the engines to fit, by label.

        Raises:
            ConfigError: Two have the same label.
        """
        found: dict[str, PluginConfig] = {}
        for one in self.engines or tuple(ready_simulations()):
            chosen = EngineConfig(name=one) if isinstance(one, str) else one
            label = chosen.label or chosen.name
            if label in found:
                raise ConfigError(f"two engines are called {label!r}; give one another name with label:")
            found[label] = PluginConfig(name=chosen.name, **(chosen.model_extra or {}))
        return found

    def check_parameters(self, configs: Mapping[str, Any]) -> None:
        """See that every parameter can be fitted, before anything is played.

        Args:
            configs: Of the engines, by label.

        Raises:
            ConfigError: A parameter is unknown, belongs to no engine here, is no number, or has no range.
        """
        options: set[str] = set()
        for config in configs.values():
            self.parameters_of(config)
            options.update(type(backend_options(config)).model_fields)
        for path in self.parameters:
            if path.startswith(BACKEND) and (name := path.split(".")[1]) not in options:
                raise ConfigError(
                    f"parameter {path!r}: no engine of this study has the option {name!r}{did_you_mean(name, options)}"
                )

    def parameters_of(self, config: Any) -> tuple[list[Parameter], list[Parameter]]:
        """Return the parameters of the simplest fit and of the full one, for the engine of a config.

        Raises:
            ConfigError: A parameter is unknown, or has no range.
        """
        options = declared(config)
        own = type(backend_options(config)).model_fields
        said = {
            path: parameter
            for path, parameter in self.parameters.items()
            if not path.startswith(BACKEND) or path.split(".")[1] in own
        }
        if self.declared:
            said |= {path: ParameterConfig() for path in options if path.startswith(BACKEND) and path not in said}
        for name in self.simplest:
            if name not in self.parameters:
                raise ConfigError(
                    f"simplest names {name!r}, which is no parameter{did_you_mean(name, self.parameters)}"
                )
        full = [resolve(config, path, parameter, options) for path, parameter in said.items()]
        chosen = self.simplest or (next(iter(self.parameters)),)
        return [one for one in full if one.path in chosen], full
