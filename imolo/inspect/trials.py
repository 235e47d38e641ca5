"""The trials of a log: a trial's own log holds one, what `imolo record` writes of a session many, each from zero."""

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

from imolo.contracts.trial import EventName
from imolo.errors import BusError
from imolo.messaging.channels import SESSION, TRIAL
from imolo.messaging.log import decode, decoded
from imolo.messaging.log_file import LogEvent, LogReader


class TrialEvents:
    """The events of a log or of one of its trials.

    Attributes:
        reader: Reads the log.
        trial: Which trial, from 0; None for everything.
        count: Number of trials that have started so far.
        start: The event with which the newest trial started; None before the first.
        offset: When the newest trial's clock was zero, on the recording's rising clock [µs].
        heard: Channels so far.
    """

    def __init__(self, reader: LogReader, trial: int | None = None, only_one: bool = False) -> None:
        """Prepare a log.

        Args:
            reader: Reads the log; its `with_data` holds TRIAL.
            trial: Which trial, from 0 in the order of the log; None for everything there is. What the programs of a
                session say to each other belongs to no trial.
            only_one: Refuse a log of several trials where none is chosen.
        """
        self.reader = reader
        self.count = 0
        self.start: Any | None = None
        self.offset = 0
        self.heard: set[str] = set()
        self.trial, self._only_one = trial, only_one
        self._started_with = b""

    def __iter__(self) -> Iterator[LogEvent]:
        """Yield the events.

        Raises:
            BusError: The log cannot be read, has no such trial, or has several where only one is asked for.
        """
        for event in self.reader:
            if event.channel != TRIAL:
                self._started_with = b""
            elif event.data != self._started_with:  # a start right after the same start is a copy of it
                self._begin(event)
            if self.trial is not None:
                if self.count > self.trial + 1:
                    return
                if self.count <= self.trial or event.channel in SESSION:
                    continue
            self.heard.add(event.channel)
            yield event
        if self.trial is not None and self.count <= self.trial:
            held = "no start of a trial" if not self.count else f"{self.count} trials, counted from 0"
            raise BusError(f"{self.reader.path} has no trial {self.trial}; it holds {held}")

    def nothing(self) -> BusError:
        """Return what to raise where none of the events was a message of ours."""
        return BusError(f"{self.reader.path} holds no message of a channel of ours; `imolo top` lists what it holds")

    def _begin(self, event: LogEvent) -> None:
        message = decode(TRIAL, event.data)
        if message is None or message.event != EventName.START:
            return
        self.count += 1
        self.start, self._started_with = message, event.data
        self.offset = event.utime + self.reader.shift - message.utime
        if self._only_one and self.trial is None and self.count > 1:
            raise BusError(
                f"{self.reader.path} holds several trials; choose one with --trial, such as --trial 0 for the first"
            )


class Heard(NamedTuple):
    """A message of a log.

    Attributes:
        time: What the message tells about: its own time on the recording's clock, which rises from trial to trial [µs].
        trial: Number of its trial, from 0; -1 before the first.
        event: As it stands in the log.
        message: What it holds.
    """

    time: int
    trial: int
    event: LogEvent
    message: Any


class Timeline:
    """The messages of a log on one clock, on which its trials follow one another.

    Attributes:
        events: The log.
        origin: Zero of the first trial on that clock [µs]; right when all was read.
    """

    def __init__(self, events: TrialEvents, wanted: Collection[str]) -> None:
        """Prepare the messages of some channels of ours."""
        self.events = events
        self.origin = 0
        self._wanted = wanted

    def __iter__(self) -> Iterator[Heard]:
        """Yield the messages in the order of the log.

        Raises:
            BusError: See `TrialEvents` and `decoded`.
        """
        trials = 0
        offset: int | None = None  # of the clock in the messages
        newest: int | None = None
        for event, message in decoded(self.events, self.events.reader, self._wanted):
            recorded = event.utime + self.events.reader.shift
            own: int | None = getattr(message, "utime", None)
            if self.events.count > trials:
                offset = self.events.offset
                if newest is not None and self.events.start is not None:
                    # A trial may run faster than it was recorded; then the next one would begin before its end.
                    offset = max(offset, newest - self.events.start.utime)
                self.origin = offset if trials == 0 else self.origin
                trials = self.events.count
            elif offset is None and own is not None:
                offset = recorded - own
            time = recorded if own is None or offset is None else own + offset
            if newest is None and trials == 0:
                self.origin = recorded if offset is None else offset
            newest = time if newest is None else max(newest, time)
            yield Heard(time, trials - 1, event, message)
