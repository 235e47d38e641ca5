"""Logs: every message of a trial in an LCM event log that lcm-logplayer can play, and the way back."""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lcm

from imolo.bus import Bus
from imolo.channels import CHANNELS
from imolo.errors import BusError


class Recorder:
    """Write every message on a bus to a log, stamped by the backend's clock.

    Use as a context manager: the file is closed, and so complete up to the last message, whatever happens.
    """

    def __init__(self, bus: Bus, path: Path, clock: Callable[[], int]) -> None:
        """Start to record.

        Args:
            bus: What to listen to.
            path: File to write; replaced if it exists.
            clock: Returns the time of the backend [µs].

        Raises:
            BusError: The file cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._log = lcm.EventLog(str(path), "w", overwrite=True)
        except (OSError, ValueError) as error:
            raise BusError(f"cannot write the log {path}: {error}; choose a folder you may write to") from error
        self._clock = clock
        bus.subscribe_raw(self._write)

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._log.close()

    def _write(self, channel: str, data: bytes) -> None:
        self._log.write_event(self._clock(), channel, data)


@dataclass
class Log:
    """The decoded messages of a log, by channel, in the order in which they were sent.

    Attributes:
        path: Where it was read.
        messages: For every channel of the channel table its messages; empty where it was silent.
        received: Time at which each of them was recorded [µs].
    """

    path: Path
    messages: dict[str, list[Any]] = field(default_factory=lambda: {name: [] for name in CHANNELS})
    received: dict[str, list[int]] = field(default_factory=lambda: {name: [] for name in CHANNELS})


def read_log(path: Path) -> Log:
    """Read and decode a log; channels that are not ours are passed over.

    Raises:
        BusError: The file is missing or no log, or a message in it is not of its channel's type.
    """
    if not path.is_file():
        raise BusError(f"there is no log {path}")
    log = Log(path)
    events = lcm.EventLog(str(path), "r")
    seen = False
    try:
        for event in events:
            seen = True
            channel = CHANNELS.get(event.channel)
            if channel is None:
                continue
            try:
                message = channel.message_type.decode(event.data)
            except (ValueError, struct.error) as error:
                raise BusError(
                    f"{path}: event {event.eventnum} on {event.channel} is no {channel.message_type.__name__}; "
                    "was it recorded with other message types?"
                ) from error
            log.messages[event.channel].append(message)
            log.received[event.channel].append(event.timestamp)
    finally:
        events.close()
    if path.stat().st_size and not seen:
        raise BusError(f"{path} is no LCM log; give a file that imolo or lcm-logger wrote")
    return log
