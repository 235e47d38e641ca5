"""What a channel does: rate, jitter, age, and messages that are missing from its numbering."""

from collections import deque
from collections.abc import Iterable
from math import sqrt
from typing import Any

from imolo.messaging import channels
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import decode
from imolo.messaging.log_file import LogEvent

SEQUENCE_FIELDS = {
    channels.ACTUATOR_COMMAND: "command_sequence",
    channels.ACTUATOR_STATE: "state_sequence",
    channels.MOCAP: "frame_number",
    channels.PLAN: "answered_frame",
}
WINDOW = 1.0  # [s] over which the rate of a running session is counted


class ChannelStatistics:
    """Counts the messages of one channel as they come.

    Attributes:
        channel: Its name.
        count: Number of messages.
        missing: Numbers that were passed over in their numbering, since the numbering last began; None where they
            are not numbered.
        undecoded: Number of messages that are not of the channel's type.
        last: The newest message; None for a channel that is not ours.
        last_time: When it came [s].
    """

    def __init__(self, channel: str) -> None:
        self.channel = channel
        self.count = 0
        self.missing: int | None = 0 if channel in SEQUENCE_FIELDS else None
        self.undecoded = 0
        self.last: Any | None = None
        self.last_time = 0.0
        self._first_time = 0.0
        self._gap_sum = 0.0
        self._gap_squares = 0.0
        self._number: int | None = None
        self._recent: deque[float] = deque()

    def add(self, data: bytes, time: float) -> None:
        """Count a message that came at this time [s]."""
        if self.count == 0:
            self._first_time = time
        else:
            gap = time - self.last_time
            self._gap_sum += gap
            self._gap_squares += gap * gap
        self.count += 1
        self.last_time = time
        self._recent.append(time)
        while self._recent[0] < time - WINDOW:
            self._recent.popleft()
        if self.channel not in CHANNELS:
            return
        message = decode(self.channel, data)
        if message is None:
            self.undecoded += 1
            return
        self.last = message
        if self.missing is not None:
            self._follow(getattr(message, SEQUENCE_FIELDS[self.channel]))

    def _follow(self, number: int) -> None:
        # Numbers that fall back are those of a new trial, or of a sender that was started again.
        if self._number is not None and self.missing is not None and number > self._number + 1:
            self.missing += number - self._number - 1
        self._number = number

    @property
    def mean_rate(self) -> float:
        """Messages per second from the first to the last one [Hz]; 0 for a single message."""
        return (self.count - 1) / self._gap_sum if self._gap_sum > 0.0 else 0.0

    def rate(self, now: float) -> float:
        """Return the messages per second over the last second [Hz]."""
        recent = sum(time > now - WINDOW for time in self._recent)
        return recent / min(WINDOW, max(now - self._first_time, 1e-3)) if now > self._first_time else 0.0

    @property
    def jitter(self) -> float:
        """Standard deviation of the time between two messages [s]."""
        gaps = self.count - 1
        if gaps < 2:
            return 0.0
        mean = self._gap_sum / gaps
        return sqrt(max(self._gap_squares / gaps - mean * mean, 0.0))

    def last_values(self) -> str:
        """Return the newest message in short: no time of its own, no counters, long arrays cut."""
        if self.last is None:
            return "" if self.channel in CHANNELS else "(not a channel of ours)"
        parts = []
        for name in self.last.__slots__:
            if name not in ("utime", SEQUENCE_FIELDS.get(self.channel)) and not name.startswith("num_"):
                parts.append(f"{name} {_short(getattr(self.last, name))}")
        return ", ".join(parts)


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        if value and (isinstance(value[0], list | tuple) or hasattr(value[0], "__slots__")):
            return f"({len(value)})"
        return "[" + " ".join(_short(element) for element in value[:8]) + ("…]" if len(value) > 8 else "]")
    return str(value)


class BusStatistics:
    """The statistics of every channel that was heard, ours first and in the order of the channel table."""

    def __init__(self) -> None:
        self._channels: dict[str, ChannelStatistics] = {}

    def add(self, channel: str, data: bytes, time: float) -> None:
        """Count a message that came at this time [s]."""
        if channel not in self._channels:
            self._channels[channel] = ChannelStatistics(channel)
        self._channels[channel].add(data, time)

    @property
    def channels(self) -> list[ChannelStatistics]:
        """The channels that were heard."""
        ours = [self._channels[name] for name in CHANNELS if name in self._channels]
        return ours + [found for name, found in self._channels.items() if name not in CHANNELS]


def statistics_of(events: Iterable[LogEvent]) -> BusStatistics:
    """Count the events of a log by the time at which they were recorded."""
    statistics = BusStatistics()
    for event in events:
        statistics.add(event.channel, event.data, event.utime * 1e-6)
    return statistics
