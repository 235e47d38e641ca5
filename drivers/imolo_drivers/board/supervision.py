"""What ends the board's program, and who vents when it cannot: signals, and systemd's watchdog (sd_notify(3))."""

import contextlib
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator

# Nobody can catch the first two. The next four are a crash of the interpreter: a handler would return into it without
# end. The last ones do nothing anyway.
_LEFT_ALONE = {
    *(signal.SIGKILL, signal.SIGSTOP),
    *(signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL),
    *(signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH, signal.SIGPIPE),
}
BEATS = 4  # in systemd's watchdog time


@contextlib.contextmanager
def every_signal(ask: Callable[..., None]) -> Iterator[None]:
    """Let every signal that would end or stop the program ask for a clean end: a terminal that closes, Ctrl-Z, ..."""
    numbers = signal.valid_signals() - _LEFT_ALONE
    before = {number: signal.signal(number, ask) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


class Supervisor:
    """Tells systemd that the program is ready and not held up; nothing where systemd does not ask."""

    def __init__(self) -> None:
        """Look for what systemd wants to know."""
        where, period = os.environ.get("NOTIFY_SOCKET", ""), os.environ.get("WATCHDOG_USEC", "")
        self._address = f"\0{where[1:]}" if where.startswith("@") else where
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) if where else None
        self._period = int(period) * 1e-6 / BEATS if period.isdigit() else 0.0
        self._next = 0.0

    def ready(self) -> None:
        """Tell that the board listens."""
        self._tell(b"READY=1")

    def turned(self) -> None:
        """Tell that the board's loop is not held up, if it is time."""
        if self._period and (now := time.monotonic()) >= self._next:
            self._next = now + self._period
            self._tell(b"WATCHDOG=1")

    def _tell(self, state: bytes) -> None:
        # What systemd does not hear it acts upon.
        with contextlib.suppress(OSError):
            if self._socket is not None:
                self._socket.sendto(state, self._address)
