"""Logs: every message of a trial in an LCM event log that lcm-logplayer can play, and the way back."""

import struct
from collections.abc import Callable, Collection, Container, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lcm

from imolo.errors import BusError
from imolo.messaging.bus import Bus
from imolo.messaging.channels import ACTUATOR_STATE, CHANNELS, MOCAP, TRIAL
from imolo.messaging.log_file import HEADER, Damage, LogEvent, LogReader

LOG_SUFFIX = ".lcmlog"
IN_EVERY_TRIAL = (TRIAL, MOCAP, ACTUATOR_STATE)

OLDER_CHANNELS = ("VALVE_COMMAND", "VALVE_PRESSURE")
OLDER_TRIAL = bytes.fromhex("85d8afedc33c97b7")
"""Fingerprint of the trial_event_t of imolo 0.1."""


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
        write = self._log.c_eventlog.write_event  # without a detour in Python at every message
        bus.subscribe_raw(lambda channel, data: write(clock(), channel, data))

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._log.close()


@dataclass
class Log:
    """The decoded messages of a log, by channel, in the order in which they were sent.

    Attributes:
        path: Where it was read.
        messages: For every channel of the channel table its messages; empty where it was silent.
        received: Time at which each of them was recorded [µs].
        damage: What could not be read; empty for a log in order.
    """

    path: Path
    messages: dict[str, list[Any]] = field(default_factory=lambda: {name: [] for name in CHANNELS})
    received: dict[str, list[int]] = field(default_factory=lambda: {name: [] for name in CHANNELS})
    damage: list[Damage] = field(default_factory=list)


def read_log(path: Path, only: Collection[str] = CHANNELS) -> Log:
    """Read and decode a log; channels that are not ours are passed over, damage is skipped and told in a warning.

    Args:
        path: Of the log.
        only: Channels that are wanted; the sensors' alone are half of all messages.

    Raises:
        BusError: The file is missing or no log, of imolo 0.1, or of other types throughout, see `decoded`.
    """
    log = Log(path)
    with LogReader(path, {*only, TRIAL}) as reader:
        for event, message in decoded(reader, reader, only):
            log.messages[event.channel].append(message)
            log.received[event.channel].append(event.utime)
    log.damage = reader.damage
    return log


def decoded(events: Iterable[LogEvent], reader: LogReader, wanted: Container[str]) -> Iterator[tuple[LogEvent, Any]]:
    """Yield the events on some channels of ours with what they hold; messages of another type count as damage.

    Args:
        events: Of the reader.
        reader: Told of what cannot be read, as damage.
        wanted: The channels; others are passed over.

    Raises:
        BusError: All messages of a channel that speaks in every trial are of another type, or all messages are.
            On another channel they may be a stranger's.
    """
    broken: dict[str, LogEvent] = {}
    whole: set[str] = set()
    for event in events:
        refuse_older(reader.path, event)
        if event.channel not in wanted:
            continue
        message = decode(event.channel, event.data)
        if message is not None:
            whole.add(event.channel)
            yield event, message
            continue
        broken.setdefault(event.channel, event)
        end = event.offset + HEADER.size + len(event.channel) + len(event.data)
        reader.add_damage(Damage(event.offset, end, event.utime, f"a damaged message on {event.channel}"))
    for name, event in broken.items():
        if name not in whole and (name in IN_EVERY_TRIAL or not whole):
            raise BusError(
                f"{reader.path}: event {event.number} on {name} is no {CHANNELS[name].message_type.__name__}; "
                "was it recorded with other message types?"
            )


def refuse_older(path: Path, event: LogEvent) -> None:
    """Raise `BusError` for an event that only imolo 0.1 wrote, whose messages knew eight valves alone."""
    if event.channel in OLDER_CHANNELS or (event.channel == TRIAL and event.data.startswith(OLDER_TRIAL)):
        raise BusError(f"{path} was recorded before robots were plug-ins; read it with imolo 0.1, or record it again")


def decode(channel: str, data: bytes) -> Any | None:
    """Return the message that these bytes of a channel of ours hold, or None if they hold none of its type."""
    try:
        return CHANNELS[channel].message_type.decode(data)
    except (ValueError, struct.error, MemoryError, OverflowError):
        return None
