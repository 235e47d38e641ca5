"""What a task is: the object of a trial, when it ends, and what counts as success.

Success is judged from a log alone, so that a simulation and a robot are judged alike.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from imolo.config.model import Model
from imolo.contracts.engine import Ball
from imolo.contracts.robot import Body
from imolo.contracts.trial import Trial

if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig
    from imolo.messaging.log import Log
    from imolo_msgs import trial_event_t

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Throw:
    """How the ball of a trial is thrown.

    Attributes:
        position: Where it is released [m], shape (3,).
        velocity: With which it is released [m/s], shape (3,).
        release_time: Time since the start of the trial [s].
        lift: Of its spin: l in F = l × v, the force of the air beside the drag [kg/s], shape (3,).
    """

    position: Array
    velocity: Array
    release_time: float
    lift: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Verdict:
    """What became of a trial.

    Attributes:
        success: Whether the task was done.
        measures: Numbers of the task's own beside it, by name with the unit in brackets.
        cause: Why it was not done, where only the task can tell; empty where the causes common to all tasks apply.
    """

    success: bool
    measures: Mapping[str, float] = field(default_factory=dict)
    cause: str = ""


class Task(Protocol):
    """What the robot is to do with the ball; one instance per config."""

    @property
    def ball(self) -> Ball:
        """The ball; its position is set by the throw."""

    def throw(self, trial: Trial) -> Throw:
        """Draw the throw of a trial.

        Raises:
            ConfigError: There is no such throw.
        """

    def drag(self) -> float:
        """Return the force of the air on the ball over the square of its speed, k in F = -k |v| v [kg/m]."""

    def ends(self, event: "trial_event_t") -> bool:
        """Return whether a trial is over with this event."""

    def judge(self, log: "Log", onset_utime: int) -> Verdict:
        """Judge a trial in which a motion was started.

        Args:
            log: Of the trial.
            onset_utime: Onset of the last motion that was planned [µs].
        """


@dataclass(frozen=True)
class TaskPlugin:
    """What an entry point of the group `imolo.tasks` names.

    Attributes:
        summary: One line for `imolo robots`.
        title: Of a comparison, such as "Jump and hit".
        success: What a success is called, such as "hit".
        successes: Several of them.
        options: Model of the config's `task` section.
        create: Makes the task from a config, its validated options and the robot's body.
    """

    summary: str
    title: str
    success: str
    successes: str
    options: type[Model]
    create: "Callable[[ExperimentConfig, Model, Body], Task]"
