"""A study of a robot: what is assumed of it, fitted to logs of its motions."""

import fnmatch
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of, make_config
from imolo.config.model import Model, Positive
from imolo.errors import TrainingDataError
from imolo.identification.evaluation import Bench
from imolo.identification.experiment import Experiment, Quantity
from imolo.identification.parameters import Parameter
from imolo.identification.robot_log_checks import read_logs
from imolo.identification.robot_logs import QuantityName, actuators_alone, repeatable, sensor_unit
from imolo.identification.solve import solve
from imolo.identification.study_config import StudyConfig
from imolo.messaging.log import LOG_SUFFIX

SENSOR_SHARE = 0.02  # of a channel's range


class StageConfig(Model):
    """Some parameters that are fitted before all are.

    Attributes:
        parameters: Their paths, or patterns of paths such as `simulation.actuators.*`.
        quantities: What is compared.
        without_engine: Whether the actuators alone are played, their joints led as the markers show them.
    """

    parameters: Annotated[tuple[str, ...], Field(min_length=1)]
    quantities: Annotated[tuple[QuantityName, ...], Field(min_length=1)] = ("sensors",)
    without_engine: bool = False

    @model_validator(mode="after")
    def _actuators_have_sensors_alone(self) -> Self:
        if self.without_engine and self.quantities != ("sensors",):
            raise ValueError("a stage without_engine compares sensors alone; give quantities: [sensors]")
        return self

    def chooses(self, path: str) -> bool:
        """Return whether a parameter is among those of the stage."""
        return any(fnmatch.fnmatchcase(path, pattern) for pattern in self.parameters)


class RobotLogStudy(StudyConfig):
    """A robot's settings, fitted in each engine to logs of `imolo learn`, `compare` or of the robot itself.

    Attributes:
        data: Folder with the logs, looked through to its depth, or one log.
        config: Of the robot, as a config's file; the backend is that of `engines`.
        quantities: What is compared: the effector that learns, all other markers, the actuators' sensors.
        duration: How long after the onset [s]; until the effector can no longer meet a ball if not given.
        marker_scale: An error of this size counts one in the loss [m].
        sensor_scale: Likewise, in the unit of the channels, or in % of their ranges if their units differ; 2 % of their
            range if not given.
        stages: What is fitted first, in this order; each begins where the one before ended.
    """

    kind: Literal["robot_logs"]
    data: Path
    config: dict[str, Any] = Field({})
    quantities: Annotated[tuple[QuantityName, ...], Field(min_length=1)] = ("effector", "markers", "sensors")
    duration: Positive | None = None
    marker_scale: Positive = 0.01
    sensor_scale: Positive | None = None
    stages: tuple[StageConfig, ...] = (StageConfig(parameters=("simulation.actuators.*",), without_engine=True),)

    @model_validator(mode="after")
    def _stages_are_of_this_study(self) -> Self:
        for stage in self.stages if "stages" in self.model_fields_set else ():
            if not any(stage.chooses(path) for path in self.parameters):
                raise ValueError(f"the stage {', '.join(stage.parameters)} has none of the parameters; name one")
            if not set(stage.quantities) <= set(self.quantities):
                raise ValueError(f"a stage compares {', '.join(stage.quantities)}, the study does not; add it there")
        return self

    def experiment(self, folder: Path) -> Experiment:
        """Read and check the logs; paths are relative to a folder."""
        configs = {
            label: repeatable(make_config({**self.config, "backend": backend.model_dump()}, "config"))
            for label, backend in self.backends().items()
        }
        first = next(iter(configs.values()))
        logs, findings = read_logs(self._paths(folder / self.data), first, self.duration, self.quantities)
        digest = hashlib.sha256("".join(log.digest for log in logs).encode()).hexdigest()[:16]
        return Experiment(logs, self._quantities(self.quantities, first), findings, configs, "squared", digest)

    def prepared(
        self, bench: Bench, engine: str, parameters: list[Parameter], training: Sequence[int]
    ) -> list[Parameter]:
        """Return the parameters with starts found stage by stage.

        They are starts alone, no priors: the last fit sees the same recordings again.
        """
        config = bench.experiment.configs[engine]
        for number, stage in enumerate(self.stages, start=1):
            chosen = [one for one in parameters if stage.chooses(one.path)]
            led = all(getattr(log, "markers", None) for log in bench.experiment.recordings)
            if not chosen or not set(stage.quantities) <= set(self.quantities) or (stage.without_engine and not led):
                continue
            start = {one.path: one.start for one in parameters if one not in chosen}
            stage_bench = self._bench(bench, stage, config)
            fit = solve(
                stage_bench, engine, chosen, training, self.evaluations, self.seed, f"stage {number}", fixed=start
            )
            parameters = [replace(one, start=fit.settings.get(one.path, one.start)) for one in parameters]
        return parameters

    def _bench(self, bench: Bench, stage: StageConfig, config: ExperimentConfig) -> Bench:
        whole = bench.experiment
        recordings: list[Any] = list(whole.recordings)
        if stage.without_engine:
            recordings = [actuators_alone(log, body_of(config.robot)) for log in recordings]
        quantities = self._quantities(stage.quantities, config)
        digest = f"{whole.digest} {stage.model_dump_json()}"
        experiment = Experiment(recordings, quantities, (), whole.configs, whole.loss, digest)
        return Bench(experiment, bench.folder, bench.jobs, bench.parallel, bench.progress)

    def _quantities(self, names: Sequence[QuantityName], config: ExperimentConfig) -> tuple[Quantity, ...]:
        channels = config.simulation.actuators.channels
        unit, sizes = sensor_unit(channels)
        spans = [(channel.high - channel.low) / size for channel, size in zip(channels, sizes.tolist(), strict=True)]
        scale = self.sensor_scale or SENSOR_SHARE * max(spans)
        unit, factor = ("kPa", 1e-3) if unit == "Pa" else (unit, 1.0)
        known = {
            "effector": Quantity("effector", "mm", 1e3, self.marker_scale),
            "markers": Quantity("markers", "mm", 1e3, self.marker_scale),
            "sensors": Quantity("sensors", unit, factor, scale),
        }
        return tuple(known[name] for name in names)

    def _paths(self, data: Path) -> list[tuple[str, Path]]:
        if data.is_file():
            return [(data.stem, data)]
        found = sorted(path for path in data.rglob(f"*{LOG_SUFFIX}*") if path.is_file())
        if not found:
            raise TrainingDataError(
                f"{data} holds no {LOG_SUFFIX}; give the folder of `imolo learn` or of a robot's logs"
            )
        return [(str(path.relative_to(data)).replace(LOG_SUFFIX, ""), path) for path in found]
