"""The whole configuration of an experiment: what a YAML file may say, and every default."""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from imolo.ball.model import BallModelConfig
from imolo.ball.tracker import BallTrackerConfig
from imolo.config.model import Model, NonNegative, Positive
from imolo.config.reading import check_model, read_model
from imolo.config.simulation import SimulationConfig
from imolo.contracts.registry import load_backend
from imolo.method.forward_model import GPR, ForwardModelConfig
from imolo.method.motion import TRAINING_MOTIONS, MotionTemplate, Theta
from imolo.method.planner import PlannerConfig
from imolo.method.table import TableGrid

# A name becomes that of a folder.
MethodName = Annotated[str, Field(pattern=r"^\w[\w .+-]{0,62}$")]


class BackendConfig(Model):
    """Which backend; every other key is an option of that backend and checked by it."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str


class RobotConfig(Model):
    """The robot that moves, as far as the method must know it."""

    name: str = Field("liberobot", description="a table learned on another robot is refused")
    hand_marker: int = Field(6, description="mocap label of the hand that is to hit the ball")
    other_hand_marker: int = Field(7, description="of the other one, which `planner.choice: probability` may choose")


class TrainingConfig(Model):
    """How the motions are learned (Sec. VII-B)."""

    motions: Annotated[tuple[Theta, ...], Field(min_length=1)] = TRAINING_MOTIONS
    sampled_from: NonNegative = Field(0.13, description="since t_w, excluded [s], Sec. VII-B")
    sampled_to: NonNegative = Field(0.22, description="since t_w, excluded [s], Sec. VII-B")


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
    balls: Annotated[int, Field(ge=1)] = Field(20, description="to be hit, Sec. VII-B")
    duration: Positive = Field(1.6, description="longest trial with a ball [s]")
    tail: NonNegative = Field(0.05, description="recorded after the ball was hit or has landed [s]")
    parallel: ParallelConfig = ParallelConfig()


class MethodConfig(Model):
    """One way to learn and to plan; the defaults are the paper's."""

    ball_model: BallModelConfig = BallModelConfig()
    forward_model: ForwardModelConfig = ForwardModelConfig()
    grid: TableGrid = TableGrid()
    planner: PlannerConfig = PlannerConfig()


METHODS: dict[str, MethodConfig] = {
    "paper": MethodConfig(),
    "improved": MethodConfig(
        ball_model=BallModelConfig(kind="spin"),
        forward_model=GPR.model_copy(update={"kernel": "matern", "time": "since_swing"}),
        grid=TableGrid(unique="all", match="cell"),
        planner=PlannerConfig(observation_time=0.1, choice="probability"),
    ),
}
"""The paper's method, and the same with drag and lift of the ball, a better regression, a table that answers more
queries, and the choice of the motion that most probably hits, measured beside it."""


class ExperimentConfig(Model):
    """An experiment on one backend."""

    seed: Annotated[int, Field(ge=0)] = 1
    bus: str = Field(
        "memq://", description="LCM URL; memq:// stays in the process and repeats exactly, udpm:// lets lcm-spy watch"
    )
    backend: BackendConfig
    robot: RobotConfig = RobotConfig()
    motion: MotionTemplate = MotionTemplate()
    training: TrainingConfig = TrainingConfig()
    tracker: BallTrackerConfig = BallTrackerConfig()
    methods: Annotated[dict[MethodName, MethodConfig], Field(min_length=1)] = METHODS
    campaign: CampaignConfig = CampaignConfig()
    simulation: SimulationConfig = SimulationConfig()

    def backend_options(self) -> Model:
        """Return the validated options of the backend.

        Raises:
            BackendNotFoundError: The backend is unknown or not installed.
            ConfigError: An option is unknown or out of range.
        """
        plugin = load_backend(self.backend.name)
        return check_model(self.backend.model_extra or {}, plugin.options, f"backend {self.backend.name!r}")

    def digest(self) -> str:
        """Return a short hash of everything that shapes the results."""
        content = self.model_dump(mode="json", exclude={"campaign": {"parallel"}})
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


def load_config(path: Path) -> ExperimentConfig:
    """Read and check a YAML file.

    Raises:
        ConfigError: The file cannot be read, a key is unknown, or a value is out of range.
        BackendNotFoundError: Its backend is unknown or not installed.
    """
    config = read_model(path, ExperimentConfig, "it needs at least a line such as `backend: {name: mujoco}`")
    config.backend_options()
    return config
