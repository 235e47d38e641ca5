"""How the streams do: rates, gaps in the numbers of their messages, and how long an answer takes."""

import struct
import time
from collections import Counter, deque
from collections.abc import Callable

from imolo.contracts.trial import EventName
from imolo.messaging import channels
from imolo.messaging.bus import UNREADABLE
from imolo_msgs import trial_event_t

# Where the number of a message is in its bytes: behind fingerprint and utime, 8 bytes each.
NUMBERED = {
    channel: channels.CHANNELS[channel].message_type._get_packed_fingerprint()
    for channel in (channels.MOCAP, channels.ACTUATOR_STATE, channels.ACTUATOR_COMMAND)
}
_NUMBER = struct.Struct(">i")
_NUMBER_AT = 16
FIRST = 1  # number of the first message of a trial
RATES_OVER = 1.0  # [s]


class Streams:
    """Counts the messages of every channel.

    Attributes:
        total: Number of messages, by channel.
        missing: Number of messages that never came, by channel, as far as messages are numbered. A frame
            that the cameras did not deliver counts as well.
        disordered: Number of messages that came twice or after a later one, by channel.
        rates: Messages per second, by channel [Hz].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Start to count; `now` is the clock of the machine [s]."""
        self.total: Counter[str] = Counter()
        self.missing: Counter[str] = Counter()
        self.disordered: Counter[str] = Counter()
        self.rates: dict[str, float] = {}
        self._last: dict[str, int] = {}
        self._now = now
        self._counted: Counter[str] = Counter()
        self._since = now()

    def count(self, channel: str, data: bytes) -> None:
        """Count a message; gaps are those of messages of the channel's type."""
        self.total[channel] += 1
        if channel == channels.TRIAL and is_start(data):
            self.begin_trial()
        if channel not in NUMBERED or len(data) < _NUMBER_AT + _NUMBER.size or not data.startswith(NUMBERED[channel]):
            return
        (number,) = _NUMBER.unpack_from(data, _NUMBER_AT)
        last = self._last.get(channel)
        if last is not None and FIRST < number <= last:
            self.disordered[channel] += 1
            return
        # The numbers start anew with every trial.
        expected = FIRST if last is None or number <= last else last + 1
        if not FIRST <= number <= expected + channels.LONGEST_GAP:
            return
        if last is not None or number == FIRST:
            self.missing[channel] += max(number - expected, 0)
        self._last[channel] = number

    def begin_trial(self) -> None:
        """Expect the numbers of all channels to start anew."""
        self._last = dict.fromkeys(NUMBERED, FIRST - 1)

    def measure(self) -> None:
        """Measure the rates, if enough time has passed since the last time."""
        now = self._now()
        if now - self._since >= RATES_OVER:
            self.rates = {
                name: (count - self._counted[name]) / (now - self._since) for name, count in self.total.items()
            }
            self._counted, self._since = self.total.copy(), now

    def describe(self, *names: str) -> str:
        """Return rates and gaps of some channels, or of all that speak, in words."""
        self.measure()
        shown = names or tuple(sorted(name for name, rate in self.rates.items() if rate > 0.0))
        rates = ", ".join(f"{name} {self.rates.get(name, 0.0):.0f} Hz" for name in shown)
        return f"{rates or 'silence'}; {self.describe_gaps()}"

    def describe_gaps(self) -> str:
        """Return the gaps of all channels in words."""
        missing = ", ".join(f"{count} {name}" for name, count in sorted(self.missing.items()) if count)
        disordered = ", ".join(f"{count} {name}" for name, count in sorted(self.disordered.items()) if count)
        return f"missing {missing or 'none'}" + (f", out of order {disordered}" if disordered else "")


def is_start(data: bytes) -> bool:
    """Return whether a message on TRIAL starts a trial."""
    try:
        return bool(trial_event_t.decode(data).event == EventName.START)
    except UNREADABLE:
        return False


class Latency:
    """How long the last thousand answers took."""

    def __init__(self) -> None:
        """Start without any."""
        self._times: deque[float] = deque(maxlen=1000)

    def add(self, duration: float) -> None:
        """Add one [s]."""
        self._times.append(duration)

    def __str__(self) -> str:
        if not self._times:
            return "no answers yet"
        ordered = sorted(self._times)
        median, p99 = (1e3 * ordered[int(share * (len(ordered) - 1))] for share in (0.5, 0.99))
        return f"{median:.2f} ms median, {p99:.2f} ms p99"
