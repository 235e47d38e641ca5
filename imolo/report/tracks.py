"""What the player shows of a trial: a log's motion, thinned and quantised so that a page holds hundreds of them."""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imolo.contracts.robot import Body
from imolo.contracts.trial import EventName
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.trials.recordings import effector_of, last_plan, marker_track
from imolo_msgs import marker_t, plan_t

Array = NDArray[np.float64]
Packed = dict[str, Any]

RATE = 120.0  # [Hz] of the poses; the page interpolates between them
PLAN_RATE = 60.0  # [Hz]
PATH_STEP = 0.025  # [s] between two points of a predicted path
STEPS = 32767  # on each side of zero: int16
SLACK = 1e-4  # [s] messages are stamped on a grid of 1 ms, so a step may be that much short of the rate's


def trial_tracks(log: Log, body: Body) -> Packed:
    """Return the motion in a log.

    Robot and ball come from the simulation's truth. Where there is none, as from a real robot, the markers and the
    planner's estimate of the ball take its place.

    Args:
        log: Of one trial.
        body: Of the robot, for the markers of its effectors.

    Returns:
        `duration` [s], `events` and, where the log has them, `robot`, `hand`, `ball`, `markers` and `plans`; numbers
        are packed by `pack`. `hand` is the one that was to hit the ball in the end.
    """
    plan = last_plan(log)
    effector = 0 if plan is None else effector_of(plan, body)
    events = [[round(event.utime * 1e-6, 6), event.event] for event in log.messages[channels.TRIAL]]
    tracks: Packed = {"events": events}
    truth = thinned(log.messages[channels.TRUTH_ROBOT], RATE)
    if truth:
        tracks["robot"] = {
            "time": pack(_times(truth)),
            "position": pack([message.base_position for message in truth]),
            "turn": pack(_continuous(np.array([message.base_quaternion for message in truth]))),
            "angle": pack([message.joint_angle for message in truth]),
        }
        hands = [message.effector_position[effector] for message in truth]
        tracks["hand"] = {"time": pack(_times(truth)), "position": pack(hands)}
    elif log.messages[channels.MOCAP]:
        tracks["markers"] = _markers(log)
        seen, hand = marker_track(log, body.effector_marker(effector))
        if len(seen):
            tracks["hand"] = {"time": pack(seen), "position": pack(hand)}
    ball = _ball(log)
    if ball is not None:
        tracks["ball"] = ball
    if log.messages[channels.PLAN]:
        tracks["plans"] = _plans(log)
    last = [messages[-1].utime * 1e-6 for name in SHOWN if (messages := log.messages[name])]
    tracks["duration"] = round(max(last, default=0.0), 6)
    return tracks


SHOWN = (channels.TRIAL, channels.TRUTH_ROBOT, channels.TRUTH_BALL, channels.MOCAP, channels.PLAN)


def thinned(messages: Sequence[Any], rate: float) -> list[Any]:
    """Return the messages at about this rate [Hz] or, where there are fewer, all of them; the last one is kept."""
    kept: list[Any] = []
    for message in messages:
        if not kept or (message.utime - kept[-1].utime) * 1e-6 >= 1.0 / rate - SLACK:
            kept.append(message)
    if kept and kept[-1] is not messages[-1]:
        kept.append(messages[-1])
    return kept


def pack(values: Any) -> Packed:
    """Return numbers as int16 in base64, with the size of a step: the largest of them fills the range.

    The rounding error is half a step; positions within 5 m are kept to 0.08 mm, angles within 150 deg to 0.003 deg.
    """
    array = np.asarray(values, dtype=np.float64)
    largest = float(np.abs(array).max(initial=0.0))
    step = largest / STEPS if largest > 0.0 else 1.0
    data = base64.b64encode(np.round(array / step).astype("<i2").tobytes()).decode("ascii")
    return {"step": step, "columns": array.shape[1] if array.ndim == 2 else 1, "data": data}


def unpack(packed: Packed) -> Array:
    """Return the numbers of `pack`, shape (N,) or (N, columns)."""
    raw = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2") * packed["step"]
    return np.asarray(raw if packed["columns"] == 1 else raw.reshape(-1, packed["columns"]))


def _times(messages: Sequence[Any]) -> list[float]:
    return [message.utime * 1e-6 for message in messages]


def _continuous(turns: Array) -> Array:
    """Choose the signs of quaternions so that neighbours are near, as interpolation needs; shape (N, 4)."""
    flips = np.where((turns[1:] * turns[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    return np.asarray(turns * np.concatenate([[1.0], np.cumprod(flips)])[:, None])


def _ball(log: Log) -> Packed | None:
    truth = thinned(log.messages[channels.TRUTH_BALL], RATE)
    if truth:
        return {"time": pack(_times(truth)), "position": pack([message.true_ball_position for message in truth])}
    seen = thinned(log.messages[channels.BALL_STATE], RATE)
    # An estimate from before the throw or after the landing would be drawn as a ball that is not there.
    ends = [e.utime for e in log.messages[channels.TRIAL] if e.event in (EventName.BALL_LANDED, EventName.TOUCH)]
    seen = [state for state in seen if not ends or state.utime <= ends[-1]]
    if not seen:
        return None
    return {"time": pack(_times(seen)), "position": pack([state.ball_position for state in seen])}


def _markers(log: Log) -> Packed:
    """Return the labelled markers, all frames after each other, and how many each frame shows."""
    frames = thinned(log.messages[channels.MOCAP], RATE)
    shown = [[m.marker_position for m in frame.markers if m.marker_id != marker_t.UNLABELLED] for frame in frames]
    return {
        "time": pack(_times(frames)),
        "count": [len(markers) for markers in shown],
        "position": pack(np.array([position for markers in shown for position in markers]).reshape(-1, 3)),
    }


def _plans(log: Log) -> Packed:
    """Return what the planner meant to do and when: its state, the target, and the predicted path."""
    plans = thinned(log.messages[channels.PLAN], PLAN_RATE)
    paths = [_path(plan) for plan in plans]
    return {
        "time": pack(_times(plans)),
        "state": [plan.state for plan in plans],
        "started": [int(plan.plan_onset_utime > 0) for plan in plans],
        "target": pack([plan.target_position for plan in plans]),
        "due": pack([plan.hit_utime * 1e-6 for plan in plans]),
        "count": [len(path) for path in paths],
        "path": pack(np.concatenate(paths)),
    }


def _path(plan: plan_t) -> Array:
    """Return the predicted path above the floor, shape (N, 3)."""
    path = np.array(plan.predicted_position, dtype=np.float64).reshape(-1, 3)
    path = path[: int(np.argmax(path[:, 2] < 0.0))] if (path[:, 2] < 0.0).any() else path
    return path[:: max(1, round(PATH_STEP / plan.prediction_step))] if len(path) else path
