"""Nothing that comes over links holds up the valves, and a person who wants to vent always gets through.

How late the board vents on the clock on the wall is measured in benchmarks/floods.py; here time is what a frame costs.
"""

from itertools import pairwise
from typing import Any

import pytest
from board_by_hand import BoardByHand, Peer, armed_controller, board_by_hand
from board_link import VENTED, command

from imolo_drivers.board.client import make_disarm
from imolo_drivers.board.connection import CONTROLLER, OPERATOR, Allowance
from imolo_drivers.board.framing import FrameType, encode_frame
from imolo_drivers.board.handshake import ClientRole, make_hello
from imolo_drivers.board.server import MAX_OPERATORS, MAX_STRANGERS, OTHERS_PAUSE

WATCHDOG = 100_000  # [µs]
COST = 1000  # [µs] of a frame, on a slow processor
PATIENT = {"watchdog": 1.0, "silence": 60.0}


def let_frames_cost_time(board: BoardByHand) -> list[int]:
    """Let each frame that is handled take `COST`; return the list of when one was."""
    handled: list[int] = []
    handle = board.server._handle

    def slowly(*arguments: Any) -> None:
        board.now += COST
        handled.append(board.now)
        handle(*arguments)

    board.server._handle = slowly  # type: ignore[method-assign]
    return handled


def ask(peer: Peer) -> None:
    peer.ask(OPERATOR[1] - 5)


def arm(peer: Peer) -> None:
    for _ in range(OPERATOR[1] - 5):
        peer.arm(peer.frames(FrameType.WELCOME)[0].controller_session)


@pytest.mark.parametrize("flood", [ask, arm])
@pytest.mark.parametrize("moving", [True, False])
def test_board_vents_within_the_watchdog_time_under_a_flood(flood: Any, moving: bool) -> None:
    with board_by_hand() as board:
        controller = armed_controller(board)
        operators = [board.admit(ClientRole.OPERATOR) for _ in range(4)]
        controller.send(command(board.now + 1000)) if moving else controller.ask()
        board.until(lambda: board.valves.pressure[0] == 3e5 if moving else controller.frames(FrameType.CLOCK))
        fed = board.server.board._fed if moving else board.server.board._heard
        for operator in operators:
            flood(operator)
        handled = let_frames_cost_time(board)
        board.until(lambda: board.state == "LATCHED", step=100)
        assert board.now <= fed + WATCHDOG
        assert len(handled) > 10  # the flood was there
        assert board.valves.pressure == VENTED


def test_controller_is_heard_between_any_two_frames_of_others() -> None:
    """So many operators that what they say takes longer than the watchdog time."""
    with board_by_hand() as board:
        controller = armed_controller(board)
        operators = [board.admit(ClientRole.OPERATOR) for _ in range(4)]
        for operator in operators:
            ask(operator)
        let_frames_cost_time(board)
        end = board.now + 3 * WATCHDOG
        while board.now < end:
            controller.ask()
            board.turn(5000)
        assert board.state == "ARMED"


def test_others_get_a_third_of_the_time() -> None:
    """The kernel holds up a program with real-time priority that takes all of it."""
    with board_by_hand(**PATIENT) as board:
        operator = board.admit(ClientRole.OPERATOR)
        operator.ask(20)
        handled = let_frames_cost_time(board)
        board.until(lambda: len(handled) == 20)
        gaps = [later - earlier for earlier, later in pairwise(handled)]
        assert min(gaps) >= (1 + OTHERS_PAUSE) * COST


@pytest.mark.parametrize("role", ClientRole)
def test_who_says_too_much_is_dropped_and_told(role: ClientRole) -> None:
    with board_by_hand(**PATIENT) as board:
        noisy, quiet = board.admit(role), board.admit(ClientRole.OPERATOR)
        rate, burst = CONTROLLER if role is ClientRole.CONTROLLER else OPERATOR
        noisy.ask(burst + 200)
        board.until(lambda: noisy.frames(FrameType.CLOCK) is not None and noisy.is_closed, step=10)
        # A link that is closed with unread bytes may lose the last word.
        assert noisy.refusals() in (["noise"], [])
        assert len(noisy.frames(FrameType.CLOCK)) <= burst + 0.2 * rate
        quiet.ask()
        board.until(lambda: quiet.frames(FrameType.CLOCK))


def test_noisy_controller_is_vented() -> None:
    with board_by_hand() as board:
        controller = armed_controller(board)
        controller.ask(2 * CONTROLLER[1])
        board.until(lambda: board.state == "LATCHED", step=10)
        assert "more than 1000 frames a second" in board.server.board.cause


def test_stranger_who_says_nothing_or_too_much_is_dropped() -> None:
    with board_by_hand(silence=0.2) as board:
        silent = board.connect()
        board.until(lambda: silent.refusals() == ["silence"] and silent.is_closed, step=1000)
        # Going on with a hello that is never whole is no better.
        slow = board.connect()
        board.until(lambda: len(board.server._connections) == 1)
        for byte in encode_frame(make_hello(ClientRole.OPERATOR, "slow"), 0, 0)[:10]:
            slow._link.sendall(bytes([byte]))
            board.turn(15_000)
        board.until(lambda: slow.refusals() == ["silence"] and slow.is_closed, step=1000)


@pytest.mark.parametrize("crowd", ["strangers", "operators", "both"])
def test_anyone_can_vent_at_any_time(crowd: str) -> None:
    with board_by_hand(**PATIENT) as board:
        armed_controller(board)
        if crowd != "strangers":
            for _ in range(MAX_OPERATORS + 1):
                board.admit(ClientRole.OPERATOR).ask(50)
        if crowd != "operators":
            for _ in range(2 * MAX_STRANGERS):
                board.connect()
        late = board.connect()
        late.send(make_disarm("Ada"))
        board.until(lambda: late.frames(FrameType.ARM))
        assert (board.state, board.server.board.cause) == ("VENTED", "disarmed by Ada")


def test_operator_always_gets_a_place() -> None:
    with board_by_hand(**PATIENT) as board:
        armed_controller(board)
        operators = [board.admit(ClientRole.OPERATOR) for _ in range(3 * MAX_OPERATORS)]
        assert all(operator.frames(FrameType.WELCOME) for operator in operators)
        board.until(lambda: operators[0].frames(FrameType.WELCOME) and operators[0].is_closed)
        assert board.state == "ARMED"


def test_crowd_of_one_host_drives_out_none_of_another() -> None:
    with board_by_hand(**PATIENT) as board:
        person = board.admit(ClientRole.OPERATOR, host="127.0.0.2")
        for _ in range(2 * MAX_OPERATORS):
            board.admit(ClientRole.OPERATOR)
        person.ask()
        board.until(lambda: person.frames(FrameType.CLOCK))


def test_strangers_do_not_fill_the_log() -> None:
    with board_by_hand(**PATIENT) as board:
        for _ in range(100):
            stranger = board.connect()
            stranger.send(make_disarm("x"), command(0))
            board.until(lambda stranger=stranger: stranger.refusals(), step=10)
            stranger.close()
        assert len(board.said) < 50


def test_allowance_grows_back_and_no_farther() -> None:
    allowance = Allowance(10, 2, 0)
    assert [allowance.take(0) for _ in range(3)] == [True, True, False]
    assert [allowance.take(100_000) for _ in range(2)] == [True, False]
    assert [allowance.take(60_000_000) for _ in range(3)] == [True, True, False]


def test_long_names_are_cut_and_steer_no_terminal() -> None:
    """What a stranger calls itself is repeated in refusals, causes and on the terminal."""
    with board_by_hand(**PATIENT) as board:
        armed_controller(board)
        stranger, other = board.connect(), board.connect()
        hello = make_hello(ClientRole.OPERATOR, "x")
        hello.client_role = "\x1b[2J\x01" * 500
        stranger.send(hello)
        board.until(lambda: stranger.refusals() == ["role"])
        assert board.state == "ARMED"
        long = make_disarm("x")
        long.arm_person = "\x1b]0;" + "A" * 3900
        other.send(long)
        board.until(lambda: board.state == "VENTED")
        told = [*board.said, board.server.board.cause, stranger.frames(FrameType.REFUSAL)[0].refusal_reason]
        assert all(line.isprintable() and len(line) <= 300 for line in told)
