"""What a study's YAML file may say."""

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from imolo.config.experiment import PluginConfig
from imolo.config.loading import backend_options
from imolo.config.model import Model, Positive
from imolo.config.reading import check_model, read_yaml
from imolo.contracts.registry import ready_simulations
from imolo.contracts.urdf import read_urdf
from imolo.errors import ConfigError, TrainingDataError, did_you_mean
from imolo.identification.experiment import Experiment, Quantity
from imolo.identification.facts_study import FactsStudy
from imolo.identification.free_body import (
    BodyConfig,
    FreeBodyConfig,
    FreeBodySimulation,
    as_metres,
    digest,
    read_tosses,
)
from imolo.identification.free_body_checks import check_tosses, start_from_flight
from imolo.identification.parameters import (
    BACKEND,
    Parameter,
    ParameterConfig,
    declared,
    resolve,
)

LEAST = "it needs at least kind, data, body and parameters"


class EngineConfig(PluginConfig):
    """Which engine; every key but these is an option of it.

    Attributes:
        label: What it is called; its name if not given, so that an engine which is there twice needs one.
    """

    label: Annotated[str, Field(pattern=r"^\w[\w .+-]{0,62}$")] | None = None


class StudyConfig(Model):
    """What every study says.

    Attributes:
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
            said |= {path: ParameterConfig() for path in options if path not in said}
        for name in self.simplest:
            if name not in self.parameters:
                raise ConfigError(
                    f"simplest names {name!r}, which is no parameter{did_you_mean(name, self.parameters)}"
                )
        full = [resolve(config, path, parameter, options) for path, parameter in said.items()]
        chosen = self.simplest or (next(iter(self.parameters)),)
        return [one for one in full if one.path in chosen], full


class FreeBodyStudy(StudyConfig):
    """Engines fitted to recordings of a body that flies, hits the floor and comes to rest.

    Attributes:
        data: CSV of the recordings, see `read_tosses`.
        held_out_data: CSV of further recordings, on which alone the fits are judged.
        body: The body.
        simulation: What surrounds it.
        length_factor: Lengths of the recordings are multiplied by it; the check of the data says by what.
        start: Whether a toss starts as its first frame says, or as its frames in the air do.
        position_scale: An error of this size counts one in the loss [m]; the longest side of a box if not given.
        rotation_scale: Likewise [rad].
    """

    kind: Literal["free_body"]
    data: Path
    held_out_data: Path | None = None
    body: BodyConfig
    simulation: FreeBodySimulation = FreeBodySimulation()
    length_factor: Positive = 1.0
    start: Literal["recorded", "flight"] = "recorded"
    position_scale: Positive | None = None
    rotation_scale: Positive = 1.0

    def experiment(self, folder: Path) -> Experiment:
        """Read and check the recordings; paths are relative to a folder."""
        body = self.body
        if body.urdf is not None:
            urdf = folder / body.urdf
            _check_body(urdf)
            body = body.model_copy(update={"urdf": urdf})
        tosses = read_tosses(folder / self.data)
        fitted = len(tosses)
        if self.held_out_data is not None:
            tosses += read_tosses(folder / self.held_out_data)
            names = [toss.name for toss in tosses]
            if both := sorted(set(names[:fitted]) & set(names[fitted:])):
                raise TrainingDataError(f"toss {both[0]!r} is in data and in held_out_data; leave it out of one")
        tosses = [as_metres(toss, self.length_factor) for toss in tosses]
        cube = body.sides is not None and len(set(body.sides)) == 1
        resting = 0.5 * body.sides[0] if cube and body.sides else None
        findings = check_tosses(tosses, body, resting, self.simulation.gravity)
        if self.start == "flight":
            tosses = [start_from_flight(toss, body) for toss in tosses]
        size = self.position_scale or (max(body.sides) if body.sides else 0.1)
        quantities = (
            Quantity("position", "% of size", 100.0 / size, size),
            Quantity("rotation", "deg", 57.29577951308232, self.rotation_scale),
        )
        configs = {
            label: FreeBodyConfig(backend=backend, simulation=self.simulation, body=body)
            for label, backend in self.backends().items()
        }
        apart = range(fitted, len(tosses))
        return Experiment(tosses, quantities, findings, configs, "absolute", digest(tosses, body.urdf), apart)


def _check_body(urdf: Path) -> None:
    model = read_urdf(urdf)
    if len(model.links) != 1 or not model.links[model.base].collisions:
        raise ConfigError(f"{urdf} has {len(model.links)} links; a free body is one link with a collision shape")


KINDS: dict[str, type[StudyConfig] | type[FactsStudy]] = {"free_body": FreeBodyStudy, "facts": FactsStudy}


def load_study(path: Path) -> StudyConfig | FactsStudy:
    """Read and check a study's file.

    Raises:
        ConfigError: The file cannot be read, a key is unknown, or a value is out of range.
    """
    content = read_yaml(path, LEAST)
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        hint = did_you_mean(str(kind), KINDS)
        raise ConfigError(f"{path}: kind is {kind!r}{hint}; give one of: {', '.join(KINDS)}")
    return check_model(content, KINDS[kind], str(path))
