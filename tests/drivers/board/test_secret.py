"""Whoever does not know the secret neither moves the robot nor watches it, and may vent it."""

import os
from pathlib import Path

import pytest
from board_by_hand import armed_controller, board_by_hand
from board_link import PATIENCE, controller, eventually, running_board
from typer.testing import CliRunner

from imolo.command_line.main import app
from imolo.errors import BackendError, ConfigError
from imolo_drivers.board.client import BoardClient, disarm, make_disarm
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.framing import FrameType
from imolo_drivers.board.handshake import ClientRole
from imolo_drivers.board.secret import SHORTEST, read_secret
from imolo_drivers.board.server import BoardServer
from imolo_drivers.board.valve_io import SimulatedValves

SECRET = b"correct horse battery staple"
PATIENT = {"watchdog": 1.0, "silence": 60.0}


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "secret"
    path.write_bytes(SECRET + b"\n")
    path.chmod(0o600)
    return path


def test_who_knows_the_secret_controls_and_arms(secret: Path) -> None:
    with board_by_hand(secret=secret, **PATIENT) as board:
        armed_controller(board, SECRET)
        assert board.state == "ARMED"


@pytest.mark.parametrize("role", ClientRole)
@pytest.mark.parametrize("known", [b"", b"another secret of a good length"])
def test_stranger_is_refused_and_sees_nothing(secret: Path, role: ClientRole, known: bytes) -> None:
    with board_by_hand(secret=secret, **PATIENT) as board:
        stranger = board.admit(role, known)
        board.until(lambda: stranger.refusals() == ["secret"] and stranger.is_closed)
        assert {frame.type for frame in stranger._frames} == {FrameType.CHALLENGE, FrameType.REFUSAL}
        assert board.server.board.session == 0


def test_stranger_sees_nothing_while_it_waits(secret: Path) -> None:
    with board_by_hand(secret=secret, **PATIENT) as board:
        stranger = board.connect()
        board.until(lambda: board.now > 2_000_000, step=10_000)
        stranger.frames(FrameType.STATE)
        assert stranger._frames == []


def test_proof_of_another_connection_is_worth_nothing(secret: Path) -> None:
    with board_by_hand(secret=secret, **PATIENT) as board:
        armed_controller(board, SECRET)
        board.server.board.disarm(board.now, "test")
        first, second = board.admit(ClientRole.OPERATOR, SECRET), board.admit(ClientRole.OPERATOR, SECRET)
        second.nonce = first.nonce
        second.arm(board.server.board.session, SECRET)
        board.until(lambda: second.refusals() == ["secret"])
        assert board.state == "VENTED"


@pytest.mark.parametrize("known", [b"", b"another secret of a good length"])
def test_arming_needs_the_secret_once_more(secret: Path, known: bytes) -> None:
    with board_by_hand(secret=secret, **PATIENT) as board:
        board.admit(ClientRole.CONTROLLER, SECRET)
        operator = board.admit(ClientRole.OPERATOR, SECRET)
        operator.arm(board.server.board.session, known)
        board.until(lambda: operator.refusals() == ["secret"])
        assert board.state == "VENTED"


def test_anyone_may_vent(secret: Path) -> None:
    with board_by_hand(secret=secret, **PATIENT) as board:
        armed_controller(board, SECRET)
        stranger = board.connect()
        stranger.send(make_disarm("a passer-by"))
        board.until(lambda: stranger.frames(FrameType.ARM))
        assert (board.state, board.server.board.cause) == ("VENTED", "disarmed by a passer-by")


def test_programs_name_the_file(secret: Path) -> None:
    with running_board(secret=secret) as board, controller(board, armed=False, secret=SECRET):
        where = f"{board.address[0]}:{board.address[1]}"
        refused = CliRunner().invoke(app, ["arm", where], input="arm\n")
        assert "does not know the secret of this board; name the same file" in str(refused.exception)
        result = CliRunner().invoke(app, ["arm", where, "--secret", str(secret)], input="arm\n")
        assert result.exit_code == 0, result.output
        disarm(board.address, "a passer-by")
        assert eventually(lambda: board.state == "VENTED")


def test_client_without_the_secret_is_told_in_one_line(secret: Path) -> None:
    with (
        running_board(secret=secret) as board,
        pytest.raises(BackendError, match=r"does not know the secret of this board; [^\n]*$"),
    ):
        BoardClient(board.address, ClientRole.CONTROLLER, "test", PATIENCE)


@pytest.mark.parametrize("host", ["0.0.0.0", ""])
def test_board_without_a_secret_listens_to_this_machine_alone(host: str) -> None:
    with pytest.raises(ConfigError, match=r"without a secret the board listens on 127\.0\.0\.1 alone"):
        BoardServer(BoardConfig(), SimulatedValves(), (host, 0))


def test_board_with_a_secret_listens_to_all(secret: Path) -> None:
    server = BoardServer(BoardConfig(secret=secret), SimulatedValves(), ("0.0.0.0", 0))
    assert not server.is_open
    server.close()


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o666, 0o620])
def test_secret_that_others_may_read_is_refused(secret: Path, mode: int) -> None:
    secret.chmod(mode)
    with pytest.raises(ConfigError, match=rf"others may read the secret .* \(mode {mode:04o}\); `chmod 600"):
        read_secret(secret)


def test_what_is_no_secret_is_told(tmp_path: Path, secret: Path) -> None:
    assert read_secret(secret) == SECRET
    with pytest.raises(ConfigError, match="No such file"):
        read_secret(tmp_path / "none")
    secret.write_bytes(b"x" * (SHORTEST - 1))
    with pytest.raises(ConfigError, match="holds 15 bytes; give 16 to 4096"):
        read_secret(secret)
    secret.write_bytes(b"x" * 5000)
    with pytest.raises(ConfigError, match="give 16 to 4096"):
        read_secret(secret)
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(ConfigError, match="is no file"):
        read_secret(tmp_path / "pipe")
