"""The streams of a simulation, packed at once: LCM's generated classes take five times as long for the same bytes."""

import struct
from collections.abc import Iterator

import numpy as np

from imolo.contracts.engine import Array, EngineState
from imolo.contracts.robot import Body
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo_msgs import actuator_state_t, mocap_frame_t, truth_ball_t, truth_robot_t

MARKER = np.dtype([("marker_id", ">i4"), ("marker_position", ">f8", 3)])
"""A `marker_t` within a `mocap_frame_t`."""

NOISE_BLOCK = 256  # readings whose noise is drawn together

_FRAME = struct.Struct(">8sqii")


def pack_frame(utime: int, frame_number: int, markers: np.ndarray[tuple[int], np.dtype[np.void]]) -> bytes:
    """Return the bytes of a `mocap_frame_t` of an array of `MARKER`."""
    head = _FRAME.pack(mocap_frame_t._get_packed_fingerprint(), utime, frame_number, len(markers))
    return head + markers.tobytes()


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
        self._bus = bus
        middles = {marker.name: marker for marker in body.markers}
        self._hands = [
            (body.link_of(middles[effector.name]), np.array(middles[effector.name].offset))
            for effector in body.effectors
        ]
        self._noise = _blocks_of_noise(rng, sensor_noise, count)
        self._sequence, self._count = 0, count
        joints, hands = len(body.joint_names), len(self._hands)
        self._sensors = struct.Struct(f">8sqii{count}d")
        self._robot = struct.Struct(f">8sq7di{2 * joints}di{3 * hands}d")
        self._ball = struct.Struct(">8sq6d")

    def tell_sensors(self, utime: int, measured: Array) -> None:
        """Say what was measured at `utime` [µs], with noise; in the unit of each channel, shape (C,)."""
        self._sequence += 1
        values = (measured + next(self._noise)).tolist()
        fingerprint = actuator_state_t._get_packed_fingerprint()
        data = self._sensors.pack(fingerprint, utime, self._sequence, self._count, *values)
        self._bus.publish_raw(channels.ACTUATOR_STATE, data)

    def tell_truth(self, utime: int, state: EngineState) -> None:
        """Say where robot and ball are at `utime` [µs]."""
        hands: list[float] = []
        for link, offset in self._hands:
            hands += (state.link_position[link] + state.link_rotation[link].dot(offset)).tolist()
        data = self._robot.pack(
            truth_robot_t._get_packed_fingerprint(),
            utime,
            *state.link_position[0].tolist(),
            *state.base_quaternion.tolist(),
            len(state.joint_angle),
            *state.joint_angle.tolist(),
            *state.joint_velocity.tolist(),
            len(self._hands),
            *hands,
        )
        self._bus.publish_raw(channels.TRUTH_ROBOT, data)
        ball = (*state.ball_position.tolist(), *state.ball_velocity.tolist())
        self._bus.publish_raw(
            channels.TRUTH_BALL, self._ball.pack(truth_ball_t._get_packed_fingerprint(), utime, *ball)
        )


def _blocks_of_noise(rng: np.random.Generator, deviation: float, count: int) -> Iterator[Array]:
    """Yield the noise of one reading after the other, shape (C,), as if each were drawn alone."""
    while True:
        yield from rng.normal(0.0, deviation, (NOISE_BLOCK, count))
