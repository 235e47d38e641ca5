"""What a channel does: rate, jitter, age, and messages that are missing from its numbering."""

from collections import deque
from math import sqrt
from typing import Any

from imolo.messaging.channels import CHANNELS, STREAMS
from imolo.messaging.log import decode
from imolo.messaging.numbering import NUMBERED, Numbering

WINDOW = 1.0  # [s] over which the rate of a running session is counted
MOST_RECENT = 10_000  # messages within it that are remembered
SHOWN = 8  # elements of an array


class ChannelStatistics:
    """Counts the messages of one channel as they come.

    Attributes:
        channel: Its name.
        count: Number of messages.
        undecoded: Number of messages that are not of the channel's type.
        last_time: When it came [s].
    """

    def __init__(self, channel: str) -> None:
        self.channel = channel
        self.count = 0
        self.undecoded = 0
        self.last_time = 0.0
        known = CHANNELS.get(channel)
        self._fingerprint = None if known is None else known.message_type._get_packed_fingerprint()
        self._numbering = Numbering(channel) if channel in NUMBERED else None
        self._last_data: bytes | None = None
        self._first_time = 0.0
        self._follows = False  # whether the next message comes a gap after the last one
        self._gaps = 0
        self._gap_sum = 0.0
        self._gap_squares = 0.0
        self._recent: deque[float] = deque(maxlen=MOST_RECENT)

    def add(self, data: bytes, time: float) -> None:
        """Count a message that came at this time [s]."""
        if self.count == 0:
            self._first_time = time
        if self._follows:
            gap = time - self.last_time
            self._gaps += 1
            self._gap_sum += gap
            self._gap_squares += gap * gap
        self._follows = True
        self.count += 1
        self.last_time = time
        self._recent.append(time)
        if self._fingerprint is None:
            return
        # A log may have millions of messages, so one that shows its type is not decoded.
        if data.startswith(self._fingerprint) if self._numbering is None else self._numbering.count(data):
            self._last_data = data
        else:
            self.undecoded += 1

    def pause(self) -> None:
        """Do not count the time until the next message."""
        self._follows = False

    @property
    def missing(self) -> int | None:
        """How many messages never came, by their numbers; None where they are not numbered."""
        return None if self._numbering is None else self._numbering.missing

    @property
    def last(self) -> Any | None:
        """The newest message; None for a channel that is not ours, and where it cannot be decoded."""
        return None if self._last_data is None else decode(self.channel, self._last_data)

    @property
    def mean_rate(self) -> float:
        """Messages per second from the first to the last one, pauses left out [Hz]; 0 for a single message."""
        return self._gaps / self._gap_sum if self._gap_sum > 0.0 else 0.0

    def rate(self, now: float) -> float:
        """Return the messages per second over the last second [Hz]."""
        recent = sum(time > now - WINDOW for time in self._recent)
        begin = self._recent[0] if recent == MOST_RECENT else self._first_time
        return recent / min(WINDOW, max(now - begin, 1e-3)) if now > begin else 0.0

    @property
    def jitter(self) -> float:
        """Standard deviation of the time between two messages [s]."""
        if self._gaps == 0:
            return 0.0
        mean = self._gap_sum / self._gaps
        return sqrt(max(self._gap_squares / self._gaps - mean * mean, 0.0))

    def last_values(self) -> str:
        """Return the newest message in short: no time of its own, no counters, long arrays cut."""
        last = self.last
        if last is None:
            return "" if self.channel in CHANNELS else "(not a channel of ours)"
        parts = []
        for name in last.__slots__:
            if name not in ("utime", NUMBERED.get(self.channel)) and not name.startswith("num_"):
                parts.append(f"{name} {_short(getattr(last, name))}")
        return ", ".join(parts)


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        if value and (isinstance(value[0], list | tuple) or hasattr(value[0], "__slots__")):
            return f"({len(value)})"
        return "[" + " ".join(map(_short, value[:SHOWN])) + (" …]" if len(value) > SHOWN else "]")
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

    def begin_trial(self) -> None:
        """Leave the time since the last trial out of the rates."""
        for name in STREAMS.keys() & self._channels.keys():
            self._channels[name].pause()

    @property
    def channels(self) -> list[ChannelStatistics]:
        """The channels that were heard."""
        ours = [self._channels[name] for name in CHANNELS if name in self._channels]
        return ours + [found for name, found in self._channels.items() if name not in CHANNELS]
