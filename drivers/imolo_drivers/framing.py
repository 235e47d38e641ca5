"""Frames on the TCP link to the valve board: a fixed header, then one LCM message; see docs/board-protocol.md."""

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from imolo.errors import ImoloError
from imolo_msgs import (
    actuator_command_t,
    board_arm_t,
    board_clock_t,
    board_hello_t,
    board_refusal_t,
    board_state_t,
    board_trial_t,
    board_welcome_t,
)

VERSION = 1
MAGIC = b"IMB1"
MAX_PAYLOAD = 4096  # [bytes] 54 phases of 8 valves; the paper's U has 3
# Magic, type, length of the payload, time [us], sequence; then the CRC over all of these and the payload.
_HEADER = struct.Struct(">4sHHqI")
_CRC = struct.Struct(">I")
HEADER_SIZE = _HEADER.size + _CRC.size


class FrameType(IntEnum):
    """What a frame holds."""

    HELLO = 1
    WELCOME = 2
    REFUSAL = 3
    ARM = 4
    COMMAND = 5
    STATE = 6
    CLOCK = 7
    TRIAL = 8


PAYLOADS: dict[FrameType, type[Any]] = {
    FrameType.HELLO: board_hello_t,
    FrameType.WELCOME: board_welcome_t,
    FrameType.REFUSAL: board_refusal_t,
    FrameType.ARM: board_arm_t,
    FrameType.COMMAND: actuator_command_t,
    FrameType.STATE: board_state_t,
    FrameType.CLOCK: board_clock_t,
    FrameType.TRIAL: board_trial_t,
}
_TYPE_OF = {payload: frame_type for frame_type, payload in PAYLOADS.items()}


class FrameError(ImoloError):
    """Bytes that are no frame; the link cannot be trusted any more."""


@dataclass(frozen=True)
class Frame:
    """One frame.

    Attributes:
        type: What it holds.
        sequence: Number that its sender gave it; increases by one.
        utime: Clock of the sender [µs].
        message: Of the class that belongs to the type.
    """

    type: FrameType
    sequence: int
    utime: int
    message: Any


def encode_frame(message: Any, sequence: int, utime: int) -> bytes:
    """Return the bytes of a frame.

    Args:
        message: One of the types of `PAYLOADS`.
        sequence: Number of the frame, below 2**32.
        utime: Clock of the sender [µs].

    Raises:
        FrameError: The message is too long.
    """
    payload: bytes = message.encode()
    if len(payload) > MAX_PAYLOAD:
        raise FrameError(f"a {type(message).__name__} of {len(payload)} bytes is too long; {MAX_PAYLOAD} fit")
    head = _HEADER.pack(MAGIC, _TYPE_OF[type(message)], len(payload), utime, sequence)
    return head + _CRC.pack(zlib.crc32(payload, zlib.crc32(head))) + payload


class FrameDecoder:
    """Cuts a stream of bytes into frames; never holds more than one frame that is not whole."""

    def __init__(self) -> None:
        """Start at the beginning of a connection."""
        self._buffer = bytearray()

    @property
    def held(self) -> int:
        """Number of bytes of a frame that is not whole yet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        """Take what has arrived and return the frames that are whole now.

        Raises:
            FrameError: The stream is damaged. What came before in the same call is lost as well; drop the connection.
        """
        self._buffer += data
        frames: list[Frame] = []
        start = 0
        while len(self._buffer) - start >= HEADER_SIZE:
            end = start + HEADER_SIZE + _payload_size(self._buffer, start)
            if len(self._buffer) < end:
                break
            frames.append(_decode(bytes(self._buffer[start:end])))
            start = end
        del self._buffer[:start]
        return frames


def _payload_size(buffer: bytearray, start: int) -> int:
    magic, frame_type, length, _, _ = _HEADER.unpack_from(buffer, start)
    if magic != MAGIC:
        raise FrameError(f"a frame begins with {bytes(magic)!r}, not {MAGIC!r}; is this a valve board of version 1?")
    if length > MAX_PAYLOAD:
        raise FrameError(f"a frame announces {length} bytes; at most {MAX_PAYLOAD} are allowed")
    if frame_type not in PAYLOADS:
        raise FrameError(f"unknown frame type {frame_type}; known: {', '.join(f'{t:d}' for t in FrameType)}")
    return int(length)


def _decode(data: bytes) -> Frame:
    """Decode a frame whose magic, type and length are right."""
    _, number, _, utime, sequence = _HEADER.unpack_from(data)
    (sent,) = _CRC.unpack_from(data, _HEADER.size)
    payload = data[HEADER_SIZE:]
    if sent != zlib.crc32(payload, zlib.crc32(data[: _HEADER.size])):
        raise FrameError(f"frame {sequence} has the wrong checksum")
    frame_type = FrameType(number)
    message_type = PAYLOADS[frame_type]
    try:
        message = message_type.decode(payload)
        # LCM reads texts that are cut off and passes over what follows the message.
        whole = message.encode() == payload
    except (ValueError, struct.error, IndexError, MemoryError, OverflowError) as error:
        raise FrameError(f"frame {sequence} holds no {message_type.__name__}: {error}") from error
    if not whole:
        raise FrameError(f"frame {sequence} holds no {message_type.__name__}: its length is not that of its content")
    return Frame(frame_type, sequence, utime, message)
