"""The real capture of tests/data/natnet."""

from functools import cache
from pathlib import Path

from imolo_drivers.natnet.decoder import decode
from imolo_drivers.natnet.messages import Frame
from imolo_drivers.natnet.playback import Recording

FOLDER = Path(__file__).parents[2] / "data" / "natnet"
CAPTURE = FOLDER / "traffic.pcapng"
VERSION = (3, 0)


@cache
def recording() -> Recording:
    return Recording.read(CAPTURE)


@cache
def packets() -> tuple[bytes, ...]:
    return tuple(packet for _, packet in recording().frames)


@cache
def frames() -> tuple[Frame, ...]:
    decoded = tuple(decode(packet, VERSION) for packet in packets())
    assert all(isinstance(frame, Frame) for frame in decoded)
    return decoded  # type: ignore[return-value]
