"""The task of the paper: hit a thrown ball in the air (Sec. VII)."""

import math

import numpy as np

from imolo.config.experiment import ExperimentConfig
from imolo.config.model import Model
from imolo.contracts.engine import Ball
from imolo.contracts.robot import Body
from imolo.contracts.task import Task, TaskPlugin, Throw, Verdict
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.tasks.thrower import by_hand, drag_of, draw_throw, held_at
from imolo_msgs import trial_event_t

ENDS = (EventName.TOUCH, EventName.BALL_LANDED)


class HitOptions(Model):
    """Nothing can be chosen."""


class HitTask:
    """An effector of the moving robot is to touch the ball before it lands."""

    def __init__(self, config: ExperimentConfig, options: Model, body: Body) -> None:
        """Take ball and thrower from the config."""
        self._config = config.simulation

    @property
    def ball(self) -> Ball:
        """A solid sphere of even density."""
        ball = self._config.ball
        return Ball(ball.radius, ball.mass, 0.4 * ball.mass * ball.radius**2, (0.0, 0.0, 0.0))

    def throw(self, trial: Trial) -> Throw:
        """Draw the throw of a trial; the thrower's positions take turns. In training the ball is held."""
        thrower = self._config.thrower
        if trial.kind is TrialKind.TRAINING:
            return Throw(held_at(thrower, trial.index), np.zeros(3), math.inf)
        if trial.kind is TrialKind.THROW:
            thrower = by_hand(thrower)
        return draw_throw(thrower, self._config.ball, trial.index, trial.generator("throw"))

    def drag(self) -> float:
        """Return k in F = -k |v| v [kg/m]."""
        return drag_of(self._config.ball)

    def ends(self, event: trial_event_t) -> bool:
        """Return whether the ball was touched or has landed."""
        return event.event in ENDS

    def judge(self, log: Log, onset_utime: int) -> Verdict:
        """Return whether an effector touched the ball; one that flies against the resting robot was not hit by it."""
        touches = [event for event in log.messages[channels.TRIAL] if event.event == EventName.TOUCH]
        return Verdict(any(event.utime >= onset_utime for event in touches))


def _create(config: ExperimentConfig, options: Model, body: Body) -> Task:
    return HitTask(config, options, body)


TASK = TaskPlugin("touch a thrown ball before it lands", "Hit", "hit", "hits", HitOptions, _create)
