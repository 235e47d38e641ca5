"""Why a ball was missed, from what planner, cameras and robot said in the log; simulation truth is not looked at.

A miss has one cause, the first of these that holds:

* ball not seen: the tracker never followed the ball, or it was out of sight when the hand was to meet it.
* late start, without a motion: the first predicted path that passed grid points of the table, of those after which the
  planner might start, had the ball at every one of them sooner than the fastest motion there. Without the table at
  hand: the ball ended sooner than the fastest motion of the grid. Or the ball was gone before the planner might start.
* no table entry: any other ball without a motion.
* late start, with a motion: it began more than Δt/2, the table's tolerance in time, after the onset it was planned for.
* hand error: at the planned time of the hit the hand was at least as far from the selected grid point as the ball.
* update impossible: the ball was farther, and at the last frame that could still change theta, its path already
  missed the selected grid point by more than half the width of plate and ball, and no tuple that shares the executed
  part led elsewhere. Without a theta of the template this is not told.
* prediction error: the ball was farther, but the planner learned of it when nothing could be changed any more.
"""

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from imolo.config.experiment import ExperimentConfig, MethodConfig
from imolo.config.loading import body_of
from imolo.contracts.trial import EventName
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.method.motion import MotionTemplate
from imolo.method.table import LookupTable
from imolo.trials.recordings import LINK_TIME, last_plan, nearest_unlabelled, theta_of
from imolo_msgs import plan_t

Array = NDArray[np.float64]

NO_BALL = (np.empty(0, dtype=np.int64), np.empty((0, 3)))


class Cause(StrEnum):
    """Why a ball was missed; defined at the top of this file."""

    NO_ENTRY = "no table entry"
    PREDICTION = "prediction error"
    HAND = "hand error"
    LATE = "late start"
    UPDATE = "update impossible"
    UNSEEN = "ball not seen"


def find_cause(
    log: Log,
    config: ExperimentConfig,
    method: MethodConfig,
    table: LookupTable | None,
    hand_error: float | None,
    ball_error: float | None,
) -> Cause:
    """Name the cause of a miss.

    Args:
        log: Of the trial.
        config: Of the experiment.
        method: That planned.
        table: That it planned with; without it a late start is told from the fastest motion of the grid alone.
        hand_error: Distance between the selected grid point and the hand at the planned time [m], if seen.
        ball_error: The same for the ball [m].
    """
    plan = last_plan(log)
    if plan is None:
        return _cause_of_no_motion(log, config, method, table)
    if _start_delay(log, plan) > 0.5 * method.grid.time_tolerance:
        return Cause.LATE
    touching = 0.5 * body_of(config.robot).effectors[0].width + config.simulation.ball.radius
    if ball_error is None:
        return Cause.HAND if hand_error is not None and hand_error > touching else Cause.UNSEEN
    if hand_error is not None and hand_error >= ball_error:
        return Cause.HAND
    known = _known_miss(log, method, config.motion)
    if known is not None and known > touching:
        return Cause.UPDATE
    return Cause.PREDICTION


def ball_track(log: Log) -> tuple[NDArray[np.int64], Array]:
    """Return when the flying ball was seen [µs], shape (N,), and where [m], shape (N, 3), as measured.

    The measurements are those the tracker took for the ball, up to the first touch or the landing.
    """
    frames = {frame.utime: frame for frame in log.messages[channels.MOCAP]}
    ended = _end(log)
    seen = []
    for state in log.messages[channels.BALL_STATE]:
        if state.utime in frames and (ended is None or state.utime <= ended):
            position = nearest_unlabelled(frames[state.utime], np.array(state.ball_position))
            if position is not None:
                seen.append((state.utime, position))
    if not seen:
        return NO_BALL
    return np.array([utime for utime, _ in seen]), np.array([position for _, position in seen])


def distance_of_ball(log: Log, plan: plan_t) -> float | None:
    """Return how far the ball was from the selected grid point when the hand was to be there [m].

    Linear between two frames; a ball that had landed by then counts from where it was last seen. None if it was out of
    sight.
    """
    utime, position = ball_track(log)
    if not len(utime):
        return None
    ended = _end(log)
    wanted = plan.hit_utime if ended is None else min(plan.hit_utime, ended)
    if np.abs(utime - wanted).min() > LINK_TIME * 1e6:
        return None
    ball = np.array([np.interp(wanted, utime, position[:, axis]) for axis in range(3)])
    return float(np.linalg.norm(ball - np.array(plan.target_position)))


def throw_position(log: Log, config: ExperimentConfig) -> int | None:
    """Return which of the thrower's positions the ball came from: the nearest to where it was first seen."""
    _, position = ball_track(log)
    if not len(position):
        return None
    places = np.array(config.simulation.thrower.positions)
    return int(np.linalg.norm(places - position[0], axis=1).argmin())


def _end(log: Log) -> int | None:
    ends = (EventName.TOUCH, EventName.BALL_LANDED)
    return next((event.utime for event in log.messages[channels.TRIAL] if event.event in ends), None)


def _cause_of_no_motion(log: Log, config: ExperimentConfig, method: MethodConfig, table: LookupTable | None) -> Cause:
    predicted = [plan for plan in log.messages[channels.PLAN] if plan.num_predictions]
    if not predicted:
        return Cause.UNSEEN
    allowed = predicted[0].utime + method.planner.observation_time * 1e6
    asked = [plan for plan in predicted if plan.utime >= allowed]
    if not asked:
        return Cause.LATE
    tolerance = 0.5 * method.grid.time_tolerance
    if table is not None:
        lateness = next(filter(len, (_lateness(plan, method, table) for plan in asked)), ())
        return Cause.LATE if lateness and min(lateness) > tolerance else Cause.NO_ENTRY
    ended = _end(log)
    end = predicted[-1].utime if ended is None else ended
    left = (end - asked[0].utime) * 1e-6 - method.planner.lead_time
    lowest, _ = method.grid.bounds(config.motion)
    shortest = config.motion.swing_of(lowest.tolist()) + method.grid.time_since_swing.start
    return Cause.LATE if shortest - left > tolerance else Cause.NO_ENTRY


def _lateness(plan: plan_t, method: MethodConfig, table: LookupTable) -> tuple[float, ...]:
    """Return by how much the fastest motion to each stored grid point of a predicted path comes after the ball [s]."""
    path, times = _path(plan)
    since_onset = times - method.planner.lead_time
    entries = ((table.times_at(point), time) for point, time in zip(path, since_onset, strict=True))
    return tuple(float(found.min() - time) for found, time in entries if len(found))


def _start_delay(log: Log, plan: plan_t) -> float:
    """Return how much later than planned the motion began [s]: by its event, or by the first command on the bus."""
    onset = next((event.utime for event in log.messages[channels.TRIAL] if event.event == EventName.ONSET), None)
    if onset is None:
        onset = next(iter(log.received[channels.ACTUATOR_COMMAND]), plan.plan_onset_utime)
    return float(onset - plan.plan_onset_utime) * 1e-6


def _known_miss(log: Log, method: MethodConfig, motion: MotionTemplate) -> float | None:
    """Return by how much the predicted path missed the selected grid point when theta could last be changed [m]."""
    if not method.planner.update:
        return None
    lead = method.planner.lead_time * 1e6
    changeable = [
        plan
        for plan in log.messages[channels.PLAN]
        if plan.plan_onset_utime > 0
        and plan.num_predictions
        and (theta := theta_of(plan, motion))
        and plan.utime + lead < plan.plan_onset_utime + motion.last_change(theta) * 1e6
    ]
    if not changeable:
        return None
    plan = changeable[-1]
    path, times = _path(plan)
    ahead = (plan.hit_utime - plan.utime) * 1e-6
    if not times[0] <= ahead <= times[-1]:
        return None
    ball = np.array([np.interp(ahead, times, path[:, axis]) for axis in range(3)])
    return float(np.linalg.norm(ball - np.array(plan.target_position)))


def _path(plan: plan_t) -> tuple[Array, Array]:
    """Return the predicted positions of a plan [m], shape (N, 3), and how far ahead each is [s], shape (N,)."""
    path = np.array(plan.predicted_position, dtype=np.float64)
    return path, plan.prediction_step * np.arange(1, len(path) + 1)
