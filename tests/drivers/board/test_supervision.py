"""What ends the board vents it, and what freezes or kills it is left to systemd, which is told the right things."""

import configparser
import contextlib
import importlib.resources
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from board_link import PATIENCE
from typer.testing import CliRunner

from imolo.command_line.main import app
from imolo_drivers.board.board import BoardState
from imolo_drivers.board.client import BoardClient, LinkLostError
from imolo_drivers.board.command import make_command
from imolo_drivers.board.handshake import ClientRole
from imolo_drivers.board.server import monotonic_utime
from imolo_drivers.board.supervision import Supervisor

# All that end or stop a program by default; SIGKILL and SIGSTOP cannot be caught, and the rest is a crash.
CAUGHT = [
    *("SIGHUP", "SIGINT", "SIGQUIT", "SIGTERM", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGUSR1", "SIGUSR2", "SIGALRM"),
    *("SIGABRT", "SIGXCPU", "SIGVTALRM", "SIGPROF", "SIGIO", "SIGRTMIN"),
]


@contextlib.contextmanager
def board_program(*config: str, **environment: str) -> Iterator[tuple["subprocess.Popen[str]", int]]:
    """Run `imolo board`; yields it and its port."""
    command = [sys.executable, "-m", "imolo.command_line.main", "board", *config, "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, **environment}) as program:
        try:
            assert program.stderr is not None
            yield program, int(re.findall(r"127\.0\.0\.1:(\d+)", program.stderr.readline())[0])
        finally:
            program.kill()


def hears(systemd: socket.socket) -> bool:
    try:
        return bool(systemd.recv(100))
    except TimeoutError:
        return False


@pytest.mark.parametrize(
    "name", [CAUGHT[0], CAUGHT[2], *[pytest.param(name, marks=pytest.mark.slow) for name in CAUGHT]]
)
def test_signal_ends_the_board_vented(name: str, tmp_path: Path) -> None:
    """It holds pressure; the last state that it tells shows that it has let go of it."""
    (tmp_path / "board.yaml").write_text("name: arm\nchannels: [{name: a}]\nwatchdog: 1.0\nrise_limit: 0.0\n")
    with board_program(str(tmp_path / "board.yaml")) as (program, port):
        client = BoardClient(("127.0.0.1", port), ClientRole.CONTROLLER, "test", PATIENCE)
        operator = BoardClient(("127.0.0.1", port), ClientRole.OPERATOR, "test", PATIENCE)
        with contextlib.closing(client), contextlib.closing(operator):
            client.synchronise()
            operator.arm(client.welcome.controller_session, "test")
            assert operator.wait(lambda: operator.state.num_armed == 1, PATIENCE)
            now = monotonic_utime() + client.offset.utime
            client.command(make_command(1, now, (now + 5_000_000,), ((3e5,),)))
            assert operator.wait(lambda: operator.state.given_target == (3e5,), PATIENCE)
            program.send_signal(getattr(signal, name))
            assert program.wait(PATIENCE) == (130 if name == "SIGINT" else 0)
            # What was said before the end can still be read.
            with pytest.raises(LinkLostError):
                operator.wait(lambda: False, PATIENCE)
            assert operator.state.given_target == (0.0,)
            assert BoardState(operator.state.board_state) is BoardState.VENTED
            assert operator.state.state_cause == "the board program ended"


def test_every_signal_that_ends_a_program_is_caught() -> None:
    with board_program() as (program, _):
        caught = int(re.findall(r"SigCgt:\s*(\w+)", Path(f"/proc/{program.pid}/status").read_text())[0], 16)
    assert all(caught >> getattr(signal, name) - 1 & 1 for name in CAUGHT)


def test_systemd_hears_that_the_board_is_ready_and_alive_and_not_when_it_is_frozen(tmp_path: Path) -> None:
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(path)
        systemd.settimeout(PATIENCE)
        with board_program(NOTIFY_SOCKET=path, WATCHDOG_USEC="300000") as (program, _):
            assert [systemd.recv(100) for _ in range(4)] == [b"READY=1", *[b"WATCHDOG=1"] * 3]
            program.send_signal(signal.SIGSTOP)
            os.waitid(os.P_PID, program.pid, os.WSTOPPED)
            systemd.settimeout(0.3)  # [s] of systemd's watchdog
            # What was sent before is heard still.
            assert not all(hears(systemd) for _ in range(20))


def test_board_without_systemd_tells_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    supervisor = Supervisor()
    supervisor.ready()
    supervisor.turned()
    assert supervisor._socket is None


def test_systemd_that_is_gone_does_not_matter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    supervisor = Supervisor()
    supervisor.ready()
    assert supervisor._socket is not None
    supervisor._socket.close()


def test_unit_vents_after_every_end_and_kills_what_is_frozen() -> None:
    unit = configparser.ConfigParser(strict=True)
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read_string(importlib.resources.files("imolo_drivers.board").joinpath("imolo-board.service").read_text())
    service = unit["Service"]
    assert (service["Type"], service["NotifyAccess"], service["Restart"]) == ("notify", "main", "always")
    assert (service["WatchdogSec"], service["WatchdogSignal"]) == ("300ms", "SIGKILL")
    start, vent = shlex.split(service["ExecStart"]), shlex.split(service["ExecStopPost"])
    # Both are commands that there are, for the same board.
    assert start[:3] == vent[:3]
    assert vent[3:] == ["--vent"]
    for options in (start[3:], vent[3:]):
        result = CliRunner().invoke(app, ["board", "none.yaml", *options])
        assert "cannot read the config none.yaml" in str(result.exception)


def test_vent_gives_all_channels_zero(tmp_path: Path) -> None:
    config = tmp_path / "board.yaml"
    config.write_text("name: arm\nchannels: [{name: a}, {name: b}, {name: c}]\nsecret: none\n")
    result = CliRunner().invoke(app, ["board", str(config), "--vent"])
    assert (result.exit_code, result.output) == (0, "arm: all 3 channels vented\n")
