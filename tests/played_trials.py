"""Short trials on any backend, and hand-made logs."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from liberobot import MOTION
from requirements import BACKEND_PARAMS as BACKEND_PARAMS

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import make_config
from imolo.contracts.planner import Controller
from imolo.contracts.trial import Trial, TrialKind
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import Log, read_log
from imolo.method.motion import Theta
from imolo.trials.trainer import START_MARGIN, MotionPlayer
from imolo.trials.trial import Bystander, run_trial
from imolo_msgs import actuator_command_t, marker_t, mocap_frame_t, plan_t, trial_event_t

COARSE = 5e-4  # [s] for claims that are not about the precision of the physics
UNDISTURBED = {"profile": "none"}
PERFECT_CAMERAS = {"marker_noise": 0.0, "marker_dropout": 0.0, "frame_dropout": 0.0, "unlabelled": 0.0}


def config(
    backend: str,
    timestep: float = COARSE,
    options: Mapping[str, Any] | None = None,
    seed: int = 1,
    robot: Mapping[str, Any] | None = None,
    **simulation: Any,
) -> ExperimentConfig:
    return make_config(
        {
            "seed": seed,
            "backend": {"name": backend, **(options or {})},
            "robot": {"name": "liberobot", **(robot or {})},
            "simulation": {"timestep": timestep, **simulation},
        }
    )


def quiet(
    backend: str,
    timestep: float = COARSE,
    options: Mapping[str, Any] | None = None,
    robot: Mapping[str, Any] | None = None,
    **simulation: Any,
) -> ExperimentConfig:
    """Return a config without any chance that the robot or its markers feel."""
    return config(backend, timestep, options, 1, robot, disturbance=UNDISTURBED, mocap=PERFECT_CAMERAS, **simulation)


def play(
    chosen: ExperimentConfig,
    path: Path,
    controller: Controller | None = None,
    duration: float = 0.3,
    kind: TrialKind = TrialKind.TRAINING,
    index: int = 0,
) -> Log:
    """Run one trial and read its log."""
    run_trial(chosen, Trial(kind, index, chosen.seed), controller or Bystander(), path, duration)
    return read_log(path)


def play_motion(chosen: ExperimentConfig, path: Path, theta: Theta, after: float) -> Log:
    """Run one motion until `after` seconds after the start of its swing."""
    return play(chosen, path, MotionPlayer(chosen.motion, theta), START_MARGIN + chosen.motion.swing_of(theta) + after)


class Commander:
    """Answers chosen mocap frames with made-up commands."""

    def __init__(self, answer: Callable[[mocap_frame_t], actuator_command_t | None]) -> None:
        self._answer = answer

    def attach(self, bus: Bus) -> None:
        def on_frame(frame: mocap_frame_t) -> None:
            message = self._answer(frame)
            if message is not None:
                bus.publish(channels.ACTUATOR_COMMAND, message)

        bus.subscribe(channels.MOCAP, on_frame)


def command(onset_utime: int, theta: Theta = (0.0, 0.3)) -> actuator_command_t:
    return MOTION.commands(theta, onset_utime).to_message(0, 1)


def events(log: Log, name: str) -> list[trial_event_t]:
    return [event for event in log.messages[channels.TRIAL] if event.event == name]


def hand_in_truth(log: Log, utime: int) -> np.ndarray:
    """Return the hand that learns at a time, linear between two messages [m], shape (3,)."""
    truth = log.messages[channels.TRUTH_ROBOT]
    times = [message.utime for message in truth]
    hand = np.array([message.effector_position[0] for message in truth])
    return np.array([np.interp(utime, times, hand[:, axis]) for axis in range(3)])


def mocap(utime: int, number: int, *markers: tuple[int, Any]) -> mocap_frame_t:
    frame = mocap_frame_t()
    frame.utime, frame.frame_number, frame.num_markers = utime, number, len(markers)
    for label, position in markers:
        marker = marker_t()
        marker.marker_id, marker.marker_position = label, [float(value) for value in position]
        frame.markers.append(marker)
    return frame


def event(name: str, utime: int, robot: str = "liberobot", trial: int = 0) -> trial_event_t:
    message = trial_event_t()
    message.utime, message.event, message.robot, message.trial = utime, name, robot, trial
    return message


def plan(utime: int, state: int = plan_t.KEPT, **values: Any) -> plan_t:
    message = plan_t()
    message.utime, message.state = utime, state
    message.num_parameters = len(values.get("theta", ()))
    for name, value in values.items():
        setattr(message, name, value)
    return message
