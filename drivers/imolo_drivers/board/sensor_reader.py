"""Reads the sensors in a thread of its own, so that a converter that blocks holds nothing else up."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from imolo.errors import BackendError

LAST_WORDS = 0.2  # [s] that the end of the board waits for a reading


@dataclass(frozen=True)
class Reading:
    """What the sensors said.

    Attributes:
        utime: Time at which they were asked [µs].
        measured: What is behind each channel [unit], shape (N,); empty before the first reading.
        fault: Why they said nothing; empty where they did.
    """

    utime: int
    measured: Sequence[float] = ()
    fault: str = ""


class SensorReader:
    """Asks the sensors when told to, one reading at a time."""

    def __init__(self, read: Callable[[], Sequence[float]], patience: int) -> None:
        """Start the thread.

        Args:
            read: Asks the sensors; may block.
            patience: How long a reading may take before it counts as a fault [µs].
        """
        self._read, self._patience = read, patience
        self._asked_utime, self._is_busy, self._is_closed = 0, False, False
        self._newest = Reading(0)
        self._asked = threading.Semaphore(0)
        self._thread = threading.Thread(target=self._run, name="sensors", daemon=True)
        self._thread.start()

    def ask(self, utime: int) -> None:
        """Begin a reading at `utime` [µs], unless one is under way."""
        if not self._is_busy:
            self._asked_utime, self._is_busy = utime, True
            self._asked.release()

    def newest(self, utime: int) -> Reading:
        """Return the newest reading that is known at `utime` [µs], or what keeps it away."""
        waited = utime - self._asked_utime
        if self._is_busy and waited > self._patience:
            return Reading(self._asked_utime, fault=f"the sensors have not answered for {waited / 1000:.1f} ms")
        return self._newest

    def close(self) -> None:
        """End the thread, or leave it alone if the sensors hold it."""
        self._is_closed = True
        self._asked.release()
        self._thread.join(LAST_WORDS)

    def _run(self) -> None:
        while self._asked.acquire() and not self._is_closed:
            utime = self._asked_utime
            try:
                self._newest = Reading(utime, tuple(self._read()))
            except BackendError as error:
                self._newest = Reading(utime, fault=str(error))
            except Exception as error:  # noqa: BLE001 - a thread that ends would leave the last reading standing
                self._newest = Reading(utime, fault=f"the sensors cannot be read: {type(error).__name__}: {error}")
            self._is_busy = False
