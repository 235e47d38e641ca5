"""Logs of a robot's motions for tests, changed by hand where they are to be bad."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

from played_trials import config, play_motion

from imolo.config.experiment import ExperimentConfig
from imolo.messaging import channels
from imolo.messaging.log import Log

TIMESTEP = 4e-4  # [s]
THETA = (0.5, 0.25)
SEEN = {"latency": 0.0, "marker_noise": 0.0, "marker_dropout": 0.0, "frame_dropout": 0.0, "unlabelled": 0.0}


def robot(engine: str = "mujoco", **simulation: Any) -> ExperimentConfig:
    return config(engine, TIMESTEP, **simulation)


def certain(engine: str = "mujoco", **simulation: Any) -> ExperimentConfig:
    """Return a config without chance that an experiment could see, but for the sensors' noise."""
    mocap = {**SEEN, **simulation.pop("mocap", {})}
    return robot(engine, disturbance={"profile": "none"}, mocap=mocap, **simulation)


def recorded(chosen: ExperimentConfig, path: Path) -> Log:
    return play_motion(chosen, path, THETA, chosen.training.sampled_to)


def changed(log: Log, channel: str, change: Callable[[Any], None]) -> Log:
    """Return a log in which every message of a channel is changed."""
    messages = {**log.messages, channel: copy.deepcopy(log.messages[channel])}
    for message in messages[channel]:
        change(message)
    return Log(log.path, messages, log.received)


def without(log: Log, channel: str) -> Log:
    return Log(log.path, {**log.messages, channel: []}, log.received)


def scale_markers(factor: float) -> Callable[[Any], None]:
    def change(frame: Any) -> None:
        for marker in frame.markers:
            marker.marker_position = [factor * value for value in marker.marker_position]

    return change


def scale_sensors(factor: float, offset: float = 0.0) -> Callable[[Any], None]:
    def change(state: Any) -> None:
        state.measured = [factor * value + offset for value in state.measured]

    return change


def drop_marker(label: int) -> Callable[[Any], None]:
    def change(frame: Any) -> None:
        frame.markers = [marker for marker in frame.markers if marker.marker_id != label]
        frame.num_markers = len(frame.markers)

    return change


def frames_between(log: Log, start: int, stop: int) -> Log:
    """Return a log without the frames in a time [µs]."""
    frames = [frame for frame in log.messages[channels.MOCAP] if not start < frame.utime < stop]
    return Log(log.path, {**log.messages, channels.MOCAP: frames}, log.received)
