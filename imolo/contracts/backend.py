"""What a backend is: a body, simulated or real, that speaks the LCM streams and is the only clock."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from imolo.config.model import Model
from imolo.conformance import Check, Limitation
from imolo.messaging.bus import Bus

if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig


class TrialKind(StrEnum):
    """What a trial is for."""

    THROW = "throw"  # a ball flies past the resting robot, to learn how balls fly
    TRAINING = "training"  # the robot moves without a ball, to learn its motions
    HIT = "hit"  # the robot is to hit a ball


@dataclass(frozen=True)
class Trial:
    """One start of the robot from its ready pose.

    Chance in a trial depends on these three alone, so every backend and every method meets the same balls.
    """

    kind: TrialKind
    index: int
    seed: int

    def generator(self, purpose: str) -> np.random.Generator:
        """Return the random numbers of this trial for one purpose, independent of all other purposes."""
        key = [self.seed, list(TrialKind).index(self.kind), self.index, *purpose.encode()]
        return np.random.default_rng(np.random.SeedSequence(key))


class EventName(StrEnum):
    """What a `trial_event_t` tells."""

    START = "start"
    THROW = "throw"
    ONSET = "onset"
    HIT = "hit"
    BALL_LANDED = "ball_landed"
    ROBOT_LANDED = "robot_landed"
    END = "end"


class Backend(Protocol):
    """Publishes MOCAP, VALVE_PRESSURE and TRIAL events, and executes VALVE_COMMAND; one instance per trial."""

    @property
    def utime(self) -> int:
        """Time of the backend's clock [µs]."""

    def start(self, bus: Bus, trial: Trial) -> None:
        """Bring the robot to its ready pose and join the bus."""

    def advance(self, until_utime: int) -> None:
        """Simulate up to this time, or wait for it [µs].

        Raises:
            DivergenceError: The simulated state is no longer finite.
        """

    def close(self) -> None:
        """Leave the bus and free what the backend holds."""


@dataclass(frozen=True)
class RobotDescription:
    """What a viewer needs to draw the robot of a backend.

    Attributes:
        name: As in the messages on TRIAL.
        urdf: Its model; the base link moves freely.
        joint_names: Joints of the model in the order of TRUTH_ROBOT.
        boxes: Fixed boxes around it: position and side lengths [m], each of shape (3,).
    """

    name: str
    urdf: Path
    joint_names: tuple[str, ...]
    boxes: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()


@dataclass(frozen=True)
class BackendPlugin:
    """What an entry point of the group `imolo.backends` names.

    Attributes:
        summary: One line for `imolo backends`.
        options: Model of the backend's own section of the config.
        create: Makes a backend for one trial from the whole config and the validated options.
        checks: Makes the conformance checks of the backend under these options, for `imolo check`.
        limitations: What it cannot do under its default options.
        ingredients: What can be exchanged in it, for `imolo attribute`: by ingredient, the alternative settings, each
            a set of the backend's options.
        robot: What its robot looks like; None where that is not known.
        simulated: Whether it may be run unasked; a robot moves only for who names its backend.
    """

    summary: str
    options: type[Model]
    create: Callable[["ExperimentConfig", Model], Backend]
    checks: Callable[[Model], Sequence[Check]] = lambda _: ()
    limitations: tuple[Limitation, ...] = ()
    ingredients: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    robot: RobotDescription | None = None
    simulated: bool = True
