"""The whole configuration of an experiment: what a YAML file may say."""

import hashlib
import json
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, SerializeAsAny, model_validator

from imolo.ball.model import BallModelConfig
from imolo.ball.tracker import BallTrackerConfig
from imolo.config.links import LinkConfig
from imolo.config.model import Model, NonNegative, Positive
from imolo.config.simulation import SimulationConfig
from imolo.errors import ConfigError
from imolo.method.forward_model import ForwardModelConfig
from imolo.method.motion import MotionTemplate, Theta
from imolo.method.planner import PlannerConfig
from imolo.method.table_grid import TableGrid

# A name becomes that of a folder.
MethodName = Annotated[str, Field(pattern=r"^\w[\w .+-]{0,62}$")]


class PluginConfig(Model):
    """Which plug-in; every other key is an option of that plug-in."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str = Field(description="of the plug-in, as `imolo backends` and `imolo robots` list it")


class RobotConfig(Model):
    """Which robot; a robot may have options of its own."""

    name: str = Field(description="a table learned on another robot is refused")
    links: dict[str, LinkConfig] = Field(
        {}, description="masses and centres of mass that differ from the model's", exclude_if=lambda links: not links
    )

    def __hash__(self) -> int:
        """Make `body_of` find what it made before, though a dictionary has no hash."""
        return hash(self.model_dump_json())


class TrainingConfig(Model):
    """How the motions are learned (Sec. VII-B)."""

    motions: Annotated[tuple[Theta, ...], Field(min_length=1)] = Field(description="theta of each, in SI units")
    sampled_from: NonNegative = Field(description="since the start of the swing, excluded [s]")
    sampled_to: NonNegative = Field(description="since the start of the swing, excluded [s]")

    compared_at: NonNegative | None = Field(
        None, description="when in the swing two backends are compared [s]; in the middle of the samples if not given"
    )

    @property
    def comparison_time(self) -> float:
        """When in the swing two backends are compared, since its start [s]."""
        return 0.5 * (self.sampled_from + self.sampled_to) if self.compared_at is None else self.compared_at


class ParallelConfig(Model):
    """Where trials run; it shapes no result."""

    backend: Literal["loky", "dask"] = Field("loky", description="processes of this machine, or workers of a cluster")
    address: str = Field("tcp://127.0.0.1:8786", description="of the Dask scheduler")
    retries: Annotated[int, Field(ge=0)] = Field(
        2, description="of a trial whose process died; on a cluster the scheduler's `allowed-failures` counts"
    )


class CampaignConfig(Model):
    """How many balls, how long a trial lasts, and where it runs."""

    learning_throws: Annotated[int, Field(ge=3)] = Field(10, description="to learn how balls fly, Sec. V-C")
    balls: Annotated[int, Field(ge=1, lt=2**31)] = Field(20, description="to be hit, Sec. VII-B")
    duration: Positive = Field(1.6, description="longest trial with a ball [s]")
    tail: NonNegative = Field(0.05, description="recorded after the ball was hit or has landed [s]")
    parallel: ParallelConfig = ParallelConfig()


class MethodConfig(Model):
    """One way to learn and to plan."""

    ball_model: BallModelConfig = BallModelConfig()
    forward_model: ForwardModelConfig = ForwardModelConfig()
    grid: TableGrid
    planner: PlannerConfig = PlannerConfig()
    controller: PluginConfig = Field(
        PluginConfig(name="imolo"), description="what plans; `planner` holds the settings of IMoLo's own"
    )


class ExperimentConfig(Model):
    """An experiment on one backend; a robot has a subclass with its own kinds of motion and actuators."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(1, description="of everything that is drawn by chance")
    bus: str = Field(
        "memq://", description="LCM URL; memq:// stays in the process and repeats exactly, udpm:// lets lcm-spy watch"
    )
    backend: PluginConfig
    robot: SerializeAsAny[RobotConfig]
    task: PluginConfig
    motion: SerializeAsAny[MotionTemplate]
    training: TrainingConfig
    tracker: BallTrackerConfig = BallTrackerConfig()
    methods: Annotated[dict[MethodName, MethodConfig], Field(min_length=1)]
    campaign: CampaignConfig = CampaignConfig()
    simulation: SimulationConfig

    @model_validator(mode="after")
    def _parts_fit(self) -> Self:
        try:
            for method in self.methods.values():
                method.grid.check(self.motion)
            for theta in self.training.motions:
                self.motion.commands(theta, 0)
        except ConfigError as error:
            raise ValueError(str(error)) from error
        channels = self.simulation.actuators.channels
        for phase in self.motion.commands(self.training.motions[0], 0).targets:
            if len(phase) != len(channels):
                raise ValueError(
                    f"the motion commands {len(phase)} channels, the actuators have {len(channels)}; "
                    f"give every phase {len(channels)} targets"
                )
        return self

    @property
    def last_method(self) -> MethodConfig:
        """The method that pictures and studies show, where they show one."""
        return list(self.methods.values())[-1]

    def digest(self) -> str:
        """Return a short hash of everything that shapes the results."""
        content = self.model_dump(mode="json", exclude={"campaign": {"parallel"}})
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
