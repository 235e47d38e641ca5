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
    board_challenge_t,
    board_clock_t,
    board_hello_t,
    board_proof_t,
    board_refusal_t,
    board_state_t,
    board_trial_t,
    board_welcome_t,
)

VERSION = 2
MAGIC = b"IMB1"
MAX_PAYLOAD = 16384  # [bytes] 225 phases of 8 channels, or 15 of 128; the paper's U has 3 of 8
MAX_SHORT_PAYLOAD = 4096  # [bytes] of what whoever connects may send
SEQUENCES = 2**32  # after which the numbers of the frames begin again at 0
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
    CHALLENGE = 9
    PROOF = 10


PAYLOADS: dict[FrameType, type[Any]] = {
    FrameType.HELLO: board_hello_t,
    FrameType.WELCOME: board_welcome_t,
    FrameType.REFUSAL: board_refusal_t,
    FrameType.ARM: board_arm_t,
    FrameType.COMMAND: actuator_command_t,
    FrameType.STATE: board_state_t,
    FrameType.CLOCK: board_clock_t,
    FrameType.TRIAL: board_trial_t,
    FrameType.CHALLENGE: board_challenge_t,
    FrameType.PROOF: board_proof_t,
}
_LONG = (FrameType.WELCOME, FrameType.COMMAND, FrameType.STATE)
_TYPE_OF = {payload: frame_type for frame_type, payload in PAYLOADS.items()}


class FrameError(ImoloError):
    """Bytes that are no frame; the link cannot be trusted any more."""


@dataclass(frozen=True)
class Frame:
    """One frame.

    Attributes:
        type: What it holds.
        sequence: Number that its sender gave it; increases by one, and begins again at 0 after 2**32 - 1.
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
        sequence: Number of the frame; wraps after 2**32 - 1.
        utime: Clock of the sender [µs].

    Raises:
        FrameError: The message is too long.
    """
    payload: bytes = message.encode()
    frame_type = _TYPE_OF[type(message)]
    if len(payload) > (longest := _longest(frame_type)):
        raise FrameError(f"a {type(message).__name__} of {len(payload)} bytes is too long; {longest} fit")
    return frame_bytes(frame_type, payload, sequence, utime)


def frame_bytes(frame_type: FrameType, payload: bytes, sequence: int, utime: int) -> bytes:
    """Return the bytes of a frame around a message that is encoded already."""
    head = _HEADER.pack(MAGIC, frame_type, len(payload), utime, sequence % SEQUENCES)
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

    def add(self, data: bytes) -> None:
        """Take what has arrived."""
        self._buffer += data

    def next(self) -> Frame | None:
        """Return the next frame if it is whole.

        Raises:
            FrameError: The stream is damaged; drop the connection.
        """
        size = self._size()
        if size is None:
            return None
        data = bytes(self._buffer[:size])
        del self._buffer[:size]
        return _decode(data)

    def feed(self, data: bytes) -> list[Frame]:
        """Take what has arrived and return the frames that are whole now.

        Raises:
            FrameError: The stream is damaged. What came before in the same call is lost as well; drop the connection.
        """
        self.add(data)
        return list(iter(self.next, None))

    @property
    def has_frame(self) -> bool:
        """Whether `next` has something to say, a frame or an error."""
        try:
            return self._size() is not None
        except FrameError:
            return True

    def _size(self) -> int | None:
        """Return the size of the next frame, header and all; None if it is not whole."""
        if len(self._buffer) < HEADER_SIZE:
            return None
        size = HEADER_SIZE + _payload_size(self._buffer)
        return size if len(self._buffer) >= size else None


def _longest(frame_type: FrameType) -> int:
    return MAX_PAYLOAD if frame_type in _LONG else MAX_SHORT_PAYLOAD


def _payload_size(buffer: bytearray) -> int:
    magic, frame_type, length, _, _ = _HEADER.unpack_from(buffer)
    if magic != MAGIC:
        raise FrameError(f"a frame begins with {bytes(magic)!r}, not {MAGIC!r}; is the other end a valve board's?")
    if frame_type not in PAYLOADS:
        raise FrameError(f"unknown frame type {frame_type}; known: {', '.join(f'{t:d}' for t in FrameType)}")
    if length > (longest := _longest(frame_type)):
        raise FrameError(f"a frame announces {length} bytes; at most {longest} are allowed")
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
        raise FrameError(f"frame {sequence} holds no {message_type.__name__}: {str(error)[:60]}") from error
    if not whole:
        raise FrameError(f"frame {sequence} holds no {message_type.__name__}: its length is not that of its content")
    return Frame(frame_type, sequence, utime, message)
