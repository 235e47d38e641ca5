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

Array = NDArray[np.float64]

HEARD = (channels.MOCAP, channels.TRUTH_ROBOT, channels.ACTUATOR_STATE)


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
        self.heard: dict[str, list[bytes]] = {name: [] for name in HEARD}

    def publish_raw(self, channel: str, data: bytes) -> None:
        """Keep a message."""
        if channel in self.heard:
            self.heard[channel].append(data)

    def publish(self, channel: str, message: Any) -> None:
        """Keep a message; a backend fills the same one again and again."""
        self.publish_raw(channel, message.encode())

    def subscribe(self, channel: str, handler: Callable[[Any], None]) -> None:
        """Remember who takes commands."""
        if channel == channels.ACTUATOR_COMMAND:
            self.command = handler

    def messages(self, channel: str) -> list[Any]:
        """Return what was published on a channel."""
        decode = channels.CHANNELS[channel].message_type.decode
        return [decode(data) for data in self.heard[channel]]


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
    frames, truth, sensors = (ear.messages(channel) for channel in HEARD)
    seen = [{marker.marker_id: marker.marker_position for marker in frame.markers} for frame in frames]
    labels = sorted({label for markers in seen for label in markers if label >= 0})
    unseen = (np.nan,) * 3
    return Rollout(
        time=_seconds(frames),
        markers={label: np.array([markers.get(label, unseen) for markers in seen]) for label in labels},
        truth_time=_seconds(truth),
        joint_angle=np.array([one.joint_angle for one in truth]),
        effector=np.array([one.effector_position for one in truth]),
        sensor_time=_seconds(sensors),
        measured=np.array([one.measured for one in sensors]),
    )


def _seconds(messages: list[Any]) -> Array:
    return np.array([message.utime for message in messages], dtype=np.float64) * 1e-6
