"""Play one motion in a simulated backend without a bus or a log: what would be seen of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import create_backend
from imolo.contracts.trial import Trial, TrialKind
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import Log
from imolo.method.commands import Commands, to_microseconds
from imolo.method.forward_model import TrainingData
from imolo.trials.recordings import swing_samples
from imolo.trials.trainer import ONSET_DELAY, START_MARGIN
from imolo.trials.trial import SLICE
from imolo_msgs import mocap_frame_t

Array = NDArray[np.float64]

HEARD = (channels.MOCAP, channels.TRUTH_ROBOT, channels.ACTUATOR_STATE)
SELDOM = 1e-3  # [Hz] of what nobody hears


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

    def __init__(self, heard: Sequence[str] = HEARD) -> None:
        self.command: Callable[[Any], None] = lambda _: None
        self.heard: dict[str, list[bytes]] = {name: [] for name in heard}

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


def sample_motion(config: ExperimentConfig, trial: Trial) -> TrainingData:
    """Play a training motion of a config and return the samples (s, t, theta) of Sec. VII-B.

    They are those of the log of the same trial, to the last bit: its chance is the same, and so is its onset, which
    counts from the first frame that is seen.

    Args:
        config: Of the backend.
        trial: Which of the training motions, and the seed.

    Raises:
        BackendError: The backend refuses the scene.
        DivergenceError: The state is no longer finite.
        TrainingDataError: The hand was not seen during the swing.
    """
    unheard = {"sensor_rate": SELDOM, "truth_rate": SELDOM}
    config = config.model_copy(update={"simulation": config.simulation.model_copy(update=unheard)})
    mocap, training, theta = config.simulation.mocap, config.training, config.training.motions[trial.index]
    swing = config.motion.swing_of(theta)
    ear = _Ear((channels.MOCAP,))
    frames = ear.heard[channels.MOCAP]
    backend = create_backend(config)
    backend.start(cast("Bus", ear), trial)
    end = to_microseconds(START_MARGIN + swing + training.sampled_to)
    try:
        while not frames and backend.utime < end:
            backend.advance(min(backend.utime + SLICE, end))
        first = mocap_frame_t.decode(frames[0]) if frames else mocap_frame_t()
        onset = first.utime + to_microseconds(ONSET_DELAY)
        ear.command(config.motion.commands(theta, onset).to_message(first.utime, 1))
        arrival = mocap.latency + abs(mocap.clock_offset) + 2.0 / mocap.rate
        backend.advance(min(onset + to_microseconds(swing + training.sampled_to + arrival), end))
    finally:
        backend.close()
    log = Log(Path(f"training motion {trial.index}, theta {theta}"))
    earliest = onset + to_microseconds(swing + training.sampled_from)
    log.messages[channels.MOCAP] = [mocap_frame_t.decode(data) for data in frames if _utime(data) >= earliest]
    return swing_samples(log, config, theta, onset)


def _utime(data: bytes) -> int:
    """Return the time [µs] that follows the fingerprint of each message of ours."""
    return int.from_bytes(data[8:16], "big", signed=True)


def _seconds(messages: list[Any]) -> Array:
    return np.array([message.utime for message in messages], dtype=np.float64) * 1e-6
