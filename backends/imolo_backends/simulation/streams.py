"""The streams of a simulation, packed at once: LCM's generated classes take five times as long for the same bytes."""

import struct
from collections.abc import Callable, Iterator
from functools import partial
from operator import add
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from imolo.contracts.engine import Array, EngineState
from imolo.contracts.robot import Body
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo_msgs import actuator_state_t, mocap_frame_t, truth_ball_t, truth_robot_t

MARKER_SIZE = 28  # [bytes] a `marker_t` within a `mocap_frame_t`
NOISE_BLOCK = 256  # readings whose noise is drawn together


def _packer(message_type: Any, content: str) -> Callable[..., bytes]:
    """Return what packs the fields of a message that begins with its `utime`, see `struct`."""
    return partial(struct.Struct(f">8sq{content}").pack, message_type._get_packed_fingerprint())


_pack_head = _packer(mocap_frame_t, "ii")


def pack_frame(utime: int, frame_number: int, count: int, markers: NDArray[np.uint8]) -> bytes:
    """Return the bytes of a `mocap_frame_t` of the first markers that `put_marker` put."""
    return _pack_head(utime, frame_number, count) + markers[: count * MARKER_SIZE].tobytes()


@njit(cache=True)
def put_marker(out: NDArray[np.uint8], number: int, label: int, place: Array) -> None:
    """Put a `marker_t` at [m], shape (3,), among others, counted from 0; big end first, as LCM has it."""
    at, words = number * MARKER_SIZE, place.view(np.uint64)
    for byte in range(4):
        out[at + byte] = (label >> (24 - 8 * byte)) & 0xFF
    for axis in range(3):
        for byte in range(8):
            out[at + 4 + 8 * axis + byte] = (words[axis] >> np.uint64(56 - 8 * byte)) & np.uint64(0xFF)


class Streams:
    """Says what sensors measure and what is true."""

    def __init__(self, bus: Bus, body: Body, sensor_noise: float, count: int, rng: np.random.Generator) -> None:
        """Prepare for a trial.

        Args:
            bus: Where to say it.
            body: Of the robot.
            sensor_noise: Standard deviation of a channel's sensor, in its unit.
            count: Number of channels.
            rng: Chance of the sensors.
        """
        self._send = bus.publish_raw
        middles = {marker.name: marker for marker in body.markers}
        self._hands = [
            (body.link_of(middles[effector.name]), np.array(middles[effector.name].offset))
            for effector in body.effectors
        ]
        self._noise = _blocks_of_noise(rng, sensor_noise, count)
        self._sequence, self._count = 0, count
        joints, hands = len(body.joint_names), len(self._hands)
        self._sensors = _packer(actuator_state_t, f"ii{count}d")
        self._robot = _packer(truth_robot_t, f"7di{2 * joints}di{3 * hands}d")
        self._ball = _packer(truth_ball_t, "6d")

    def tell_sensors(self, utime: int, measured: Array) -> None:
        """Say what was measured at `utime` [µs], with noise; in the unit of each channel, shape (C,)."""
        self._sequence += 1
        values = map(add, measured.tolist(), next(self._noise))  # of so few numbers quicker than with NumPy
        self._send(channels.ACTUATOR_STATE, self._sensors(utime, self._sequence, self._count, *values))

    def tell_truth(self, utime: int, state: EngineState) -> None:
        """Say where robot and ball are at `utime` [µs]."""
        hands: list[float] = []
        for link, offset in self._hands:
            hands += (state.link_position[link] + state.link_rotation[link].dot(offset)).tolist()
        angle, velocity = state.joint_angle.tolist(), state.joint_velocity.tolist()
        base = *state.link_position[0].tolist(), *state.base_quaternion.tolist()
        data = self._robot(utime, *base, len(angle), *angle, *velocity, len(self._hands), *hands)
        self._send(channels.TRUTH_ROBOT, data)
        ball = *state.ball_position.tolist(), *state.ball_velocity.tolist()
        self._send(channels.TRUTH_BALL, self._ball(utime, *ball))


def _blocks_of_noise(rng: np.random.Generator, deviation: float, count: int) -> Iterator[list[float]]:
    """Yield the noise of one reading after the other, C numbers, as if each were drawn alone."""
    while True:
        yield from rng.normal(0.0, deviation, (NOISE_BLOCK, count)).tolist()
