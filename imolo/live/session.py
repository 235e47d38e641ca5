"""`imolo up`: a whole session at once. Starts backend, planner and recorder, throws balls, and stops them in order."""

import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from imolo.errors import BackendError
from imolo.live.identity import ClockMode, Identity, Role
from imolo.live.node import Node
from imolo.live.program import Console, Stop, run_node
from imolo.live.throw_program import ThrowRequest
from imolo.messaging.bus import Bus

STARTS = 5  # of a program that keeps dying, until the session gives up
PATIENCE = 10.0  # [s] for a program to end


@dataclass
class _Program:
    """A program of the session; it is started again when it is killed."""

    name: str
    command: Sequence[str]
    starts: int = 0
    process: "subprocess.Popen[bytes]" = field(init=False)

    def start(self) -> None:
        self.starts += 1
        # Its own group: Ctrl-C reaches the session alone, which then stops the programs in order.
        self.process = subprocess.Popen(self.command, start_new_session=True)


class Session:
    """Programs that belong together."""

    def __init__(self, url: str, console: Console) -> None:
        """Join the network.

        Raises:
            BusError: The bus cannot be opened.
        """
        self._bus, self._console = Bus(url), console
        self._node = Node(self._bus, Identity(Role.OPERATOR), console.say)
        self._node.activity = "watching"
        self._programs: list[_Program] = []

    def add(self, name: str, *arguments: object) -> None:
        """Start a program of ours."""
        command = [sys.executable, "-m", "imolo", name, *map(str, arguments), "--with-parent"]
        program = _Program(name, command)
        program.start()
        self._programs.append(program)

    def throw(self, count: int, stop: Stop) -> int:
        """Throw balls until all are thrown; return how many were not.

        Raises:
            BackendError: A program ended by itself, or keeps dying.
        """
        request = ThrowRequest(self._bus, self._node, count, self._console)

        def turn() -> None:
            self._look_after_programs()
            # Nothing is thrown that is not in the log.
            if self._node.peer(Role.RECORDER) and self._node.peer(Role.PLANNER):
                request.turn()
            self._console.status(lambda: f"{request.left} of {count} balls left")
            if not request.left:
                stop.ask()

        run_node(self._node, self._bus.wait, stop, turn)
        return request.left

    def close(self) -> None:
        """Stop all programs, the last started first, so that the recorder hears the end of the others."""
        for program in reversed(self._programs):
            if program.process.poll() is None:
                program.process.send_signal(signal.SIGTERM)
            try:
                program.process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                self._console.say(f"{program.name} {program.process.pid} does not end; killed")
                program.process.kill()
                program.process.wait()

    def _look_after_programs(self) -> None:
        for program in self._programs:
            code = program.process.poll()
            if code is None:
                continue
            if code >= 0:
                raise BackendError(f"{program.name} has ended with exit code {code}; the session is over")
            name = signal.Signals(-code).name
            if program.starts >= STARTS:
                raise BackendError(f"{program.name} was ended by {name} {STARTS} times; the session is over")
            self._console.say(f"{program.name} {program.process.pid} was ended by {name}; it is started again")
            program.start()


def run_session(
    config: str,
    url: str,
    clock: ClockMode,
    table_path: Path,
    method: str,
    count: int,
    folder: Path,
    stop: Stop,
    console: Console,
) -> int:
    """Run a session; return the number of balls that were not thrown.

    Raises:
        BusError: The bus cannot be opened.
        BackendError: A program ended by itself, or keeps dying.
    """
    session = Session(url, console)
    try:
        session.add("record", "--out", folder / "session.lcmlog", "--bus", url)
        session.add("planner", config, "--table", table_path, "--method", method, "--bus", url)
        session.add("backend", config, "--clock", clock.value, "--out", folder, "--bus", url)
        return session.throw(count, stop)
    finally:
        session.close()
        console.say(f"logs are in {folder}")
