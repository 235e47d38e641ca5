"""The streams are packed without LCM's classes: these must read the same from them and write the same bytes."""

import numpy as np
import pytest
from liberobot import BODY

from imolo.contracts.engine import EngineState
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo_backends.simulation.streams import MARKER_SIZE, Streams, pack_frame, put_marker
from imolo_msgs import actuator_state_t, mocap_frame_t, truth_ball_t, truth_robot_t

UTIME = 1234567
CHANNELS = 8


@pytest.fixture(scope="module")
def state() -> EngineState:
    rng = np.random.default_rng(0)
    joints, links = len(BODY.joint_names), len(BODY.link_names)
    shapes = ((joints,), (joints,), (links, 3), (links, 3, 3), (4,), (3,), (3,))
    return EngineState(0.0, *map(rng.standard_normal, shapes))


def sent(state: EngineState, noise: float = 0.0) -> dict[str, bytes]:
    bus = Bus()
    heard: dict[str, bytes] = {}
    bus.subscribe_raw(heard.__setitem__)
    streams = Streams(bus, BODY, noise, CHANNELS, np.random.default_rng(3))
    streams.tell_truth(UTIME, state)
    for _ in range(300):  # more than are drawn together
        streams.tell_sensors(UTIME, np.arange(CHANNELS, dtype=float))
    bus.drain()
    return heard


@pytest.mark.parametrize(
    ("channel", "message_type"),
    [
        (channels.TRUTH_ROBOT, truth_robot_t),
        (channels.TRUTH_BALL, truth_ball_t),
        (channels.ACTUATOR_STATE, actuator_state_t),
    ],
)
def test_lcm_writes_the_bytes_it_read(state: EngineState, channel: str, message_type: type) -> None:
    data = sent(state)[channel]
    message = message_type.decode(data)
    assert message.utime == UTIME
    assert message.encode() == data


def test_truth_is_in_its_fields(state: EngineState) -> None:
    heard = sent(state)
    robot, ball = truth_robot_t.decode(heard[channels.TRUTH_ROBOT]), truth_ball_t.decode(heard[channels.TRUTH_BALL])
    assert robot.joint_velocity == tuple(state.joint_velocity)
    assert robot.base_quaternion == tuple(state.base_quaternion)
    link, offset = next((BODY.link_of(m), m.offset) for m in BODY.markers if m.name == BODY.effectors[-1].name)
    hand = state.link_position[link] + state.link_rotation[link] @ np.array(offset)
    assert robot.effector_position[-1] == tuple(hand)
    assert ball.true_ball_velocity == tuple(state.ball_velocity)


def test_noise_of_each_reading_is_what_would_be_drawn_for_it_alone(state: EngineState) -> None:
    rng = np.random.default_rng(3)
    alone = [rng.normal(0.0, 2.0, CHANNELS) for _ in range(300)][-1]
    last = actuator_state_t.decode(sent(state, noise=2.0)[channels.ACTUATOR_STATE])
    assert last.state_sequence == 300
    assert last.measured == tuple(np.arange(CHANNELS) + alone)


def test_lcm_writes_the_frame_it_read() -> None:
    markers, places = np.zeros(4 * MARKER_SIZE, dtype=np.uint8), np.random.default_rng(0).standard_normal((3, 3))
    for number, (label, place) in enumerate(zip((4, -2_000_000_000, -1), places, strict=True)):
        put_marker(markers, number, label, place)
    data = pack_frame(UTIME, 5, 3, markers)
    frame = mocap_frame_t.decode(data)
    assert (frame.utime, frame.frame_number) == (UTIME, 5)
    assert [m.marker_id for m in frame.markers] == [4, -2_000_000_000, -1]
    assert [list(m.marker_position) for m in frame.markers] == places.tolist()
    assert frame.encode() == data
