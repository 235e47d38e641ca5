"""What the actuators are to do now: the receiver's side of U, which switches phases on its own clock."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imolo.contracts.actuators import Channel
from imolo.method.commands import Commands

Array = NDArray[np.float64]


class CommandSchedule:
    """Holds the newest commands; before their onset the channels are at rest, after their end they are released."""

    def __init__(self, channels: Sequence[Channel]) -> None:
        """Start at rest."""
        self._rest = np.array([channel.rest for channel in channels])
        self._released = np.array([channel.released for channel in channels])
        self._commands: Commands | None = None

    def accept(self, commands: Commands) -> bool:
        """Take new commands; return whether they differ from the ones in force."""
        if commands == self._commands:
            return False
        self._commands = commands
        return True

    def target(self, utime: int) -> Array:
        """Return the targets of the channels at `utime` [µs], shape (C,)."""
        if self._commands is None or utime < self._commands.onset_utime:
            return self._rest
        target = self._commands.target(utime)
        return self._released if target is None else target

    def time_since_onset(self, utime: int) -> int | None:
        """Return how long the motion has been running [µs], or None before its onset."""
        if self._commands is None or utime < self._commands.onset_utime:
            return None
        return utime - self._commands.onset_utime

    def changes_after(self, utime: int) -> list[int]:
        """Return onset and switch times after `utime` [µs]."""
        if self._commands is None:
            return []
        return [time for time in (self._commands.onset_utime, *self._commands.switch_utime) if time > utime]
