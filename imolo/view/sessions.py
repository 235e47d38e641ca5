"""What can be seen at a moment: the newest message of each channel, of a log or of a bus."""

import logging
from array import array
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from imolo.command_line.terminal import plain
from imolo.contracts.trial import EventName
from imolo.errors import BusError
from imolo.inspect.trials import Timeline, TrialEvents
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import decode
from imolo.messaging.log_file import LogReader

logger = logging.getLogger(__name__)

Moment = Mapping[str, Any]  # newest message by channel; a channel that has not spoken is not in it

SEEN = (channels.TRUTH_ROBOT, channels.TRUTH_BALL, channels.MOCAP, channels.PLAN, channels.TRIAL)

SLACK = 1e-9  # [s] by which a time may be rounded


class Session(Protocol):
    """A session that can be looked at."""

    name: str

    def at(self, time: float) -> Moment:
        """Return the newest messages at a time [s]."""


class RecordedSession:
    """A session from its log, of which only the places of the messages are kept; its trials follow one another.

    Attributes:
        name: What to call it beside others.
        robot: Name of its robot.
        backend: Name of its backend.
        duration: Time of its last message [s].
    """

    def __init__(self, path: Path, name: str, trial: int | None = None) -> None:
        """Prepare a log, to be shown under a name.

        Args:
            path: Of the log.
            name: What to call it.
            trial: Which trial, from 0; None for all of them.

        Raises:
            BusError: The log shows nothing, has no such trial, or does not say which robot it shows.
        """
        self.name = name
        self._reader = LogReader(path, SEEN)
        found: dict[str, list[tuple[int, int]]] = {name: [] for name in SEEN}
        starts: list[tuple[int, Any]] = []
        timeline = Timeline(TrialEvents(self._reader, trial), SEEN)
        try:
            for heard in timeline:
                # Shown by the time a message tells, not by the time it was recorded: a frame arrives late.
                found[heard.event.channel].append((heard.time, heard.event.offset))
                if heard.event.channel == channels.TRIAL and heard.message.event == EventName.START:
                    starts.append((heard.time, heard.message))
            if not starts:
                raise BusError(f"{path} holds no start of a trial, so its robot is not known")
        except BusError:
            self.close()
            raise
        self.robot: str = starts[0][1].robot
        self.backend: str = starts[0][1].backend
        for places in found.values():
            places.sort()
        self._times = {
            name: array("d", [(time - timeline.origin) * 1e-6 for time, _ in places]) for name, places in found.items()
        }
        self._offsets = {name: array("q", [offset for _, offset in places]) for name, places in found.items()}
        self._starts = [(time - timeline.origin) * 1e-6 for time, _ in starts]
        self._newest: dict[str, tuple[int, Any]] = {}
        self.duration = max(times[-1] for times in self._times.values() if times)

    def close(self) -> None:
        """Close the log."""
        self._reader.close()

    def at(self, time: float) -> Moment:
        """Return the newest messages of the trial that runs at a time [s]."""
        begun = self._starts[max(bisect_right(self._starts, time + SLACK) - 1, 0)]
        moment = {}
        for name, times in self._times.items():
            index = bisect_right(times, time + SLACK) - 1
            # What is left of the trial before does not belong to this one.
            if index >= 0 and times[index] >= begun - SLACK:
                moment[name] = self._message(name, index)
        return moment

    def _message(self, name: str, index: int) -> Any:
        """Return a message; the same object as long as it is the newest, so that it is drawn once."""
        if self._newest.get(name, (None,))[0] != index:
            offset = self._offsets[name][index]
            self._newest[name] = (index, decode(name, self._reader.event(offset).data))
        return self._newest[name][1]


def recorded_sessions(paths: Sequence[Path], names: Sequence[str], trial: int | None = None) -> list[RecordedSession]:
    """Prepare logs; they are called by their backends where these differ, and by the names given where not.

    Raises:
        BusError: See `RecordedSession`.
    """
    sessions = [RecordedSession(path, name, trial) for path, name in zip(paths, names, strict=True)]
    if len({session.backend for session in sessions}) == len(sessions):
        for session in sessions:
            session.name = plain(session.backend)
    return sessions


class LiveSession:
    """A session that is running on a bus; `at` returns what is newest now."""

    def __init__(self, bus: Bus, on_change: Callable[[str], object] = lambda _: None) -> None:
        """Listen to a bus; `on_change` is told the channel of each message."""
        self.name = "live"
        self._newest: dict[str, Any] = {}
        self._strange: set[str] = set()  # channels on which others speak as well

        def keep(channel: str, data: bytes) -> None:
            message = decode(channel, data)
            if message is None:
                self._pass_over(channel)
                return
            if channel == channels.TRIAL and message.event == EventName.START:
                # What is left of the trial before does not belong to this one.
                self._newest.clear()
            self._newest[channel] = message
            on_change(channel)

        for channel in SEEN:
            bus.subscribe_raw(keep, channel)

    def _pass_over(self, channel: str) -> None:
        if channel not in self._strange:
            self._strange.add(channel)
            kind = CHANNELS[channel].message_type.__name__
            logger.warning("another program sends something else than %s on %s; it is passed over", kind, channel)

    @property
    def robot(self) -> str | None:
        """Name of the robot, once an event has told it."""
        event = self._newest.get(channels.TRIAL)
        return None if event is None else event.robot

    def at(self, time: float = 0.0) -> Moment:
        """Return the newest messages."""
        return dict(self._newest)
