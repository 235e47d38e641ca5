"""Board and client over a real link: every way to lose control ends vented, with the board alive and its cause told."""

import contextlib
import os
import signal
import socket
import subprocess
import sys

import pytest
from board_by_hand import armed_controller, board_by_hand
from board_link import PATIENCE, VENTED, RunningBoard, arm, bad_command, command, controller, eventually, running_board

from imolo.errors import BackendError
from imolo_drivers.board import client as board_client
from imolo_drivers.board.board import BoardState
from imolo_drivers.board.client import BoardClient, ClockOffset, LinkLostError
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.connection import UNSENT
from imolo_drivers.board.framing import MAX_PAYLOAD, FrameType, encode_frame
from imolo_drivers.board.handshake import ClientRole, make_hello
from imolo_drivers.board.server import BoardServer, monotonic_utime
from imolo_drivers.board.valve_io import SimulatedValves


def start_motion(board: RunningBoard, client: BoardClient, sequence: int = 1) -> None:
    client.command(command(board.clock() + 1000, sequence, lengths=(8_000_000, 400_000)))  # as long as may be
    assert eventually(lambda: client.poll() is not None and client.state.phase_in_force == 1)
    assert board.valves.pressure[0] == 3e5


def latched(board: RunningBoard, cause: str) -> bool:
    return eventually(lambda: board.state == "LATCHED" and cause in board.cause) and (board.valves.pressure == VENTED)


def still_serves(board: RunningBoard) -> bool:
    """Return whether the next controller is welcome, is not armed, and can be armed."""
    assert eventually(lambda: board.server.board.session == 0)
    with controller(board, armed=False) as client:
        unarmed = client.welcome.state_at_welcome != BoardState.ARMED
        arm(board)
        start_motion(board, client)
    return unarmed


def test_motion_runs_over_the_link() -> None:
    with board_by_hand() as board:
        client = armed_controller(board)
        onset = board.now + 20_000
        for sequence in range(1, 80):
            client.send(command(onset, sequence, 3e5, (50_000, 50_000)))
            board.turn(2000)
        states = client.frames(FrameType.STATE)
        assert {state.given_target[0] for state in states} == {0.0, 3e5, 6e5}
        assert states[-1].accepted_sequence > 70
        assert states[-1].phase_in_force == 0
        assert states[-1].board_state == BoardState.ARMED
        assert not client.refusals()


@pytest.mark.parametrize("reset", [False, True])
def test_cable_cut_in_a_phase_vents(reset: bool) -> None:
    with running_board() as board:
        with controller(board) as client:
            start_motion(board, client)
            if reset:
                linger = b"\x01\x00\x00\x00\x00\x00\x00\x00"
                client._link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        assert latched(board, "the link" if reset else "closed the link")
        assert still_serves(board)


def test_half_open_link_vents_and_makes_room_for_the_next_controller() -> None:
    with running_board() as board:
        silent = BoardClient(board.address, ClientRole.CONTROLLER, "gone without a word", PATIENCE)
        arm(board)
        board.server.board._watchdog = 90_000  # [µs]
        assert latched(board, "nothing heard of the controller")
        board.server._silence = 500_000
        assert eventually(lambda: board.server.board.session == 0)
        assert any("nothing heard for" in line for line in board.said)
        board.server.board._watchdog = board.server._silence = 60_000_000
        assert still_serves(board)
        silent.close()


def test_planner_that_stops_while_the_link_lives_vents() -> None:
    with board_by_hand() as board:
        client = armed_controller(board)
        client.send(command(board.now + 1000))
        board.until(lambda: board.valves.pressure[0] == 3e5)
        while board.state == "ARMED":
            client.ask()
            board.turn(5000)
        assert board.state == "LATCHED"
        assert "no valid command" in board.server.board.cause


def test_killed_planner_vents() -> None:
    program = """
import sys, time
from imolo_drivers.board.client import BoardClient
from imolo_drivers.board.handshake import ClientRole
client = BoardClient(("127.0.0.1", int(sys.argv[1])), ClientRole.CONTROLLER, "to be killed", 60.0)
print("connected", flush=True)
while True:
    client.ask_time()
    client.poll()
    time.sleep(0.005)
"""
    with running_board() as board:
        arguments = [sys.executable, "-c", program, str(board.address[1])]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE) as planner:
            assert planner.stdout is not None
            assert planner.stdout.readline() == b"connected\n"
            arm(board)
            assert board.state == "ARMED"
            planner.send_signal(signal.SIGKILL)
        assert latched(board, "")
        assert still_serves(board)


def wrong_checksum() -> bytes:
    return encode_frame(command(0), 9_000, 0)[:-1] + b"?"


@pytest.mark.parametrize(
    ("garbage", "cause"),
    [
        (os.urandom(1000), "a frame begins with"),
        (wrong_checksum(), "checksum"),
        (b"IMB1\x00\x05\xff\xff" + bytes(1000), "announces 65535 bytes"),
        (b"IMB1\x0f\x05\x00\x00" + bytes(1000), "unknown frame type"),
    ],
    ids=["garbage", "wrong checksum", "oversize", "unknown type"],
)
def test_damaged_stream_vents_and_is_told(garbage: bytes, cause: str) -> None:
    with running_board() as board:
        with controller(board) as client:
            start_motion(board, client)
            client._link.sendall(garbage)
            assert latched(board, cause)
            with pytest.raises(LinkLostError, match=cause):
                client.wait(lambda: False, PATIENCE)
        assert still_serves(board)


def test_truncated_frame_vents_when_the_rest_does_not_come() -> None:
    with running_board(watchdog=0.1) as board, controller(board) as client:
        client._link.sendall(encode_frame(command(board.clock()), 9_000, 0)[:-1])
        assert latched(board, "nothing heard")


@pytest.mark.parametrize("fault", ["not finite", "5 MPa", "another clock"])
def test_bad_command_is_refused_with_the_reason_and_the_motion_goes_on(fault: str) -> None:
    with running_board() as board, controller(board) as client:
        start_motion(board, client)
        client.command(bad_command(board.clock(), fault))
        assert client.wait(lambda: bool(client.refusals), PATIENCE)
        assert client.refusals[0].refusal_code == ("times" if fault == "another clock" else "values")
        assert board.valves.pressure[0] == 3e5


def test_old_frame_is_refused() -> None:
    with running_board() as board, controller(board) as client:
        start_motion(board, client)
        client._link.sendall(encode_frame(command(board.clock(), 2, 1e5), 0, 0))
        assert client.wait(lambda: bool(client.refusals), PATIENCE)
        assert client.refusals[0].refusal_code == "stale"
        assert board.valves.pressure[0] == 3e5


@pytest.mark.parametrize("jump", [3_600_000_000, -1_000_000])
def test_jump_of_the_clock_vents(jump: int) -> None:
    with running_board() as board, controller(board) as client:
        start_motion(board, client)
        board.jump = jump
        assert latched(board, "")


def test_client_notices_that_the_clock_of_the_board_jumped() -> None:
    with running_board() as board, controller(board, armed=False) as client:
        client.synchronise()
        assert client.jumped < 1000
        board.jump = 50_000
        client.synchronise()
        assert abs(client.jumped - 50_000) < 5000


def test_offset_of_the_clocks_is_within_its_uncertainty() -> None:
    with running_board() as board:
        board.jump = 7_000_000_000
        with controller(board, armed=False) as client:
            client.synchronise()
            assert abs(client.offset.utime - board.jump) <= client.offset.uncertainty + 1


def test_second_controller_is_refused_and_the_first_goes_on() -> None:
    with running_board() as board, controller(board) as client:
        with pytest.raises(BackendError, match="one at a time"):
            BoardClient(board.address, ClientRole.CONTROLLER, "second", PATIENCE)
        start_motion(board, client)


def test_restarted_board_is_found_again_and_is_vented() -> None:
    with running_board() as board, controller(board) as client:
        start_motion(board, client)
        board.stop()
        assert board.valves.pressure == VENTED
        with pytest.raises(LinkLostError, match="is lost"):
            client.wait(lambda: False, PATIENCE)
        with running_board(board.address) as again, controller(again, armed=False) as anew:
            assert anew.welcome.state_at_welcome == BoardState.VENTED
            anew.command(command(again.clock()))
            assert anew.wait(lambda: bool(anew.refusals), PATIENCE)
            assert anew.refusals[0].refusal_code == "not_armed"


def test_client_waits_for_a_board_that_starts_later() -> None:
    with socket.create_server(("127.0.0.1", 0)) as reserved:
        address = reserved.getsockname()[:2]
    with pytest.raises(BackendError, match="no valve board answers"):
        BoardClient(address, ClientRole.CONTROLLER, "early", patience=0.2)
    with running_board(address) as board, controller(board, armed=False) as client:
        assert client.welcome.board_robot == "liberobot"


def test_client_waits_for_an_answer_as_long_as_it_is_told() -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute:
        address = mute.getsockname()[:2]
        with pytest.raises(BackendError, match=r"did not tell anything for 0\.1 s"):
            BoardClient(address, ClientRole.OPERATOR, "patient", patience=0.1)


def test_stopped_board_vents() -> None:
    with running_board() as board, controller(board) as client:
        start_motion(board, client)
        board.stop()
        assert board.valves.pressure == VENTED
        assert board.cause == "the board program ended"


def test_controller_cannot_arm_itself() -> None:
    with running_board() as board, controller(board, armed=False) as client:
        client.arm(client.welcome.controller_session, "itself")
        assert client.wait(lambda: bool(client.refusals), PATIENCE)
        assert client.refusals[0].refusal_code == "role"
        assert board.state == "VENTED"


def test_arming_that_was_asked_for_an_earlier_connection_is_refused() -> None:
    with running_board() as board:
        with controller(board, armed=False) as first:
            session = first.welcome.controller_session
        assert eventually(lambda: board.server.board.session == 0)
        with controller(board, armed=False):
            operator = arm(board, session)
            assert operator.refusals[0].refusal_code == "session"
            assert board.state == "VENTED"


def test_operator_cannot_command() -> None:
    with running_board() as board, controller(board):
        operator = BoardClient(board.address, ClientRole.OPERATOR, "person", PATIENCE)
        operator.command(command(board.clock()))
        assert operator.wait(lambda: bool(operator.refusals), PATIENCE)
        assert operator.refusals[0].refusal_code == "role"
        operator.close()


def test_anyone_may_disarm() -> None:
    with running_board() as board, controller(board) as client:
        start_motion(board, client)
        operator = BoardClient(board.address, ClientRole.OPERATOR, "person", PATIENCE)
        operator.disarm("person")
        assert eventually(lambda: board.state == "VENTED")
        assert board.valves.pressure == VENTED
        assert board.cause == "disarmed by person"
        operator.close()


@pytest.mark.parametrize("fault", ["version", "types", "role", "first frame"])
def test_handshake_that_does_not_fit_is_refused_with_the_reason(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def hello(role: ClientRole, name: str, dry_run: bool) -> object:
        message = make_hello(role, name, dry_run)
        if fault == "version":
            message.hello_version = 1
        elif fault == "types":
            message.hello_fingerprint[0] += 1
        elif fault == "role":
            message.client_role = "pilot"
        else:
            return command(0)
        return message

    monkeypatch.setattr(board_client, "make_hello", hello)
    complaint = {
        "version": "update imolo at the client",
        "types": "board_hello_t",
        "role": "'pilot'",
        "first frame": "a hello",
    }
    with running_board() as board:
        with pytest.raises(BackendError, match=complaint[fault]):
            BoardClient(board.address, ClientRole.CONTROLLER, "test", PATIENCE)
        monkeypatch.undo()
        assert still_serves(board)


def test_controller_that_does_not_read_is_dropped_with_bounded_memory() -> None:
    with running_board() as board:
        deaf = BoardClient(board.address, ClientRole.CONTROLLER, "deaf", PATIENCE)
        deaf._link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        largest = [0]

        def is_dropped() -> bool:
            largest.extend(len(one.unsent) for one in list(board.server._connections))
            return any("does not read" in line for line in board.said)

        assert eventually(is_dropped), board.said
        deaf.close()
        assert 0 < max(largest) <= UNSENT + MAX_PAYLOAD
        assert still_serves(board)


def test_many_connections_leave_the_controller_alone() -> None:
    with running_board() as board, controller(board) as client, contextlib.ExitStack() as crowd:
        for _ in range(40):
            crowd.enter_context(socket.create_connection(board.address))
            client.ask_time()
        start_motion(board, client)


def test_trial_is_told_to_the_board() -> None:
    with running_board() as board, controller(board, armed=False) as client:
        client.announce("hit", 3, 1)
        assert eventually(lambda: "hit trial 3, seed 1" in board.said)
        assert board.trials[0].announced_index == 3


def test_occupied_port_is_told() -> None:
    with running_board() as board, pytest.raises(BackendError, match="is another board running"):
        BoardServer(BoardConfig(), SimulatedValves(), board.address)


def test_clock_offset_prefers_the_shortest_round_trip() -> None:
    offset = ClockOffset()
    offset.add(asked=0, heard=1_000_900, answered=1_000_900, received=1000)
    offset.add(asked=5000, heard=1_005_010, answered=1_005_030, received=5040)
    offset.add(asked=6000, heard=1_006_100, answered=1_006_100, received=7000)
    assert (offset.utime, offset.uncertainty) == (1_000_000, 10)


def test_clock_is_that_of_nobody() -> None:
    assert monotonic_utime() <= monotonic_utime()
