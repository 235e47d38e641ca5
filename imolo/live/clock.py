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
        heavy: Number of slices for which the program itself computed longer than they last; behind other overruns is a
            machine that is busy with other programs.
        worst: Longest delay of a slice [s].
        lost: Time that was not made up for [s].
        computed: Time that the program itself computed [s].
        played: Time of the trials [s].
    """

    def __init__(
        self,
        wait: Callable[[float], None],
        now: Callable[[], float] = time.monotonic,
        computing: Callable[[], float] = time.thread_time,
    ) -> None:
        """Start with the first slice.

        Args:
            wait: Waits for this long at most [s], and does what else is to be done.
            now: The clock [s].
            computing: How long this thread has been computing [s].
        """
        self.slices = self.overruns = self.heavy = 0
        self.worst = self.lost = self.computed = self.played = 0.0
        self._wait, self._now, self._computing = wait, now, computing
        self._begin: float | None = None
        self._utime = 0
        self._mark = 0.0

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
        else:
            work, length = self._computing() - self._mark, 1e-6 * (utime - self._utime)
            self.computed += work
            self.played += length
            self.heavy += work > length
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
        self._utime, self._mark = utime, self._computing()
