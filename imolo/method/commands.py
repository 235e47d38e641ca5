"""The time series of the control target U (Sec. III): what every actuator is asked for, from the onset to the end.

Phases are counted from 1 as in the paper. Phase i lasts from the end of phase i - 1 (the onset for i = 1) to t_i,
its own end excluded.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from imolo.contracts.actuators import Channel
from imolo.errors import MessageError
from imolo_msgs import actuator_command_t

Array = NDArray[np.float64]


def to_microseconds(time: float) -> int:
    """Round a time [s] to the whole microseconds of the messages."""
    return round(time * 1e6)


def wrap(sequence: int) -> int:
    """Return a number as the 32 bits of a message hold it: -2**31 follows 2**31 - 1."""
    return (sequence + 2**31) % 2**32 - 2**31


@dataclass(frozen=True, eq=False)
class Commands:
    """The time series of the control target U (Sec. III), on the clock of the messages.

    Attributes:
        onset_utime: Start of phase 1 [µs].
        switch_utime: End of each phase [µs], strictly increasing, shape (P,).
        targets: Control target of every channel in each phase, in the channel's unit, shape (P, C), read-only.

    Raises:
        MessageError: The shapes disagree, a target is not finite, or the times do not increase.
    """

    onset_utime: int
    switch_utime: tuple[int, ...]
    targets: Array

    def __post_init__(self) -> None:
        targets = np.array(self.targets, dtype=np.float64)
        targets.flags.writeable = False
        object.__setattr__(self, "targets", targets)
        phases = len(self.switch_utime)
        if phases == 0:
            raise MessageError("commands have no phases; give at least one switch time")
        if targets.ndim != 2 or len(targets) != phases:
            raise MessageError(f"targets have shape {targets.shape}; give one row for each of the {phases} phases")
        if not np.isfinite(targets).all():
            phase, channel = np.argwhere(~np.isfinite(targets))[0]
            raise MessageError(
                f"target of channel {channel + 1} in phase {phase + 1} is {targets[phase, channel]}; give a finite one"
            )
        for earlier, later in pairwise((self.onset_utime, *self.switch_utime)):
            if later <= earlier:
                raise MessageError(
                    f"switch_utime {later} does not come after {earlier}; give strictly increasing times [µs] after "
                    f"onset_utime {self.onset_utime}"
                )

    def __eq__(self, other: object) -> bool:
        """Return whether onset, switch times and targets are all equal."""
        if not isinstance(other, Commands):
            return NotImplemented
        return (
            self.onset_utime == other.onset_utime
            and self.switch_utime == other.switch_utime
            and np.array_equal(self.targets, other.targets)
        )

    __hash__ = None  # type: ignore[assignment]

    @property
    def end_utime(self) -> int:
        """End of the last phase [µs]."""
        return self.switch_utime[-1]

    def target(self, utime: int) -> Array | None:
        """Return the control target u in force at a time.

        Args:
            utime: Time [µs].

        Returns:
            Targets of the channels, shape (C,), read-only; None before the onset and from the end on, where a channel
            has a target of its own that U does not know (`Channel.rest`, `Channel.released`).
        """
        if not self.onset_utime <= utime < self.end_utime:
            return None
        return np.asarray(self.targets[bisect_right(self.switch_utime, utime)])

    def matches_until(self, other: "Commands", utime: int) -> bool:
        """Return whether both command the same before a time, so that one may replace the other then (Fig. 4e).

        Args:
            other: The commands to compare with.
            utime: End of the executed part, itself excluded ("prior to time t_e", Sec. IV-B3) [µs]; give the earliest
                time at which new commands can take effect.
        """
        changes = {self.onset_utime, other.onset_utime, *self.switch_utime, *other.switch_utime}
        return all(self._agrees_at(at, other) for at in changes if at < utime)

    def _agrees_at(self, utime: int, other: "Commands") -> bool:
        mine, theirs = self.target(utime), other.target(utime)
        if mine is None or theirs is None:
            return mine is theirs and (utime < self.onset_utime) == (utime < other.onset_utime)
        return np.array_equal(mine, theirs)

    def to_message(self, utime: int, command_sequence: int, commander: int = 0) -> actuator_command_t:
        """Return the message that carries these commands.

        Args:
            utime: Time of the mocap frame the commands answer [µs].
            command_sequence: Number of the message; goes on as `wrap` says.
            commander: Instance of the program that commands; 0 where there is but one.
        """
        message = actuator_command_t()
        message.utime = utime
        message.command_sequence = wrap(command_sequence)
        message.onset_utime = self.onset_utime
        message.commander = commander
        message.num_phases, message.num_targets = self.targets.shape
        message.switch_utime = list(self.switch_utime)
        message.target = self.targets.tolist()
        return message

    @classmethod
    def from_message(cls, message: actuator_command_t, channels: Sequence[Channel]) -> Self:
        """Read and check a message.

        Args:
            message: The message.
            channels: What it commands.

        Raises:
            MessageError: A value cannot be used.
        """
        for name in ("switch_utime", "target"):
            length = len(getattr(message, name))
            if length != message.num_phases:
                raise MessageError(f"{name} has {length} entries; num_phases promises {message.num_phases}")
        for phase, row in enumerate(message.target, start=1):
            if len(row) != len(channels):
                raise MessageError(f"phase {phase} has {len(row)} targets; give {len(channels)}, one per channel")
        commands = cls(message.onset_utime, tuple(message.switch_utime), np.array(message.target, dtype=float))
        low, high = np.array([(channel.low, channel.high) for channel in channels]).T
        outside = (commands.targets < low) | (commands.targets > high)
        if outside.any():
            phase, index = np.argwhere(outside)[0]
            channel = channels[index]
            raise MessageError(
                f"target of {channel.name!r} in phase {phase + 1} is {commands.targets[phase, index]:g} "
                f"{channel.unit}; give {channel.low:g} to {channel.high:g} {channel.unit}"
            )
        return commands
