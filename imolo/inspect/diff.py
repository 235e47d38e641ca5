"""Where two runs part: the first message, the first field, and how far each channel has gone apart."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np

from imolo.inspect.fields import Value, flatten
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import decode, warn_of_damage
from imolo.messaging.log_file import LogEvent, read_events


@dataclass(frozen=True)
class Difference:
    """The first difference of two sequences of messages.

    Attributes:
        channel: On which it is.
        index: Of the message among those of its channel.
        utime: When the message was recorded in the first run, or in the second where the first has none [µs].
        field: First field that differs; empty where one run has no such message.
        values: Of the two runs; None where a run has no such message or field.
    """

    channel: str
    index: int
    utime: int
    field: str
    values: tuple[Value | None, Value | None]

    def __str__(self) -> str:
        where = f"{self.channel} message {self.index} at {self.utime * 1e-6:.6f} s"
        if not self.field:
            return f"{where} is in {'the first' if self.values[0] is not None else 'the second'} run only"
        first, second = (repr(value) if value is not None else "nothing" for value in self.values)
        return f"{where}, {self.field}: {first} and {second}"


@dataclass(frozen=True)
class ChannelComparison:
    """One channel of two runs.

    Attributes:
        channel: Its name.
        counts: Number of messages in the two runs.
        first: The first difference; None if there is none.
        equal: Number of messages with the same bytes.
        largest: Largest difference of a real number between messages of the same index.
        largest_field: Where that is; empty where no number differs.
    """

    channel: str
    counts: tuple[int, int]
    first: Difference | None
    equal: int
    largest: float
    largest_field: str


@dataclass(frozen=True)
class RunComparison:
    """Two runs.

    Attributes:
        channels: Every channel that one of them has.
        first: The earliest of their first differences; None if all messages are the same.
        same_recording: Whether the messages were also recorded in the same order and at the same times.
    """

    channels: tuple[ChannelComparison, ...]
    first: Difference | None
    same_recording: bool


def compare_logs(first: Path, second: Path) -> RunComparison:
    """Compare two logs message by message.

    Raises:
        BusError: One of them is missing or no log.
    """
    runs = []
    for path in (first, second):
        events, damage = read_events(path)
        warn_of_damage(path, damage)
        runs.append(events)
    return compare_runs(*runs)


def compare_runs(first: Sequence[LogEvent], second: Sequence[LogEvent]) -> RunComparison:
    """Compare two sequences of events, channel by channel, so that it does not matter how channels interleave."""
    names = dict.fromkeys(event.channel for run in (first, second) for event in run)
    ordered = sorted(names, key=lambda name: list(CHANNELS).index(name) if name in CHANNELS else len(CHANNELS))
    compared = tuple(
        _compare_channel(name, *([event for event in run if event.channel == name] for run in (first, second)))
        for name in ordered
    )
    differences = [channel.first for channel in compared if channel.first is not None]
    same = [event[1:4] for event in first] == [event[1:4] for event in second]
    return RunComparison(compared, min(differences, key=lambda found: found.utime, default=None), same)


def _compare_channel(name: str, first: Sequence[LogEvent], second: Sequence[LogEvent]) -> ChannelComparison:
    difference: Difference | None = None
    largest, largest_field, equal = 0.0, "", 0
    for index, (one, other) in enumerate(zip_longest(first, second)):
        if one is not None and other is not None and one.data == other.data:
            equal += 1
            continue
        if one is None or other is None:
            event = one or other
            found = Difference(name, index, event.utime, "", (one and one.number, other and other.number))
            difference = difference or found
            break
        fields, other_fields = _fields(one), _fields(other)
        if difference is None:
            difference = _first_field(name, index, one.utime, fields, other_fields)
        for field, value in fields.items():
            gap = _gap(value, other_fields.get(field))
            if gap > largest:
                largest, largest_field = gap, field
    return ChannelComparison(name, (len(first), len(second)), difference, equal, largest, largest_field)


def _fields(event: LogEvent) -> dict[str, Value]:
    """Return the fields of an event; a message that is not ours or is damaged is one field."""
    message = decode(event.channel, event.data) if event.channel in CHANNELS else None
    return {"bytes": event.data.hex()} if message is None else dict(flatten(message))


def _first_field(name: str, index: int, utime: int, fields: dict[str, Value], other: dict[str, Value]) -> Difference:
    for field in dict.fromkeys([*fields, *other]):
        if not _same(fields.get(field), other.get(field)):
            return Difference(name, index, utime, field, (fields.get(field), other.get(field)))
    # The bytes differ where no field does: something follows the message.
    return Difference(name, index, utime, "bytes after the last field", (None, None))


def _same(one: Value | None, other: Value | None) -> bool:
    return repr(one) == repr(other)


def _gap(one: Value, other: Value | None) -> float:
    # Integers are times, counters and names; how far they are apart says nothing beside metres and pascals.
    if not isinstance(one, float) or not isinstance(other, float):
        return 0.0
    gap = abs(one - other)
    return gap if np.isfinite(gap) else (0.0 if _same(one, other) else float("inf"))
