"""How the streams do: rates, gaps in the numbers of their messages, and how long an answer takes."""

import time
from collections import Counter, deque
from collections.abc import Callable

from imolo.contracts.trial import EventName
from imolo.messaging import channels
from imolo.messaging.bus import UNREADABLE
from imolo.messaging.numbering import Numbering
from imolo_msgs import trial_event_t

FOLLOWED = (channels.MOCAP, channels.ACTUATOR_STATE, channels.ACTUATOR_COMMAND)  # PLAN passes over skipped frames
RATES_OVER = 1.0  # [s]


class Streams:
    """Counts the messages of every channel.

    Attributes:
        total: Number of messages, by channel.
        numbers: The gaps in the numbers of messages, by channel. A frame that the cameras did not deliver counts as
            well.
        rates: Messages per second, by channel [Hz].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Start to count; `now` is the clock of the machine [s]."""
        self.total: Counter[str] = Counter()
        self.numbers = {channel: Numbering(channel) for channel in FOLLOWED}
        self.rates: dict[str, float] = {}
        self._now = now
        self._counted: Counter[str] = Counter()
        self._since = now()

    def count(self, channel: str, data: bytes) -> None:
        """Count a message; gaps are those of messages of the channel's type."""
        self.total[channel] += 1
        if channel == channels.TRIAL and is_start(data):
            self.begin_trial()
        if channel in self.numbers:
            self.numbers[channel].count(data)

    def begin_trial(self) -> None:
        """Expect the numbers of all channels to start anew."""
        for numbering in self.numbers.values():
            numbering.begin()

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
        numbers = sorted(self.numbers.items())
        missing = ", ".join(f"{one.missing} {name}" for name, one in numbers if one.missing)
        disordered = ", ".join(f"{one.disordered} {name}" for name, one in numbers if one.disordered)
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
