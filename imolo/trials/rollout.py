"""Play one motion in a simulated backend without a bus, a log or chance: what would be seen of it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import create_backend
from imolo.contracts.trial import Trial, TrialKind
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.method.commands import Commands
from imolo_msgs import actuator_state_t, mocap_frame_t, truth_robot_t

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rollout:
    """What one motion does.

    Attributes:
        time: Of the frames [s], shape (N,).
        markers: By label: position in each frame [m], shape (N, 3); NaN where it was not seen.
        truth_time: Of the joints [s], shape (T,).
        joint_angle: [rad], shape (T, J).
        effector: Position of each effector [m], shape (T, E, 3).
        sensor_time: Of the actuators' sensors [s], shape (S,).
        measured: What they read, in the unit of the channel, shape (S, C).
    """

    time: Array
    markers: dict[int, Array]
    truth_time: Array
    joint_angle: Array
    effector: Array
    sensor_time: Array
    measured: Array


class _Ear:
    """Takes the place of a bus between a backend and nobody: keeps what is published, and hands commands over."""

    def __init__(self) -> None:
        self.command: Callable[[Any], None] = lambda _: None
        self.frames: list[tuple[int, dict[int, tuple[float, ...]]]] = []
        self.truth: list[tuple[int, list[float], list[list[float]]]] = []
        self.sensors: list[tuple[int, list[float]]] = []

    def publish(self, channel: str, message: Any) -> None:
        """Keep what a message says; a backend fills the same one again and again."""
        if channel == channels.MOCAP:
            self._see(message)
        elif channel == channels.TRUTH_ROBOT:
            self._know(message)
        elif channel == channels.ACTUATOR_STATE:
            self._feel(message)

    def subscribe(self, channel: str, handler: Callable[[Any], None]) -> None:
        """Remember who takes commands."""
        if channel == channels.ACTUATOR_COMMAND:
            self.command = handler

    def _see(self, frame: mocap_frame_t) -> None:
        self.frames.append((frame.utime, {m.marker_id: tuple(m.marker_position) for m in frame.markers}))

    def _know(self, truth: truth_robot_t) -> None:
        self.truth.append((truth.utime, truth.joint_angle, truth.effector_position))

    def _feel(self, state: actuator_state_t) -> None:
        self.sensors.append((state.utime, state.measured))


def roll_out(config: ExperimentConfig, commands: Commands, duration: float, seed: int = 0) -> Rollout:
    """Play commands from the ready pose.

    Args:
        config: Of the backend; its disturbance and noise are drawn from `seed`, see `without_chance`.
        commands: Given at the start; their onset tells how long the robot stands before.
        duration: How long it is watched [s].
        seed: Of the chance.

    Raises:
        BackendError: The backend refuses the scene.
        DivergenceError: The state is no longer finite.
    """
    ear = _Ear()
    backend = create_backend(config)
    backend.start(cast("Bus", ear), Trial(TrialKind.TRAINING, 0, seed))
    try:
        ear.command(commands.to_message(0, 1))
        backend.advance(round(duration * 1e6))
    finally:
        backend.close()
    labels = sorted({label for _, markers in ear.frames for label in markers if label >= 0})
    unseen = (np.nan,) * 3
    joints = len(ear.truth[0][1]) if ear.truth else 0
    return Rollout(
        time=_seconds([utime for utime, _ in ear.frames]),
        markers={label: np.array([markers.get(label, unseen) for _, markers in ear.frames]) for label in labels},
        truth_time=_seconds([utime for utime, _, _ in ear.truth]),
        joint_angle=np.array([angle for _, angle, _ in ear.truth]).reshape(len(ear.truth), joints),
        effector=np.array([position for _, _, position in ear.truth]),
        sensor_time=_seconds([utime for utime, _ in ear.sensors]),
        measured=np.array([measured for _, measured in ear.sensors]),
    )


def _seconds(utimes: list[int]) -> Array:
    return np.array(utimes, dtype=np.float64) * 1e-6
