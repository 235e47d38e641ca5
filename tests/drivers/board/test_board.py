"""The valve board on a clock made for the test: it vents in time whatever happens, and moves only what it may."""

from collections.abc import Sequence

import pytest
from board_link import NUM_VALVES, SETTINGS, VENTED, bad_command, command
from hypothesis import given
from hypothesis import strategies as st

from imolo.errors import BackendError
from imolo_drivers.board.board import NEVER, VENT_EARLY, Board, BoardState
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.refusal import RefusalCode, RefusedError
from imolo_drivers.board.sensor_reader import Reading
from imolo_drivers.board.valve_io import SimulatedValves

WATCHDOG = 100_000  # [µs] of the default config
LIMIT = round(WATCHDOG * (1.0 - VENT_EARLY))  # [µs]
REST = tuple(channel.rest for channel in BoardConfig().channels)
SESSION = 5
START = 1_000_000  # [µs]


def armed(valves: SimulatedValves | None = None, **settings: object) -> tuple[Board, SimulatedValves]:
    valves = valves or SimulatedValves()
    board = Board(BoardConfig.model_validate({**SETTINGS, **settings}), valves, START)
    board.connect(SESSION, False, START)
    board.arm(SESSION, START)
    return board, valves


def follow(board: Board, until: int, step: int = 1000, feed: int = 8333) -> None:
    """Let time pass with a frame of the controller and a new command of the same motion every `feed` [µs]."""
    utime, sequence, fed = START, board.tell().accepted_sequence, START
    onset = START + 10_000
    while utime < until:
        utime = min(utime + step, until)
        board.heard(utime)
        if utime - fed >= feed:
            sequence += 1
            fed = utime
            board.command(command(onset, sequence), utime)
        board.tick(utime)


def test_nothing_moves_before_a_person_arms() -> None:
    valves = SimulatedValves()
    board = Board(BoardConfig(), valves, START)
    board.connect(SESSION, False, START)
    with pytest.raises(RefusedError, match="vented: just started") as refusal:
        board.command(command(START + 10_000), START)
    assert refusal.value.code is RefusalCode.NOT_ARMED
    board.tick(START + 50_000)
    assert valves.pressure == VENTED
    assert board.state is BoardState.VENTED


def test_armed_board_holds_the_rest_pressures() -> None:
    _, valves = armed()
    assert valves.pressure == REST


def test_every_session_counts_how_often_it_was_armed() -> None:
    board, _ = armed()
    board.arm(SESSION, START)  # is armed already
    assert board.tell().num_armed == 1
    board.latch(START, "a fault")
    board.arm(SESSION, START)
    assert board.tell().num_armed == 2
    board.disconnect(START, "gone")
    board.connect(SESSION + 1, False, START)
    assert board.tell().num_armed == 0


def test_arming_is_for_the_connected_controller_alone() -> None:
    board = Board(BoardConfig(), SimulatedValves(), START)
    with pytest.raises(RefusedError, match="no controller"):
        board.arm(SESSION, START)
    board.connect(SESSION, False, START)
    with pytest.raises(RefusedError, match="connected anew"):
        board.arm(SESSION + 1, START)
    assert board.state is BoardState.VENTED


def test_second_controller_is_refused_and_the_first_goes_on() -> None:
    board, valves = armed()
    with pytest.raises(RefusedError, match="one at a time"):
        board.connect(SESSION + 1, False, START)
    assert (board.session, board.state, valves.pressure) == (SESSION, BoardState.ARMED, REST)


def test_new_connection_is_not_armed() -> None:
    board, valves = armed()
    board.disconnect(START + 1, "cable cut")
    assert (board.state, valves.pressure) == (BoardState.LATCHED, VENTED)
    board.connect(SESSION + 1, False, START + 2)
    assert board.state is BoardState.LATCHED
    with pytest.raises(RefusedError, match="latched: cable cut"):
        board.command(command(START + 10_000), START + 3)


@given(lengths=st.lists(st.integers(1, 90_000), min_size=1, max_size=5), lateness=st.integers(0, 900))
def test_phases_are_switched_on_the_clock_of_the_board(lengths: list[int], lateness: int) -> None:
    """With ticks at `next_due`, each late by less than a millisecond, a phase begins as late as its tick."""
    board, valves = armed()
    onset, utime = START + 500, START
    message = command(onset, 1, 1e5, tuple(lengths))
    board.command(message, utime)
    for switch, row in zip([onset, *message.switch_utime], [*message.target, VENTED], strict=True):
        board.heard(utime)
        message.command_sequence += 1
        board.command(message, utime)
        while board.next_due() <= switch:
            utime = board.next_due()
            before = utime
            board.tick(utime)
        assert before == switch
        assert list(valves.pressure) == list(row)
        state = board.tell()
        if switch < message.switch_utime[-1]:
            assert state.switched_utime == switch
            assert state.started_utime == onset
        utime = min(utime + lateness, switch + min(lengths) - 1) if len(lengths) > 1 else utime
        board.tick(utime)


def test_valves_vent_past_the_last_phase_without_a_fault() -> None:
    board, valves = armed()
    follow(board, START + 700_000)
    assert (board.state, valves.pressure) == (BoardState.ARMED, VENTED)
    assert board.tell().phase_in_force == 0


@pytest.mark.parametrize("step", [1, 333, 1000])
def test_planner_that_stops_in_a_motion_is_vented_within_the_watchdog_time(step: int) -> None:
    """The link is alive throughout: frames that are no commands do not feed the watchdog."""
    board, valves = armed()
    follow(board, START + 50_000)
    fed = board.tell().accepted_utime
    utime = START + 50_000
    while board.state is BoardState.ARMED:
        assert valves.pressure != VENTED
        utime += step
        board.heard(utime)
        board.tick(utime)
    assert fed + LIMIT < utime <= fed + LIMIT + step <= fed + WATCHDOG
    assert valves.pressure == VENTED
    assert "no valid command" in board.cause


@pytest.mark.parametrize("moving", [False, True])
def test_half_open_link_is_vented_within_the_watchdog_time(moving: bool) -> None:
    board, valves = armed()
    if moving:
        board.command(command(START + 1000), START)
    due = board.next_due()
    while board.state is BoardState.ARMED:
        due = board.next_due()
        board.tick(due)
    assert due == START + LIMIT + 1
    assert valves.pressure == VENTED


@pytest.mark.parametrize("fault", ["not finite", "5 MPa", "negative", "backwards", "no phases", "another clock"])
def test_bad_commands_are_refused_and_feed_no_watchdog(fault: str) -> None:
    board, valves = armed()
    board.command(command(START + 1000), START)
    utime, sequence = START, 1
    while board.state is BoardState.ARMED:
        utime, sequence = utime + 5000, sequence + 1
        board.heard(utime)
        before = valves.pressure
        with pytest.raises(RefusedError):
            board.command(bad_command(START + 1000, fault, sequence), utime)
        assert valves.pressure == before
        board.tick(utime)
    assert START + LIMIT < utime <= START + WATCHDOG
    assert valves.pressure == VENTED
    assert board.tell().num_refused == sequence - 1


def test_old_and_repeated_sequences_are_refused_and_feed_no_watchdog() -> None:
    board, _ = armed()
    board.command(command(START + 1000, 10), START)
    for sequence in (10, 9, -5):
        with pytest.raises(RefusedError, match="not newer than 10") as refusal:
            board.command(command(START + 1000, sequence, 1e5), START + 50_000)
        assert refusal.value.code is RefusalCode.STALE
    board.heard(START + WATCHDOG)
    board.tick(START + WATCHDOG + 1)
    assert board.state is BoardState.LATCHED


def test_newest_command_wins() -> None:
    board, valves = armed()
    board.command(command(START, 1, 1e5), START)
    board.command(command(START, 2, 2e5), START + 10)
    assert valves.pressure == (2e5,) * NUM_VALVES


def test_clock_that_jumps_ahead_vents() -> None:
    board, valves = armed()
    board.command(command(START + 1000), START)
    board.tick(START + 3_600_000_000)
    assert (board.state, valves.pressure) == (BoardState.LATCHED, VENTED)


def test_clock_that_goes_back_vents_and_stays_so() -> None:
    board, valves = armed()
    follow(board, START + 50_000)
    board.tick(START + 49_000)
    assert (board.state, valves.pressure) == (BoardState.LATCHED, VENTED)
    assert "went back by 1000 us" in board.cause
    board.tick(START + 60_000)
    assert board.state is BoardState.LATCHED


def test_latch_keeps_its_first_cause_until_a_person_arms_again() -> None:
    board, valves = armed()
    board.tick(START + 200_000)
    cause = board.cause
    board.disconnect(START + 300_000, "cable cut")
    assert (board.state, board.cause) == (BoardState.LATCHED, cause)
    board.connect(SESSION + 1, False, START + 400_000)
    board.arm(SESSION + 1, START + 400_000)
    assert (board.state, board.cause, valves.pressure) == (BoardState.ARMED, "", REST)


def test_motion_from_before_the_fault_does_not_go_on_when_armed_again() -> None:
    board, valves = armed()
    board.command(command(START), START)
    board.latch(START + 1000, "test")
    board.arm(SESSION, START + 2000)
    assert valves.pressure == REST
    assert board.tell().accepted_sequence == 0


def test_disarming_vents_at_once() -> None:
    board, valves = armed()
    board.command(command(START), START)
    board.disarm(START + 1, "a person")
    assert (board.state, board.cause, valves.pressure) == (BoardState.VENTED, "a person", VENTED)


@given(limit=st.floats(1e3, 9e5), pressure=st.floats(0.0, 4.5e5))
def test_pressures_are_clamped_to_the_limit(limit: float, pressure: float) -> None:
    board, valves = armed(pressure_limit=limit)
    assert max(valves.pressure) <= limit
    board.command(command(START, 1, pressure), START)
    assert valves.pressure == (min(pressure, limit),) * NUM_VALVES
    assert board.tell().num_clamped == (2 * pressure > limit)


def test_targets_rise_no_faster_than_the_limit_and_fall_at_once() -> None:
    rise = 1e6  # [Pa/s]
    board, valves = armed(rise_limit=rise)
    board.command(command(START, 1, 3e5, (90_000,)), START)
    for milliseconds in range(1, 90):
        board.heard(START + 1000 * milliseconds)
        board.tick(START + 1000 * milliseconds)
        assert valves.pressure[0] == pytest.approx(rise * 1e-3 * milliseconds)
    board.tick(START + 90_000)
    assert valves.pressure == VENTED


@pytest.mark.parametrize("by", ["board", "controller"])
def test_dry_run_moves_nothing_and_tells_what_it_would_do(by: str) -> None:
    valves = SimulatedValves()
    board = Board(BoardConfig(dry_run=by == "board", rise_limit=0.0), valves, START)
    board.connect(SESSION, by == "controller", START)
    board.arm(SESSION, START)
    board.command(command(START), START)
    assert valves.pressure == VENTED
    assert board.tell().given_target == (3e5,) * NUM_VALVES


def test_dry_run_of_one_controller_ends_with_its_session() -> None:
    board = Board(BoardConfig(), SimulatedValves(), START)
    board.connect(SESSION, True, START)
    board.disconnect(START, "gone")
    board.connect(SESSION + 1, False, START)
    assert not board.dry_run


class BrokenConverter(SimulatedValves):
    broken = False

    def write(self, pressure: Sequence[float]) -> None:
        if self.broken:
            raise BackendError("the DAC does not answer")
        super().write(pressure)


def test_broken_sensors_vent_and_latch() -> None:
    board, valves = armed()
    board.sense(Reading(START, fault="the ADC does not answer"), START)
    state = board.tell()
    assert (state.board_state, state.state_cause) == (BoardState.LATCHED, "the ADC does not answer")
    assert all(value != value for value in state.measured_value)
    assert valves.pressure == VENTED


def test_converter_that_fails_is_vented_as_soon_as_it_answers_again() -> None:
    valves = BrokenConverter()
    board, _ = armed(valves)
    valves.broken = True
    board.command(command(START), START)
    assert board.state is BoardState.LATCHED
    board.tick(START + 1000)
    assert valves.pressure == REST
    valves.broken = False
    board.tick(START + 2000)
    assert valves.pressure == VENTED
    assert board.state is BoardState.LATCHED


def test_board_at_rest_has_nothing_planned() -> None:
    assert Board(BoardConfig(), SimulatedValves(), START).next_due() == NEVER
