"""What can be seen at a moment: the newest message of each channel, of a log or of a bus."""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from imolo.contracts.trial import EventName
from imolo.errors import BusError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import Log

Moment = Mapping[str, Any]  # newest message by channel; a channel that has not spoken is not in it

SEEN = (channels.TRUTH_ROBOT, channels.TRUTH_BALL, channels.MOCAP, channels.PLAN, channels.TRIAL)


class Session(Protocol):
    """A session that can be looked at."""

    name: str

    def at(self, time: float) -> Moment:
        """Return the newest messages at a time [s]."""


class RecordedSession:
    """A session from its log.

    Attributes:
        name: What to call it beside others.
        robot: Name of its robot.
        backend: Name of its backend.
        duration: Time of its last message [s].
    """

    def __init__(self, log: Log, name: str) -> None:
        """Prepare a log, to be shown under a name.

        Raises:
            BusError: The log shows nothing, or does not say which robot it shows.
        """
        self.name = name
        start = next((event for event in log.messages[channels.TRIAL] if event.event == EventName.START), None)
        if start is None:
            raise BusError(f"{log.path} holds no start of a trial, so its robot is not known")
        self.robot: str = start.robot
        self.backend: str = start.backend
        # Shown by the time a message tells, not by the time it was recorded: a frame of the cameras arrives late.
        self._times = {name: [message.utime * 1e-6 for message in log.messages[name]] for name in SEEN}
        self._messages = log.messages
        self.duration = max(times[-1] for times in self._times.values() if times)

    def at(self, time: float) -> Moment:
        """Return the newest messages at a time [s]."""
        newest = {name: bisect_right(times, time + 1e-9) - 1 for name, times in self._times.items()}
        return {name: self._messages[name][index] for name, index in newest.items() if index >= 0}


def recorded_sessions(logs: Sequence[Log], names: Sequence[str]) -> list[RecordedSession]:
    """Prepare logs; they are called by their backends where these differ, and by the names given where not."""
    sessions = [RecordedSession(log, name) for log, name in zip(logs, names, strict=True)]
    if len({session.backend for session in sessions}) == len(sessions):
        for session in sessions:
            session.name = session.backend
    return sessions


class LiveSession:
    """A session that is running on a bus; `at` returns what is newest now."""

    def __init__(self, bus: Bus, on_change: Callable[[str], object] = lambda _: None) -> None:
        """Listen to a bus; `on_change` is told the channel of each message."""
        self.name = "live"
        self._newest: dict[str, Any] = {}

        def listen(channel: str) -> Callable[[Any], None]:
            def keep(message: Any) -> None:
                if channel == channels.TRIAL and message.event == EventName.START:
                    # What is left of the trial before does not belong to this one.
                    self._newest.clear()
                self._newest[channel] = message
                on_change(channel)

            return keep

        for channel in SEEN:
            bus.subscribe(channel, listen(channel))

    @property
    def robot(self) -> str | None:
        """Name of the robot, once an event has told it."""
        event = self._newest.get(channels.TRIAL)
        return None if event is None else event.robot

    def at(self, time: float = 0.0) -> Moment:
        """Return the newest messages."""
        return dict(self._newest)
