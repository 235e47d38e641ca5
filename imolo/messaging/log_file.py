"""The events of a log file, read so that damage costs what is damaged and nothing more.

LCM's own reader ends silently at the first damage, drops the last event before it, and crashes on some damaged lengths.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from imolo.errors import BusError

SYNC = struct.pack(">I", 0xEDA1DA01)
HEADER = struct.Struct(">4sqqii")  # sync word, event number, time [µs], length of the channel, length of the data
MAX_CHANNEL_LENGTH = 63  # LCM_MAX_CHANNEL_NAME_LENGTH


class LogEvent(NamedTuple):
    """A message as it stands in the file; `utime` is when it was recorded [µs], `offset` where it starts [bytes]."""

    number: int
    utime: int
    channel: str
    data: bytes
    offset: int


@dataclass(frozen=True)
class Damage:
    """A part of a log that cannot be read.

    Attributes:
        start: Its first byte.
        end: The first byte after it.
        after: When the last event before it was recorded [µs]; None where there is none.
        what: What is wrong.
    """

    start: int
    end: int
    after: int | None
    what: str

    def __str__(self) -> str:
        when = "before the first message" if self.after is None else f"after {self.after * 1e-6:.6f} s"
        return f"{self.what} {when} (bytes {self.start} to {self.end})"


def read_events(path: Path) -> tuple[list[LogEvent], list[Damage]]:
    """Read every event that can be read, in the order of the file, and tell what cannot.

    Raises:
        BusError: The file is missing, cannot be read, or holds no event at all.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise BusError(f"there is no log {path}") from error
    except OSError as error:
        raise BusError(f"cannot read the log {path}: {error.strerror}") from error
    events: list[LogEvent] = []
    damage: list[Damage] = []
    position = 0
    while position < len(content):
        event = _event_at(content, position)
        if event is not None:
            events.append(event)
            position = _end(event)
            continue
        start, position = position, _next_event(content, position + 1)
        cut = position == len(content) and content.startswith(SYNC, start)
        what = "the log is cut off" if cut else f"{position - start} damaged bytes"
        damage.append(Damage(start, position, events[-1].utime if events else None, what))
    if content and not events:
        raise BusError(f"{path} is no LCM log; give a file that imolo or lcm-logger wrote")
    return events, damage


def _end(event: LogEvent) -> int:
    return event.offset + HEADER.size + len(event.channel) + len(event.data)


def _event_at(content: bytes, start: int) -> LogEvent | None:
    """Return the event that starts here, if its header can be believed."""
    event = _parse(content, start)
    if event is None:
        return None
    end = _end(event)
    if end == len(content) or content.startswith(SYNC, end):
        # A wrong length may lead to the start of a later event by chance; then the next one lies inside.
        inside = content.find(SYNC, start + 1, end)
        swallowed = _parse(content, inside) if inside >= 0 else None
        return None if swallowed is not None and swallowed.number == event.number + 1 else event
    # Either the length of this event is wrong or the next header is. An event inside this one, or one with the next
    # number behind a gap, tells that it is the length.
    following = _parse(content, _next_event(content, start + 1))
    wrong_length = following is not None and (following.offset < end or following.number == event.number + 1)
    return None if wrong_length else event


def _next_event(content: bytes, start: int) -> int:
    """Return where the next believable header is, or the end of the file."""
    while (start := content.find(SYNC, start)) >= 0:
        if _parse(content, start) is not None:
            return start
        start += 1
    return len(content)


def _parse(content: bytes, start: int) -> LogEvent | None:
    if len(content) - start < HEADER.size:
        return None
    sync, number, utime, channel_length, data_length = HEADER.unpack_from(content, start)
    if sync != SYNC or not 0 < channel_length <= MAX_CHANNEL_LENGTH or data_length < 0:
        return None
    data_start = start + HEADER.size + channel_length
    if data_start + data_length > len(content):
        return None
    channel = content[start + HEADER.size : data_start]
    if not channel.isascii() or not channel.decode("ascii").isprintable():
        return None
    return LogEvent(number, utime, channel.decode("ascii"), content[data_start : data_start + data_length], start)
