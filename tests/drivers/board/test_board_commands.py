"""The board at the command line: a person arms, and nothing else does."""

import fcntl
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from board_link import PATIENCE, controller, running_board
from typer.testing import CliRunner

from imolo.command_line.main import app
from imolo.config.loading import config_for
from imolo.config.reading import read_model
from imolo.errors import BackendError, ConfigError
from imolo_drivers.address import parse_address
from imolo_drivers.board import client as board_client
from imolo_drivers.board.client import BoardClient
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.handshake import ClientRole
from imolo_drivers.board.server import PORT
from imolo_drivers.commands import BOARD

runner = CliRunner()


def address(board: object) -> str:
    host, port = board.address  # type: ignore[attr-defined]
    return f"{host}:{port}"


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands wait as long as a busy machine needs."""
    monkeypatch.setattr(board_client, "PATIENCE", PATIENCE)


@pytest.fixture
def board_program() -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, "-m", "imolo.command_line.main", "board", "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as program:
        yield program
        program.kill()


def test_board_program_says_where_it_listens_and_vents_at_its_end(board_program: "subprocess.Popen[str]") -> None:
    assert board_program.stderr is not None
    first = board_program.stderr.readline()
    assert first.startswith("imolo board: valve board on 127.0.0.1:")
    assert re.search(r", simulated valves, (real-time|ordinary) priority.*, vented$", first)
    board_program.send_signal(signal.SIGTERM)
    assert board_program.wait(PATIENCE) == 0


def test_terminal_that_is_held_up_does_not_hold_up_the_board() -> None:
    """As Ctrl-S does, or a slow network: here a pipe that nobody reads."""
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)  # [bytes] the smallest
    command = [sys.executable, "-m", "imolo.command_line.main", "board", "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stderr=writing) as program, open(reading, "rb", buffering=0) as said:
        os.close(writing)
        port = int(re.findall(rb"127\.0\.0\.1:(\d+)", said.read(4096))[0])
        for _ in range(100):  # each is a line in the log
            with socket.create_connection(("127.0.0.1", port), PATIENCE) as stranger:
                stranger.sendall(b"This is no frame of the valve board's.")
                while stranger.recv(4096):
                    pass
        client = BoardClient(("127.0.0.1", port), ClientRole.OPERATOR, "test", PATIENCE)
        assert client.wait(lambda: client.state.state_number > 0, PATIENCE)
        client.close()
        program.kill()


def test_person_who_types_arm_arms() -> None:
    with running_board() as board, controller(board, armed=False) as client:
        client.ask_time()
        result = runner.invoke(app, ["arm", address(board), "--person", "Ada"], input="arm\n")
        assert result.exit_code == 0, result.output
        assert "controller: test at 127.0.0.1" in result.output
        assert any(line.startswith("armed by Ada for test") for line in board.said)


def test_person_who_arms_a_board_with_a_broken_converter_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(pressure: Sequence[float]) -> None:
        if any(pressure):
            raise BackendError("the DAC does not answer")

    with running_board() as board, controller(board, armed=False):
        monkeypatch.setattr(board.valves, "write", break_down)
        result = runner.invoke(app, ["arm", address(board)], input="arm\n")
        assert str(result.exception) == "the board was armed and has latched at once: the DAC does not answer"


@pytest.mark.parametrize("answer", ["", "yes", "ARM"])
def test_any_other_answer_does_not_arm(answer: str) -> None:
    with running_board() as board, controller(board, armed=False):
        result = runner.invoke(app, ["arm", address(board)], input=f"{answer}\n")
        assert isinstance(result.exception, BackendError)
        assert board.state == "VENTED"


def test_ctrl_c_at_the_question_does_not_arm_and_is_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def press(_: str) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("builtins.input", press)
    with running_board() as board, controller(board, armed=False):
        assert runner.invoke(app, ["arm", address(board)]).exit_code == 130
        assert board.state == "VENTED"


def test_nobody_is_asked_where_there_is_nothing_to_arm() -> None:
    with running_board() as board:
        result = runner.invoke(app, ["arm", address(board)], input="arm\n")
        assert "no controller" in str(result.exception)


def test_disarm_vents_without_asking() -> None:
    with running_board() as board, controller(board):
        result = runner.invoke(app, ["disarm", address(board), "--person", "Ada"])
        assert result.exit_code == 0, result.output
        assert result.output == "vented: disarmed by Ada\n"


def test_board_config_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "board.yaml"
    path.write_text("watchdogg: 0.1\n")
    result = runner.invoke(app, ["board", str(path)])
    assert "did you mean 'watchdog'" in str(result.exception)


def test_board_of_a_robot_that_is_not_installed_says_its_channels(tmp_path: Path) -> None:
    path = tmp_path / "board.yaml"
    path.write_text("robot: athlete\n")
    result = runner.invoke(app, ["board", str(path), "--vent"])
    assert isinstance(result.exception, ConfigError)
    assert "unknown robot 'athlete'" in str(result.exception)
    assert "says its `channels` itself" in str(result.exception)
    path.write_text("robot: athlete\nchannels: [{name: calf}, {name: thigh, unit: N}]\n")
    result = runner.invoke(app, ["board", str(path), "--vent"])
    assert (result.exit_code, result.output) == (0, "valve board: all 2 channels vented\n")


def test_board_has_the_channels_of_its_robot(tmp_path: Path) -> None:
    path = tmp_path / "board.yaml"
    path.write_text("robot: pneumatic_arm\nwatchdog: 0.2\n")
    board = read_model(path, BoardConfig, "")
    channels = config_for("mujoco", robot={"name": "pneumatic_arm"}).simulation.actuators.channels
    assert [(one.name, one.rest, one.highest) for one in board.channels] == [(c.name, c.rest, c.high) for c in channels]


def test_default_address_is_that_of_the_board() -> None:
    assert parse_address(BOARD) == ("127.0.0.1", PORT)
    assert parse_address("robot") == ("robot", PORT)


@pytest.mark.parametrize("text", ["", ":7705", "robot:", "robot:x", "robot:70000"])
def test_what_is_no_address_is_told(text: str) -> None:
    with pytest.raises(ConfigError, match="is no address"):
        parse_address(text)
