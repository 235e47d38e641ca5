"""What a controller commands, checked against the channels of the board; the one place that knows the message."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from imolo.method.commands import wrap
from imolo_drivers.board.config import BoardConfig, ChannelConfig
from imolo_drivers.board.refusal import RefusalCode, RefusedError
from imolo_msgs import actuator_command_t

Targets = tuple[float, ...]


@dataclass(frozen=True)
class Motion:
    """What every channel does from the onset of a motion to its end, on the clock of the board.

    Attributes:
        onset_utime: Start of phase 1 [µs].
        switch_utime: End of each phase [µs], strictly increasing, shape (P,).
        target: Target of each channel in each phase, within its limit [unit], shape (P, N).
        is_clamped: Whether more was asked for.
    """

    onset_utime: int
    switch_utime: tuple[int, ...]
    target: tuple[Targets, ...]
    is_clamped: bool

    @property
    def end_utime(self) -> int:
        """End of the last phase [µs]."""
        return self.switch_utime[-1]

    def phase(self, utime: int) -> int:
        """Return the phase at a time [µs], from 1; 0 before the onset and from the end on."""
        if not self.onset_utime <= utime < self.end_utime:
            return 0
        return bisect_right(self.switch_utime, utime) + 1

    def next_change(self, utime: int) -> int:
        """Return when the next phase begins or the last one ends [µs]."""
        return next(time for time in (self.onset_utime, *self.switch_utime) if time > utime)


def make_command(
    sequence: int, onset_utime: int, switch_utime: Sequence[int], target: Sequence[Sequence[float]]
) -> actuator_command_t:
    """Return the message that commands a motion.

    Args:
        sequence: Number of the command; wraps after 2**31 - 1, see `wrap`.
        onset_utime: Start of phase 1, on the clock of the board [µs].
        switch_utime: End of each phase [µs], shape (P,).
        target: Target of each channel in each phase [unit], shape (P, N).
    """
    message = actuator_command_t()
    message.command_sequence, message.onset_utime = wrap(sequence), onset_utime
    message.switch_utime, message.target = list(switch_utime), [list(row) for row in target]
    message.num_phases = len(message.target)
    message.num_targets = len(message.target[0]) if message.target else 0
    return message


def read_command(message: actuator_command_t, config: BoardConfig) -> Motion:
    """Check a message.

    Raises:
        RefusedError: It cannot be followed.
    """
    if message.num_targets != len(config.channels):
        raise _refused(f"the command has {message.num_targets} channels; this board has {len(config.channels)}")
    times = (message.onset_utime, *message.switch_utime)
    if len(times) == 1:
        raise _refused("the command has no phases; give at least one switch time")
    for earlier, later in pairwise(times):
        if later <= earlier:
            raise _refused(f"switch_utime {later} does not come after {earlier}; give strictly increasing times [us]")
    for phase, row in enumerate(message.target, start=1):
        for channel, target in zip(config.channels, row, strict=True):
            if not (math.isfinite(target) and channel.lowest <= target <= channel.highest):
                raise _refused(_out_of_range(channel, phase, target))
    clamped = tuple(clamp(row, config) for row in message.target)
    is_clamped = any(tuple(row) != kept for row, kept in zip(message.target, clamped, strict=True))
    return Motion(message.onset_utime, tuple(message.switch_utime), clamped, is_clamped)


def clamp(targets: Sequence[float], config: BoardConfig) -> Targets:
    """Return targets that are no farther from 0 than their limits [unit]."""
    limits = [config.limit(channel) for channel in config.channels]
    return tuple(min(max(target, -limit), limit) for target, limit in zip(targets, limits, strict=True))


def slew(wanted: Sequence[float], given: Sequence[float], steps: Sequence[float]) -> Targets:
    """Return the targets that may be given next: away from 0 by a step at most, towards it at once.

    Args:
        wanted: Targets that are to be reached, shape (N,).
        given: Targets in force, shape (N,).
        steps: Largest departure from 0, shape (N,).
    """
    return tuple(
        math.copysign(min(abs(new), (abs(old) if old * new > 0.0 else 0.0) + step), new)
        for new, old, step in zip(wanted, given, steps, strict=True)
    )


def is_newer(sequence: int, known: int) -> bool:
    """Return whether a number of 32 bits, signed or not, was counted after another one, less than 2**31 before."""
    return wrap(sequence - known) > 0


def _refused(reason: str) -> RefusedError:
    return RefusedError(RefusalCode.VALUES, reason)


def _out_of_range(channel: ChannelConfig, phase: int, target: float) -> str:
    return (
        f"the target of {channel.name!r} in phase {phase} is {target:g} {channel.unit}; "
        f"give {channel.lowest:g} to {channel.highest:g} {channel.unit}"
    )
