"""The events of a log file, read as a stream so that damage costs what is damaged and nothing more.

LCM's own reader ends silently at the first damage, drops the last event before it, and crashes on some damaged lengths.
"""

import logging
import os
import struct
from collections.abc import Container, Generator, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from imolo.errors import BusError

logger = logging.getLogger(__name__)

SYNC = struct.pack(">I", 0xEDA1DA01)
HEADER = struct.Struct(">4sqqii")  # sync word, event number, time [µs], length of the channel, length of the data
MAX_CHANNEL_LENGTH = 999  # [bytes] what LCM's own reader takes
MAX_DATA_LENGTH = 1 << 24  # [bytes] a message of ours has some ten thousand
SEARCHED = 1 << 26  # [bytes] a file in whose beginning there is no event is no log
BLOCK = 1 << 16  # [bytes] read at once
TOLD = 1000  # damaged parts that are kept


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


class _Header(NamedTuple):
    number: int
    utime: int
    channel: str
    start: int
    data_start: int
    end: int


class LogReader:
    """Reads a log event by event, in memory that does not depend on its size.

    Iterating tells in one warning each what is damaged and that the clock of the recording stepped back, at its end.

    Attributes:
        path: Of the log.
        damage: What could not be read so far, the first `TOLD` parts of it.
        shift: What to add to the `utime` of the newest event so that times never fall: where the recording's clock
            steps back, time goes on where it was [µs].
    """

    def __init__(self, path: Path, with_data: Container[str] | None = None, quiet: bool = False) -> None:
        """Open a log.

        Args:
            path: Of the log.
            with_data: Channels whose messages are wanted; the `data` of others is empty, and their bytes are not read.
                None for all. Data longer than `MAX_DATA_LENGTH` are left out.
            quiet: Do not warn, as where a log is read for the second time.

        Raises:
            BusError: The file is missing, cannot be read, or is a pipe or a device.
        """
        self.path = path
        self.damage: list[Damage] = []
        self.shift = 0
        self._with_data, self._quiet = with_data, quiet
        self._block, self._block_start = b"", 0
        self._found_one = False
        self._last: int | None = None  # when the newest event was recorded [µs]
        self._damaged = 0
        try:
            # A pipe or a device has no end, and opening a pipe waits for its other side.
            if path.exists() and not path.is_file():
                raise BusError(f"{path} is a folder, pipe or device; give a log that imolo or lcm-logger wrote")
            self._file = path.open("rb", buffering=0)
            self._size = path.stat().st_size
        except FileNotFoundError as error:
            raise BusError(f"there is no log {path}") from error
        except (OSError, ValueError) as error:
            raise BusError(f"cannot read the log {path}: {error}") from error

    def __enter__(self) -> "LogReader":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __iter__(self) -> Iterator[LogEvent]:
        """Yield every event that can be read, in the order of the file.

        Raises:
            BusError: The file cannot be read, or holds no event at all.
        """
        steps: list[tuple[int, int]] = []  # when, and by how much the clock stepped back [µs]
        self._last = None
        for event in self._events():
            if self._last is not None and event.utime < self._last:
                self.shift += self._last - event.utime
                steps.append((self._last, self._last - event.utime))
            self._last = event.utime
            yield event
        if self._size and not self._found_one:
            raise BusError(f"{self.path} is no LCM log; give a file that imolo or lcm-logger wrote")
        if not self._quiet:
            self._warn(steps)

    def _events(self) -> Iterator[LogEvent]:
        position, header = 0, self._header(0)
        while position < self._size:
            following = None if header is None else self._header(header.end)
            if header is None or not self._is_whole(header, following):
                start, (position, header) = position, self._next(position + 1)
                cut = position == self._size and self._read(start, len(SYNC)) == SYNC
                what = "the log is cut off" if cut else f"{position - start} damaged bytes"
                self.add_damage(Damage(start, position, self._last, what))
                continue
            self._found_one = True
            yield self._event(header)
            position, header = header.end, following
            if header is not None:
                position = yield from self._of_block(header)
                header = header if position == header.start else self._header(position)

    def _of_block(self, header: _Header) -> Generator[LogEvent, None, int]:
        """Yield the events from a header on that stand in the block and are followed by the next; return where it ends.

        `_events` would yield the same, but in twice the time.
        """
        block, base, wanted = self._block, self._block_start, self._with_data
        number, utime, channel, start, data_start, end = header
        at, data_at, next_at = start - base, data_start - base, end - base
        while at >= 0 and next_at + HEADER.size + MAX_CHANNEL_LENGTH <= len(block):
            sync, next_number, next_utime, channel_length, data_length = HEADER.unpack_from(block, next_at)
            next_data = next_at + HEADER.size + channel_length
            if sync != SYNC or next_number != number + 1 or not 0 < channel_length <= MAX_CHANNEL_LENGTH:
                break
            next_channel = _name(block[next_at + HEADER.size : next_data])
            if data_length < 0 or base + next_data + data_length > self._size or not next_channel:
                break
            data = block[data_at:next_at] if wanted is None or channel in wanted else b""
            yield LogEvent(number, utime, channel, data, base + at)
            number, utime, channel = next_number, next_utime, next_channel
            at, data_at, next_at = next_at, next_data, next_data + data_length
        return base + at

    def event(self, offset: int) -> LogEvent:
        """Return the event that starts at the offset of one that was read before [bytes]."""
        header = self._header(offset)
        if header is None:
            raise BusError(f"{self.path} was changed while it was read")
        return self._event(header)

    def chunks(self, event: LogEvent) -> Iterator[bytes]:
        """Yield the data of an event piece by piece, however long they are."""
        header = self._header(event.offset)
        for start in range(header.data_start, header.end, BLOCK) if header else ():
            yield self._read(start, min(BLOCK, header.end - start))  # type: ignore[union-attr]

    def add_damage(self, part: Damage) -> None:
        """Note a part that cannot be used."""
        self._damaged += 1
        if len(self.damage) < TOLD:
            self.damage.append(part)

    def _warn(self, steps: list[tuple[int, int]]) -> None:
        if self.damage:
            self.damage.sort(key=lambda part: part.start)
            others = _others(self._damaged - 1)
            logger.warning("%s is damaged: %s%s; the rest was read", self.path, self.damage[0], others)
        if steps:
            after, back = steps[0]
            logger.warning(
                "the clock of %s steps back by %.6f s after %.6f s%s; what follows is taken to go on from there",
                *(self.path, back * 1e-6, after * 1e-6, _others(len(steps) - 1)),
            )

    def _event(self, header: _Header) -> LogEvent:
        number, utime, channel, start, data_start, end = header
        length = end - data_start
        wanted = length <= MAX_DATA_LENGTH and (self._with_data is None or channel in self._with_data)
        return LogEvent(number, utime, channel, self._read(data_start, length) if wanted else b"", start)

    def _is_whole(self, header: _Header, following: _Header | None) -> bool:
        """Return whether the length in a header can be believed, given what stands where it leads to."""
        if following is not None and following.number == header.number + 1:
            return True
        if header.end == self._size or self._read(header.end, len(SYNC)) == SYNC:
            # A wrong length may lead to the start of a later event by chance; then the next one lies inside.
            inside = self._find(header.start + 1, header.end)
            swallowed = None if inside is None else self._header(inside)
            return swallowed is None or swallowed.number != header.number + 1
        # Either the length of this event is wrong or the next header is. An event inside this one, or one with the next
        # number behind a gap, tells that it is the length.
        _, behind = self._next(header.start + 1)
        return behind is None or (behind.start >= header.end and behind.number != header.number + 1)

    def _next(self, start: int) -> tuple[int, _Header | None]:
        """Return where the next believable header is, or the end of the file."""
        end = self._size if self._found_one else min(self._size, SEARCHED)
        while (found := self._find(start, end)) is not None:
            header = self._header(found)
            if header is not None:
                return found, header
            start = found + 1
        return self._size, None

    def _find(self, start: int, end: int) -> int | None:
        """Return the place of the first sync word that starts in a part of the file."""
        while (place := self._data_from(start)) is not None and place < end:
            found = self._read(place, min(BLOCK, end - place) + len(SYNC) - 1).find(SYNC)
            if found >= 0:
                return place + found
            start = place + BLOCK
        return None

    def _data_from(self, start: int) -> int | None:
        """Return where the next byte is that is not in a hole of a sparse file."""
        try:
            return os.lseek(self._file.fileno(), start, os.SEEK_DATA)
        except OSError:
            return None

    def _header(self, start: int) -> _Header | None:
        """Return the header at a place, if there can be one."""
        at = start - self._block_start
        if not 0 <= at <= len(self._block) - HEADER.size - MAX_CHANNEL_LENGTH:
            at = self._load(start, min(HEADER.size + MAX_CHANNEL_LENGTH, self._size - start))
            if start >= self._size or len(self._block) - at < HEADER.size:
                return None
        sync, number, utime, channel_length, data_length = HEADER.unpack_from(self._block, at)
        if sync != SYNC or not 0 < channel_length <= MAX_CHANNEL_LENGTH or data_length < 0:
            return None
        data_start = start + HEADER.size + channel_length
        end = data_start + data_length
        channel = _name(self._block[at + HEADER.size : at + HEADER.size + channel_length])
        return None if end > self._size or not channel else _Header(number, utime, channel, start, data_start, end)

    def _read(self, start: int, length: int) -> bytes:
        at = self._load(start, length)
        return self._block[at : at + length]

    def _load(self, start: int, length: int) -> int:
        """Make these bytes part of the block that is kept, as far as there are any; return where they start in it."""
        at = start - self._block_start
        if not 0 <= at <= len(self._block) - length:
            try:
                self._file.seek(start)
                self._block, self._block_start, at = self._file.read(max(length, BLOCK)), start, 0
            except OSError as error:
                raise BusError(f"cannot read the log {self.path}: {error.strerror}") from error
        return at


def _others(count: int) -> str:
    return f", and {count} more" if count else ""


@lru_cache(maxsize=1024)
def _name(channel: bytes) -> str:
    """Return the name of a channel; empty if it can be none."""
    return "" if b"\0" in channel else channel.decode("utf-8", "backslashreplace")


def read_events(path: Path, with_data: Container[str] | None = None) -> Iterator[LogEvent]:
    """Yield the events of a log, as `LogReader` does.

    Raises:
        BusError: The file is missing, cannot be read, or holds no event at all.
    """
    with LogReader(path, with_data) as reader:
        yield from reader
