"""`imolo record`: every message on the network in one log, on the disk as soon as it is heard."""

import contextlib
import struct
import time
from pathlib import Path
from typing import BinaryIO

from imolo.errors import BusError
from imolo.live.identity import Identity, Role
from imolo.live.node import Node
from imolo.live.program import Console, Stop, run_node
from imolo.live.streams import Streams
from imolo.messaging import channels
from imolo.messaging.bus import Bus

# The parts of the numbered exchange repeat what the other channels carry.
LEFT_OUT = (channels.STEP_REQUEST, channels.STEP_ANSWER)
SESSION = "session.lcmlog"
CHUNK = 1 << 16  # [bytes] written at once where messages come without a pause
_SYNC = 0xEDA1DA01
_HEADER = struct.Struct(">IqqII")  # of an LCM event: sync word, number, time [µs], lengths of channel and data


class EventFile:
    """An LCM log that holds whole events only, whenever the program is killed.

    LCM's own writer keeps the last few kilobytes to itself, and has no way to ask for them.
    """

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises:
            BusError: It exists, or cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO = open(path, "xb", buffering=0)  # noqa: SIM115 (close() closes it)
        except OSError as error:
            raise BusError(f"cannot write the log {path}: {error.strerror}; choose another --out") from error
        self._path = path
        self._waiting = bytearray()
        self.events = self.size = self._written = 0

    def add(self, utime: int, channel: str, data: bytes) -> None:
        """Add an event that was heard at `utime` [µs]."""
        name = channel.encode()
        self._waiting += _HEADER.pack(_SYNC, self.events, utime, len(name), len(data)) + name + data
        self.events += 1
        if len(self._waiting) > CHUNK:
            self.flush()

    def flush(self) -> None:
        """Hand all events to the operating system.

        Raises:
            BusError: It does not take them; the file ends with what was handed over before.
        """
        waiting, self._waiting = memoryview(self._waiting), bytearray()
        left = waiting
        try:
            while left:
                left = left[self._file.write(left) or 0 :]
        except OSError as error:
            self.events = self._written
            with contextlib.suppress(OSError):
                self._file.seek(self._file.truncate(self.size))
            raise BusError(
                f"cannot write the log {self._path}: {error.strerror}; make room, what was recorded before is kept"
            ) from error
        self.size += len(waiting)
        self._written = self.events

    def close(self) -> None:
        """Write the rest and close the file."""
        self.flush()
        self._file.close()


def free_path(path: Path | str) -> Path:
    """Return `path`, or the first of path_1, path_2 ... that does not exist: a log is never overwritten.

    In a folder it is `session.lcmlog`; a text that ends with a slash names a folder, also one that is not there yet.
    """
    is_folder = str(path).endswith("/") or Path(path).is_dir()
    path = Path(path, SESSION) if is_folder else Path(path)
    number, free = 0, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.stem}_{number}{path.suffix}")
    return free


class RecorderProgram:
    """Writes what it hears, with the time at which it heard it."""

    def __init__(self, bus: Bus, path: Path | str, console: Console) -> None:
        """Join the network and create the log.

        Raises:
            BusError: The log cannot be written.
        """
        self._path = free_path(path)
        self._console, self._bus = console, bus
        self._streams = Streams()
        self._file = EventFile(self._path)
        self._node = Node(bus, Identity(Role.RECORDER), console.say)
        self._node.activity = "recording"
        bus.subscribe_raw(self._on_message)

    def run(self, stop: Stop) -> None:
        """Record until stopped."""
        self._console.say(f"recording to {self._path}")
        try:
            run_node(self._node, self._wait, stop, lambda: self._console.status(self._status))
            self._bus.drain()
        finally:
            self._file.close()
            self._console.say(f"stopped; {self._file.events} messages in {self._path}; {self._streams.describe_gaps()}")

    def _wait(self, timeout: float) -> None:
        self._bus.wait(timeout)
        self._file.flush()

    def _status(self) -> str:
        return f"{self._file.events} messages, {self._file.size / 1e6:.1f} MB | {self._streams.describe()}"

    def _on_message(self, channel: str, data: bytes) -> None:
        if channel not in LEFT_OUT:
            self._file.add(time.time_ns() // 1000, channel, data)
            self._streams.count(channel, data)


def run_recorder(url: str, path: Path | str, stop: Stop, console: Console) -> None:
    """Run the program.

    Raises:
        BusError: The bus cannot be opened, or the log cannot be written.
    """
    RecorderProgram(Bus(url), path, console).run(stop)
