"""What the server's clock shows in the time of this machine, from echoes."""

from dataclasses import dataclass


@dataclass(frozen=True)
class _Echo:
    offset: float
    error: float
    time: float


class ServerClock:
    """Maps ticks of the server to our monotonic clock.

    The server read its clock some time between our question and its answer, so the middle of the two is off by at most
    half the round trip. The best echo so far is kept until its error has grown, by the drift of the clocks, to that of
    a new one, or until a new one contradicts it, because the server was started again.
    """

    def __init__(self, frequency: int, drift: float) -> None:
        """Prepare for a server.

        Args:
            frequency: Of its clock [ticks/s].
            drift: Between the two clocks at most [-].
        """
        self._frequency = frequency
        self._drift = drift
        self._best: _Echo | None = None

    def add_echo(self, sent: float, ticks: int, received: float) -> None:
        """Take an echo: question sent and answer received [s], and the server's clock in between [ticks]."""
        echo = _Echo(0.5 * (sent + received) - ticks / self._frequency, 0.5 * (received - sent), received)
        best = self._best
        if best is not None:
            error = self._error_at(received, best)
            if error < echo.error and abs(echo.offset - best.offset) <= error + echo.error:
                return
        self._best = echo

    def local_time(self, ticks: int) -> tuple[float, float] | None:
        """Return our monotonic time of a tick and its greatest error [s]; None before the first echo."""
        if self._best is None:
            return None
        time = ticks / self._frequency + self._best.offset
        return time, self._error_at(time, self._best)

    def _error_at(self, time: float, echo: _Echo) -> float:
        return echo.error + self._drift * abs(time - echo.time)
