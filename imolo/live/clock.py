"""Real time: a backend that waits for the clock on the wall, and tells when it could not keep up."""

import time
from collections.abc import Callable

GIVE_UP = 0.1  # [s] behind from which lost time is not made up for: a session goes on from now
RESOLUTION = 1e-6  # [s] of the messages


class Pace:
    """Holds a trial to the monotonic clock of the machine.

    Attributes:
        slices: Number of slices so far.
        overruns: Number of slices that ended after their time.
        worst: Longest delay of a slice [s].
        lost: Time that was not made up for [s].
    """

    def __init__(self, wait: Callable[[float], None], now: Callable[[], float] = time.monotonic) -> None:
        """Start with the first slice.

        Args:
            wait: Waits for this long at most [s], and does what else is to be done.
            now: The clock [s].
        """
        self.slices = self.overruns = 0
        self.worst = self.lost = 0.0
        self._wait, self._now = wait, now
        self._begin: float | None = None

    def restart(self) -> None:
        """Let time begin anew with the next slice."""
        self._begin = None

    def lateness(self, utime: int) -> float:
        """Return how long a time of the trial [µs] has been over [s]; negative while it is to come."""
        return 0.0 if self._begin is None else self._now() - self._begin - utime * 1e-6

    def hold(self, utime: int) -> None:
        """Wait until it is `utime` [µs] on the wall as well."""
        if self._begin is None:
            self._begin = self._now() - utime * 1e-6
        late = self.lateness(utime)
        self.slices += 1
        if late > RESOLUTION:
            self.overruns += 1
            self.worst = max(self.worst, late)
            if late > GIVE_UP:
                self._begin += late
                self.lost += late
        # Once at least, so that a backend that is behind still hears.
        self._wait(max(-late, 0.0))
        while (left := -self.lateness(utime)) > RESOLUTION:
            self._wait(left)
