"""What the valves are to do now: the receiver's side of U, which switches phases on its own clock."""

from imolo.contracts.engine import Array
from imolo.method.motion import Commands


class ValveSchedule:
    """Holds the newest commands; before their onset the valves keep the rest pressures."""

    def __init__(self, rest_pressure: Array) -> None:
        """Start at rest.

        Args:
            rest_pressure: Gauge pressures before the onset [Pa], shape (8,).
        """
        self._rest_pressure = rest_pressure
        self._commands: Commands | None = None

    def accept(self, commands: Commands) -> bool:
        """Take new commands; return whether they differ from the ones in force."""
        if commands == self._commands:
            return False
        self._commands = commands
        return True

    def target(self, utime: int) -> Array:
        """Return the target gauge pressures at `utime` [Pa], shape (8,)."""
        target = self._commands.target(utime) if self._commands else None
        return self._rest_pressure if target is None else target

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
