"""Where two runs part: the first message, the first field, and how far each channel has gone apart."""

from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from math import inf, isfinite
from pathlib import Path
from typing import Any

from imolo.inspect.fields import Path as LeafPath
from imolo.inspect.fields import Value, leaf_name, leaves
from imolo.inspect.names import Names
from imolo.inspect.trials import TrialEvents
from imolo.messaging.channels import CHANNELS, ROBOT, TRIAL
from imolo.messaging.log import decode
from imolo.messaging.log_file import LogEvent, LogReader

SHOWN = 16  # [bytes] of a message that is not ours
BACKEND: LeafPath = ("backend",)  # in TRIAL; who played is no difference in what was played


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

    @property
    def of_backend(self) -> bool:
        """Whether it is only the name of who played."""
        return self.channel == TRIAL and self.field == "backend"

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
        first: Their earliest difference, that of the backend's name only if there is no other; None if all messages
            are the same.
        same_recording: Whether the messages were also recorded in the same order and at the same times.
    """

    channels: tuple[ChannelComparison, ...]
    first: Difference | None
    same_recording: bool


def compare_logs(first: Path, second: Path, trials: tuple[int | None, int | None] = (None, None)) -> RunComparison:
    """Compare two logs message by message.

    Args:
        first: Path of a log.
        second: Path of the other one.
        trials: Which trial of each, from 0; None where a log holds one alone.

    Raises:
        BusError: One of them is missing or no log, has no such trial, or has several and none is chosen.
    """
    with LogReader(first, CHANNELS) as one, LogReader(second, CHANNELS) as other:
        runs = _Run(one), _Run(other)
        events = [
            _of_trial(run, TrialEvents(reader, trial, only_one=True))
            for run, reader, trial in zip(runs, (one, other), trials, strict=True)
        ]
        return _compare(*runs, _collect(*runs, *events))


def _of_trial(run: "_Run", events: TrialEvents) -> Iterator[LogEvent]:
    every = iter(events)
    for event in every:
        if events.trial is not None:
            run.zero = events.offset - events.reader.shift
        yield event
        yield from every


def compare_runs(first: Sequence[LogEvent], second: Sequence[LogEvent]) -> RunComparison:
    """Compare two sequences of events."""
    runs = _Run(), _Run()
    return _compare(*runs, _collect(*runs, iter(first), iter(second)))


def _collect(first: "_Run", second: "_Run", events: Iterator[LogEvent], others: Iterator[LogEvent]) -> bool:
    """Take the events of two runs, and remember none of a channel before the runs part on it.

    Most messages of two runs that are compared are the same, and stand at the same place in both.

    Returns:
        Whether all channels and times are the same.
    """
    in_step = in_time = True
    for one, other in zip_longest(events, others):
        in_step = in_step and one is not None and other is not None and one.channel == other.channel
        in_time = in_time and in_step and one.utime - first.zero == other.utime - second.zero
        same = in_step and one.channel not in first.places and bool(one.data) and one.data == other.data
        for run, event in ((first, one), (second, other)):
            if event is not None:
                run.add(event, same)
    return in_time


class _Run:
    """The events of a run by channel; of those of a log only their places are kept.

    Attributes:
        same: How many events by channel, the first ones of their channel, are the same in the other run.
        places: Where the others are: their offsets in the log, or they themselves.
        zero: Subtracted from all times, so that a trial of a session is on its own clock [µs].
    """

    def __init__(self, reader: LogReader | None = None) -> None:
        self._reader = reader
        self.same: Counter[str] = Counter()
        self.places: dict[str, Any] = {}
        self.zero = 0
        self._robot: LogEvent | None = None

    def add(self, event: LogEvent, same: bool) -> None:
        """Take an event; `same` says that the other run has it as well, and that its channel has been so so far."""
        channel = event.channel
        if channel == ROBOT and self._robot is None:
            self._robot = event
        self.same[channel] += same
        if same:
            return
        if channel not in self.places:
            self.places[channel] = [] if self._reader is None else array("q")
        self.places[channel].append(event if self._reader is None else event.offset)

    @property
    def counts(self) -> Counter[str]:
        """Number of events by channel, in the order in which they were heard."""
        return Counter({name: same + len(self.places.get(name, ())) for name, same in self.same.items()})

    def events(self, channel: str) -> Iterator[LogEvent]:
        """Yield the events of a channel from the first on that may differ."""
        for place in self.places.get(channel, ()):
            event = place if self._reader is None else self._reader.event(place)
            yield event._replace(utime=event.utime - self.zero) if self.zero else event

    def names(self) -> Names:
        """Return what the elements of its messages are called."""
        return Names(None if self._robot is None else decode(ROBOT, self._robot.data))

    def pieces(self, event: LogEvent) -> Iterator[bytes]:
        return iter([event.data]) if self._reader is None else self._reader.chunks(event)


def _compare(first: _Run, second: _Run, in_time: bool) -> RunComparison:
    names = [*first.counts, *second.counts]
    ordered = dict.fromkeys([*(name for name in CHANNELS if name in names), *names])
    called = first.names()
    compared = tuple(_compare_channel(name, first, second, called) for name in ordered)
    differences = [channel.first for channel in compared if channel.first is not None]
    same = not differences and in_time
    earliest = min(differences, key=lambda found: (found.of_backend, found.utime), default=None)
    return RunComparison(compared, earliest, same)


@dataclass
class _Parting:
    """What is different in the messages of one channel, as they are compared.

    Attributes:
        first: Path and values of the first difference.
        largest: Largest difference of a real number.
        largest_path: Where that is.
    """

    first: tuple[LeafPath, Value | None, Value | None] | None = None
    largest: float = 0.0
    largest_path: LeafPath = ()

    def note(self, path: LeafPath, one: Value | None, other: Value | None) -> None:
        if self.first is None or self.first[0] == BACKEND:
            self.first = path, one, other
        # Integers are times, counters and names; how far they are apart says nothing beside metres and pascals.
        if isinstance(one, float) and isinstance(other, float):
            gap = abs(one - other)
            gap = gap if isfinite(gap) else inf
            if gap > self.largest:
                self.largest, self.largest_path = gap, path


def _compare_channel(name: str, first: _Run, second: _Run, names: Names) -> ChannelComparison:
    parting = _Parting()
    difference: Difference | None = None
    equal = same = first.same[name]
    for index, (one, other) in enumerate(zip_longest(first.events(name), second.events(name)), same):
        if one is None or other is None:
            numbers = (one and one.number, other and other.number)
            if difference is None or difference.of_backend:
                difference = Difference(name, index, (one or other).utime, "", numbers)
            break
        if one.data and one.data == other.data:
            equal += 1
            continue
        messages = [decode(name, event.data) if name in CHANNELS else None for event in (one, other)]
        if None not in messages:
            _compare_values(messages[0], messages[1], (), parting)
        elif (place := _first_unequal_byte(first.pieces(one), second.pieces(other))) is not None:
            at, *there = place
            parting.note((f"bytes from {at}" if at else "bytes",), there[0].hex(), there[1].hex())
        else:
            equal += 1
            continue
        if difference is None or (difference.of_backend and parting.first and parting.first[0] != BACKEND):
            # The bytes differ where no number does: -0.0 is 0.0, or something follows the message.
            path, *values = parting.first or (("bytes",), one.data.hex(), other.data.hex())
            difference = Difference(name, index, one.utime, leaf_name(name, path, names), (values[0], values[1]))
    counts = first.counts[name], second.counts[name]
    largest = leaf_name(name, parting.largest_path, names)
    return ChannelComparison(name, counts, difference, equal, parting.largest, largest)


def _first_unequal_byte(first: Iterator[bytes], second: Iterator[bytes]) -> tuple[int, bytes, bytes] | None:
    """Return the place where data part, and what they hold from there on; None if they are the same."""
    start = 0
    for one, other in zip_longest(first, second, fillvalue=b""):
        if one != other:
            pairs = enumerate(zip(one, other, strict=False))
            inside = next((place for place, (a, b) in pairs if a != b), min(len(one), len(other)))
            return start + inside, one[inside : inside + SHOWN], other[inside : inside + SHOWN]
        start += len(one)
    return None


def _compare_values(one: Any, other: Any, path: LeafPath, found: _Parting) -> None:
    """Note every leaf of two values of the same type in which they differ."""
    if one == other:
        return
    if hasattr(one, "__slots__"):
        for name in one.__slots__:
            _compare_values(getattr(one, name), getattr(other, name), (*path, name), found)
    elif isinstance(one, list | tuple):
        for index, (element, its_other) in enumerate(zip(one, other, strict=False)):
            # Most of the time is spent here, on numbers that are neither the first to differ nor farthest apart.
            if type(element) is float and found.first is not None and abs(element - its_other) <= found.largest:
                continue
            _compare_values(element, its_other, (*path, index), found)
        if len(one) != len(other):
            shorter = min(len(one), len(other))
            there, value = next(leaves(max(one, other, key=len)[shorter], (*path, shorter)))
            found.note(there, *((value, None) if len(one) > shorter else (None, value)))
    elif repr(one) != repr(other):  # so that NaN is NaN
        found.note(path, one, other)
