"""What all programs of a session share: lines for the user, a status line, and a clean end."""

import contextlib
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from queue import SimpleQueue

from imolo.command_line.terminal import plain
from imolo.live.node import BEAT, Node

TERMINAL_STATUS = 0.5  # [s] between two status lines on a terminal, where each replaces the last
FILE_STATUS = 10.0  # [s] elsewhere
LAST_WORDS = 1.0  # [s] that the end of a program waits for a terminal


class Console:
    """Prints to the standard error stream: lines that stay, and a status line that is replaced."""

    def __init__(self, name: str) -> None:
        """Print as program `name`."""
        self._name = name
        self._terminal = sys.stderr.isatty()
        self._period = TERMINAL_STATUS if self._terminal else FILE_STATUS
        self._next = time.monotonic() + TERMINAL_STATUS
        self._open = False

    def say(self, text: str) -> None:
        """Print a line; programs of others are quoted in it."""
        self._clear()
        print(f"imolo {self._name}: {plain(text)}", file=sys.stderr, flush=True)

    def status(self, text: Callable[[], str]) -> None:
        """Print the status line if it is time."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + self._period
        line = f"imolo {self._name}: {plain(text())}"
        if self._terminal:
            self._clear()
            print(line[: shutil.get_terminal_size().columns - 1], end="", file=sys.stderr, flush=True)
            self._open = True
        else:
            print(line, file=sys.stderr, flush=True)

    def _clear(self) -> None:
        if self._open:
            print("\r\x1b[K", end="", file=sys.stderr)
            self._open = False


@contextlib.contextmanager
def in_background(say: Callable[[str], None]) -> Iterator[Callable[[str], None]]:
    """Return what says lines from a thread of its own.

    A terminal that is held up, by Ctrl-S or a slow network, holds up whoever prints to it; valves cannot wait for it.
    """
    lines: SimpleQueue[str | None] = SimpleQueue()

    def say_all() -> None:
        while (line := lines.get()) is not None:
            say(line)

    thread = threading.Thread(target=say_all, daemon=True)
    thread.start()
    try:
        yield lines.put
    finally:
        lines.put(None)
        thread.join(LAST_WORDS)


class Stop:
    """Whether the program has been asked to end, by Ctrl-C, by SIGTERM or by the death of its session."""

    def __init__(self, with_parent: bool = False) -> None:
        """Watch the parent as well if `with_parent`."""
        self._asked = False
        self.interrupted = False  # by Ctrl-C
        self._parent = os.getppid() if with_parent else 0

    def __bool__(self) -> bool:
        return self._asked or (self._parent != 0 and os.getppid() != self._parent)

    def ask(self, signal_number: int = 0, _: object = None) -> None:
        """Ask the program to end; also a handler of signals."""
        self._asked = True
        self.interrupted |= signal_number == signal.SIGINT


@contextlib.contextmanager
def until_stopped(with_parent: bool = False) -> Iterator[Stop]:
    """Turn SIGINT and SIGTERM into a wish that the program grants when its log is whole.

    Raises:
        KeyboardInterrupt: It was Ctrl-C, and the program has ended.
    """
    stop = Stop(with_parent)
    before = {number: signal.signal(number, stop.ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if stop.interrupted:
        raise KeyboardInterrupt


def run_node(node: Node, wait: Callable[[float], None], stop: Stop, turn: Callable[[], None]) -> None:
    """Wait for messages, keep the heart beating and take a turn after each wait, until the stop."""
    try:
        while not stop:
            node.tend()
            wait(BEAT / 2)
            turn()
    finally:
        node.close()
