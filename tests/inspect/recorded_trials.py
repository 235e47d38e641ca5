"""What the tests of recorded trials share."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from imolo.messaging.log_file import HEADER, SYNC, LogEvent, read_events

METHOD = "paper"  # whose planner has the default settings
WALL = 1_790_000_000_000_000  # [µs] time of day at which a session begins
PAUSE = 5_000_000  # [µs] between two starts


@dataclass(frozen=True)
class Recorded:
    """Logs of two balls, and the table with which both were planned."""

    first: Path
    second: Path
    table: Path


def write_events(path: Path, events: Iterable[LogEvent]) -> Path:
    """Write a log as any recorder may: stamps and channels as they are given, numbered anew."""
    with path.open("wb") as file:
        for number, event in enumerate(events):
            channel = event.channel.encode()
            file.write(HEADER.pack(SYNC, number, event.utime, len(channel), len(event.data)) + channel + event.data)
    return path


def write_session(path: Path, *trials: Path) -> Path:
    """Write what `imolo record` leaves of several balls: one log, stamped by the time of day."""
    return write_events(
        path,
        (
            event._replace(utime=WALL + number * PAUSE + event.utime)
            for number, trial in enumerate(trials)
            for event in read_events(trial)
        ),
    )
