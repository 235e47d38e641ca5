"""Programs of a session, started by a test: what they print can be waited for."""

import contextlib
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from network import URL

CHAOS = Path(__file__).with_name("chaos.py")
PATIENCE = 60.0  # [s] for anything that a program is waited for, on a busy machine


class Program:
    """A running `imolo` command."""

    def __init__(self, *arguments: object, chaos: tuple[int, float] | None = None) -> None:
        start = ["-m", "imolo.command_line.main"] if chaos is None else [str(CHAOS), *map(str, chaos)]
        self.name = str(arguments[0])
        self.process = subprocess.Popen(
            [sys.executable, *start, *map(str, arguments)], stderr=subprocess.PIPE, text=True, bufsize=1
        )
        self.lines: list[str] = []
        self._news = threading.Condition()
        self._seen = 0
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        return self.process.pid

    def wait_for(self, pattern: str, timeout: float = PATIENCE) -> re.Match[str]:
        """Return the next line that matches, counted from the last one that was waited for."""
        deadline = time.monotonic() + timeout
        with self._news:
            while True:
                while self._seen < len(self.lines):
                    self._seen += 1
                    found = re.search(pattern, self.lines[self._seen - 1])
                    if found:
                        return found
                left = deadline - time.monotonic()
                if left <= 0 or not self._reader.is_alive():
                    raise AssertionError(f"{self.name} did not say {pattern!r}:\n" + "".join(self.lines[-40:]))
                self._news.wait(min(left, 0.2))

    def kill(self) -> None:
        self.process.kill()
        self._end()

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Ask it to end; return its exit code."""
        self.process.send_signal(number)
        return self._end()

    def wait(self) -> int:
        return self._end()

    def _end(self) -> int:
        code = self.process.wait(PATIENCE)
        self._reader.join(PATIENCE)
        return code

    def _read(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as stream:
            for line in stream:
                with self._news:
                    self.lines.append(line)
                    self._news.notify_all()
        with self._news:
            self._news.notify_all()


class Lab:
    """Starts programs with the same config and table, and ends those that are left."""

    def __init__(self, config: Path, table: Path, folder: Path, clock: str) -> None:
        self.config, self.table, self.folder, self.clock = config, table, folder, clock
        self.session_log = folder / "session.lcmlog"
        self._programs: list[Program] = []

    def backend(self, *options: object, chaos: tuple[int, float] | None = None) -> Program:
        return self.start(
            "backend", self.config, "--clock", self.clock, "--out", self.folder, "--bus", URL, *options, chaos=chaos
        )

    def planner(self, *options: object, chaos: tuple[int, float] | None = None) -> Program:
        return self.start("planner", self.config, "--table", self.table, "--bus", URL, *options, chaos=chaos)

    def record(self) -> Program:
        return self.start("record", "--out", self.session_log, "--bus", URL)

    def throw(self, count: int) -> Program:
        return self.start("throw", count, "--bus", URL)

    def start(self, *arguments: object, chaos: tuple[int, float] | None = None) -> Program:
        program = Program(*arguments, chaos=chaos)
        self._programs.append(program)
        return program

    def close(self) -> None:
        for program in self._programs:
            if program.process.poll() is None:
                program.kill()

    def log(self, index: int) -> Path:
        return self.folder / f"hit_{index:03d}.lcmlog"


@contextlib.contextmanager
def lab(config: Path, table: Path, folder: Path, clock: str) -> Iterator[Lab]:
    opened = Lab(config, table, folder, clock)
    try:
        yield opened
    finally:
        opened.close()
