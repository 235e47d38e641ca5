"""Commands for any number of channels: checked, limited, and counted past the ends of their numbers."""

import math
from typing import Any

import pytest
from board_by_hand import armed_controller, board_by_hand
from board_link import LOOPBACK, SETTINGS, command
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from imolo.method.commands import wrap
from imolo_drivers.board.board import Board, BoardState
from imolo_drivers.board.command import is_newer, make_command, slew
from imolo_drivers.board.config import MAX_CHANNELS, BoardConfig, ChannelConfig
from imolo_drivers.board.framing import SEQUENCES, FrameError, FrameType
from imolo_drivers.board.refusal import RefusalCode, RefusedError
from imolo_drivers.board.server import BoardServer
from imolo_drivers.board.valve_io import SimulatedValves

START = 1_000_000  # [µs]
EIGHT = {"device": "some-converter", "full_scale": 1e6}
TORQUE = ChannelConfig(name="elbow", unit="N m", lowest=-5.0, highest=5.0, rest=0.5, limit=4.0, rise_limit=100.0)


def channels(count: int) -> tuple[ChannelConfig, ...]:
    return tuple(ChannelConfig(name=f"channel {number}") for number in range(1, 1 + count))


def armed(**settings: Any) -> tuple[Board, SimulatedValves]:
    valves = SimulatedValves()
    board = Board(BoardConfig.model_validate({**SETTINGS, **settings}), valves, START)
    board.connect(1, False, START)
    board.arm(1, START)
    return board, valves


@pytest.mark.parametrize("count", [1, 2, 8, 13, MAX_CHANNELS])
def test_board_moves_any_number_of_channels_over_the_link(count: int) -> None:
    names = [f"{number:03d} {'x' * 56}" for number in range(count)]
    every = tuple(ChannelConfig(name=name, unit="millimetres") for name in names)
    with board_by_hand(channels=every, watchdog=1.0, silence=60.0) as board:
        controller = armed_controller(board)
        welcome = controller.frames(FrameType.WELCOME)[0]
        assert [channel.channel_name for channel in welcome.board_channels] == names
        targets = [float(number) for number in range(count)]
        controller.send(make_command(1, board.now, [board.now + 500_000], [targets]))
        board.until(lambda: list(board.valves.pressure) == targets)
        board.until(lambda: targets in [list(state.measured_value) for state in controller.frames(FrameType.STATE)])
        assert list(controller.frames(FrameType.STATE)[-1].given_target) == targets


@given(count=st.integers(1, 20), given_count=st.integers(0, 20))
def test_wrong_number_of_channels_is_refused_in_one_line(count: int, given_count: int) -> None:
    board, _ = armed(channels=channels(count))
    message = command(START + 1, num_channels=given_count)
    if count == given_count:
        board.command(message, START)
        return
    with pytest.raises(RefusedError, match=f"the command has {given_count} channels; this board has {count}$") as told:
        board.command(message, START)
    assert told.value.code is RefusalCode.VALUES


def test_channels_have_limits_of_their_own() -> None:
    board, valves = armed(channels=(TORQUE, *channels(1)), pressure_limit=1e5)
    assert valves.pressure == (0.0, 0.0)  # its own slew limit
    board.heard(START + 5000)
    board.tick(START + 5000)
    assert valves.pressure == (0.5, 0.0)
    board.command(make_command(1, START + 5000, [START + 500_000], [[-5.0, 3e5]]), START + 5000)
    board.tick(START + 10_000)
    assert valves.pressure == (-0.5, 1e5)
    board.tick(START + 90_000)
    assert valves.pressure == (-4.0, 1e5)
    assert board.tell().num_clamped == 1
    with pytest.raises(RefusedError, match="the target of 'elbow' in phase 1 is -6 N m; give -5 to 5 N m"):
        board.command(make_command(2, START, [START + 500_000], [[-6.0, 0.0]]), START + 90_000)


@given(
    wanted=st.floats(-1e6, 1e6, allow_subnormal=False),
    given_before=st.floats(-1e6, 1e6, allow_subnormal=False),
    step=st.floats(0.0, 1e6),
)
def test_targets_leave_zero_no_faster_than_a_step_and_return_at_once(
    wanted: float, given_before: float, step: float
) -> None:
    (new,) = slew([wanted], [given_before], [step])
    assert abs(new) <= abs(wanted)
    assert new == 0.0 or math.copysign(1.0, new) == math.copysign(1.0, wanted)
    same_side = wanted * given_before > 0.0
    assert abs(new) <= (abs(given_before) if same_side else 0.0) + step
    if same_side and abs(wanted) <= abs(given_before):
        assert new == wanted


def test_rise_of_pressure_is_limited_by_default() -> None:
    config = BoardConfig()
    assert all(0.0 < config.slew_limit(channel) < math.inf for channel in config.channels)


@pytest.mark.parametrize("last", [2**31 - 1, -1, 0, -(2**31)])
def test_commands_go_on_past_the_end_of_their_numbers(last: int) -> None:
    board, valves = armed()
    board.command(command(START, last, 1e5), START)
    board.command(command(START, last + 1, 2e5), START + 10)
    assert valves.pressure[0] == 2e5
    with pytest.raises(RefusedError, match="is not newer"):
        board.command(command(START, last, 3e5), START + 20)


@given(known=st.integers(-(2**31), 2**31 - 1), ahead=st.integers(1, 2**31 - 1))
def test_what_was_counted_later_is_newer(known: int, ahead: int) -> None:
    later = wrap(known + ahead)
    assert -(2**31) <= later < 2**31
    assert is_newer(later, known)
    assert not is_newer(known, later)
    assert not is_newer(known, known)


def test_frames_go_on_past_the_end_of_their_numbers() -> None:
    """After 49.7 days at 1 kHz."""
    with board_by_hand(watchdog=1.0, silence=60.0) as board:
        controller = armed_controller(board)
        for sequence in (2**31 - 3, SEQUENCES - 3):
            controller.sequence = board.server._connections[0]._sent = sequence
            before = len(controller.frames(FrameType.CLOCK))
            controller.ask(6)
            board.until(lambda before=before: len(controller.frames(FrameType.CLOCK)) == before + 6)
        assert controller.refusals() == []
        assert board.state == "ARMED"


def test_counters_of_the_state_outlive_the_board() -> None:
    """The states of 24.9 days at 1 kHz are more than 32 bits can count."""
    board, _ = armed()
    state = board.tell()
    state.state_number = state.num_refused = state.num_clamped = state.num_armed = 2**31 - 1
    for sequence in (1, 2):
        board.command(command(START, sequence, 4.5e5), START)
        with pytest.raises(RefusedError):
            board.command(command(START, sequence), START)
    decoded = type(state).decode(board.tell().encode())
    assert (decoded.state_number, decoded.num_refused) == (2**31, 2**31 + 1)
    assert decoded.board_state == BoardState.ARMED


def test_names_that_do_not_fit_into_a_frame_are_told_at_the_start() -> None:
    every = tuple(ChannelConfig(name="\N{GRINNING FACE}" * 60) for _ in range(MAX_CHANNELS))
    with pytest.raises(FrameError, match=r"board_welcome_t of \d+ bytes is too long"):
        BoardServer(BoardConfig(channels=every), SimulatedValves(), LOOPBACK)


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"channels": []}, "at least 1"),
        ({"channels": channels(MAX_CHANNELS + 1)}, "at most 128"),
        ({"channels": [{"name": "x", "rest": 1e6}]}, "rest 1e.06 is not within 0 to 900000 Pa"),
        ({"channels": channels(2), "iio": {"dac": EIGHT, "adc": EIGHT}}, "iio.dac has 8 channels; give 2"),
    ],
)
def test_channels_that_do_not_fit_are_told(settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValidationError, match=complaint):
        BoardConfig.model_validate(settings)
