"""What a trial is, and what can happen in it."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np


class TrialKind(StrEnum):
    """What a trial is for."""

    THROW = "throw"  # a ball flies past the resting robot, to learn how balls fly
    TRAINING = "training"  # the robot moves without a ball, to learn its motions
    HIT = "hit"  # the robot is to meet a ball: to hit it, to catch it


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
    TOUCH = "touch"  # an effector has touched the ball
    BALL_LANDED = "ball_landed"
    ROBOT_LANDED = "robot_landed"
    END = "end"
