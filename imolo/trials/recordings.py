"""What a log says about hand and ball, in the terms of the method; simulation and robot are read alike."""

import logging

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from imolo.ball.flight import Flight, free_flight
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of
from imolo.contracts.robot import Body
from imolo.errors import TrainingDataError
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.method.forward_model import TrainingData
from imolo.method.motion import MotionTemplate, Theta
from imolo_msgs import marker_t, mocap_frame_t, plan_t

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

SHOWN = (channels.MOCAP, channels.PLAN, channels.TRIAL)
"""Channels of a log that say where hand and ball were, and of what motion."""

LINK_SPEED = 12.0  # [m/s] a marker may be this much faster or slower than it was, as when it is thrown or bounces
LINK_TIME = 0.05  # [s] longest gap in a track
SPLINE_REACH = 0.1  # [s] of a marker's track on both sides that is interpolated


def marker_track(log: Log, marker_id: int) -> tuple[Array, Array]:
    """Return time [s], shape (N,), and position [m], shape (N, 3), of a labelled marker in the frames that show it."""
    samples = [
        (frame.utime * 1e-6, marker.marker_position)
        for frame in log.messages[channels.MOCAP]
        for marker in frame.markers
        if marker.marker_id == marker_id
    ]
    if not samples:
        return np.empty(0), np.empty((0, 3))
    return np.array([time for time, _ in samples]), np.array([position for _, position in samples])


def hand_at(log: Log, hand_marker: int, time: float) -> Array | None:
    """Return where the hand was between two frames [m], shape (3,), or None if it was not seen around `time` [s].

    A cubic through the neighbouring frames: at 120 Hz the hand moves 70 mm from one to the next.
    """
    times, positions = marker_track(log, hand_marker)
    near = np.abs(times - time) <= SPLINE_REACH
    times, positions = times[near], positions[near]
    if len(times) < 4 or not times[0] <= time <= times[-1]:
        return None
    return np.asarray(CubicSpline(times, positions)(time))


def last_plan(log: Log) -> plan_t | None:
    """Return the last plan of the motion that was executed; None if none was started."""
    started = [plan for plan in log.messages[channels.PLAN] if plan.plan_onset_utime > 0]
    return started[-1] if started else None


def effector_of(plan: plan_t, body: Body) -> int:
    """Return which effector is to meet the ball; the first one where the plan names none that the robot has."""
    return int(plan.effector) if 0 <= plan.effector < len(body.effectors) else 0


def theta_of(plan: plan_t, motion: MotionTemplate) -> Theta:
    """Return theta; empty where the planner knows none, or one of another motion, which is told."""
    known = len(motion.parameters)
    if len(plan.theta) not in (0, known):
        logger.warning("a PLAN has a theta of %d values, the motion has %d; it is passed over", len(plan.theta), known)
    return tuple(plan.theta) if len(plan.theta) == known else ()


def hand_in_swing(log: Log, config: ExperimentConfig) -> Array | None:
    """Return where the effector was when two backends are compared, `TrainingConfig.comparison_time` [m], shape (3,).

    None if the log has no motion or does not show the hand then.
    """
    plan = last_plan(log)
    if plan is None:
        return None
    swing = plan.plan_onset_utime * 1e-6 + config.motion.swing_of(plan.theta)
    return hand_at(log, body_of(config.robot).learning_marker, swing + config.training.comparison_time)


def hand_samples(log: Log, config: ExperimentConfig) -> TrainingData:
    """Return where the hand was while it could hit, the tuples (s, t, theta) of Sec. VII-B.

    Raises:
        TrainingDataError: The log holds no motion, or the hand was not seen during the swing.
    """
    plan = last_plan(log)
    if plan is None:
        raise TrainingDataError(f"{log.path} holds no motion to learn from")
    return swing_samples(log, config, tuple(plan.theta), plan.plan_onset_utime)


def swing_samples(log: Log, config: ExperimentConfig, theta: Theta, onset_utime: int) -> TrainingData:
    """Return where the hand was while it could hit, in the motion of a theta that began at `onset_utime` [µs].

    Raises:
        TrainingDataError: The hand was not seen during the swing.
    """
    body, training = body_of(config.robot), config.training
    time, position = marker_track(log, body.learning_marker)
    time = time - onset_utime * 1e-6
    since = time - config.motion.swing_of(theta)
    swing = (since > training.sampled_from) & (since < training.sampled_to)
    if not swing.any():
        raise TrainingDataError(
            f"{log.path}: marker {body.learning_marker} ({body.effectors[0].name}) was not seen "
            f"{training.sampled_from} to {training.sampled_to} s after the start of the swing; is it labelled so?"
        )
    return TrainingData(np.tile(theta, (int(swing.sum()), 1)), time[swing], position[swing])


def merge(samples: list[TrainingData]) -> TrainingData:
    """Return the samples of several trials as one set."""
    if not samples:
        raise TrainingDataError("there are no training trials; give at least one motion in training.motions")
    return TrainingData(
        np.concatenate([s.theta for s in samples]),
        np.concatenate([s.time for s in samples]),
        np.concatenate([s.position for s in samples]),
    )


def ball_flight(log: Log) -> Flight:
    """Return the free flight of the ball that a log shows, as measured.

    Raises:
        TrainingDataError: The log shows no flight.
    """
    try:
        return free_flight(*longest_unlabelled_track(log))
    except TrainingDataError as error:
        raise TrainingDataError(f"{log.path}: {error}") from error


def longest_unlabelled_track(log: Log) -> tuple[Array, Array]:
    """Follow every unlabelled marker from frame to frame and return the one that goes furthest.

    It needs no model of the ball, since it serves to learn one: a marker goes on where it would be at constant
    velocity.

    Returns:
        Time [s], shape (N,), and position [m], shape (N, 3); empty if there is no unlabelled marker.
    """
    tracks: list[tuple[list[float], list[Array]]] = []
    for frame in log.messages[channels.MOCAP]:
        time = frame.utime * 1e-6
        unclaimed = [np.array(m.marker_position) for m in frame.markers if m.marker_id == marker_t.UNLABELLED]
        for times, positions in sorted(tracks, key=lambda track: -len(track[0])):
            gap = time - times[-1]
            if not unclaimed or gap > LINK_TIME:
                continue
            expected = positions[-1]
            if len(times) > 1:
                expected = expected + (positions[-1] - positions[-2]) * gap / (times[-1] - times[-2])
            distances = [float(np.linalg.norm(position - expected)) for position in unclaimed]
            if min(distances) <= LINK_SPEED * gap:
                times.append(time)
                positions.append(unclaimed.pop(int(np.argmin(distances))))
        tracks += [([time], [position]) for position in unclaimed]
    if not tracks:
        return np.empty(0), np.empty((0, 3))
    times, positions = max(tracks, key=lambda track: float(np.linalg.norm(np.ptp(track[1], axis=0))))
    return np.array(times), np.array(positions)


def nearest_unlabelled(frame: mocap_frame_t, position: Array, within: float = 0.05) -> Array | None:
    """Return the unlabelled marker of a frame nearest to a position [m], shape (3,); None if none is `within` [m]."""
    unlabelled = [m.marker_position for m in frame.markers if m.marker_id == marker_t.UNLABELLED]
    candidates = np.array(unlabelled).reshape(-1, 3)
    distances = np.linalg.norm(candidates - position, axis=1)
    if not len(distances) or not distances.min() <= within:
        return None
    return np.asarray(candidates[distances.argmin()])
