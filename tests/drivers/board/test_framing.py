"""Frames survive the link, and nothing else passes for one."""

import itertools
import random
import struct
import zlib
from typing import Any

import pytest
from board_link import command
from hypothesis import given
from hypothesis import strategies as st
from messaging.messages import messages, plain

from imolo_drivers.board.framing import (
    HEADER_SIZE,
    MAGIC,
    MAX_PAYLOAD,
    MAX_SHORT_PAYLOAD,
    PAYLOADS,
    FrameDecoder,
    FrameError,
    FrameType,
    encode_frame,
)
from imolo_drivers.board.handshake import ClientRole, make_hello

GOOD = encode_frame(make_hello(ClientRole.CONTROLLER, "test"), 7, 123_456)


def sealed(frame_type: int, payload: bytes, length: int | None = None) -> bytes:
    """Return a frame with the right checksum, whatever else is wrong with it."""
    head = struct.pack(">4sHHqI", MAGIC, frame_type, len(payload) if length is None else length, 0, 0)
    return head + struct.pack(">I", zlib.crc32(payload, zlib.crc32(head))) + payload


@pytest.mark.parametrize("frame_type", FrameType)
@given(data=st.data(), sequence=st.integers(0, 2**32 - 1), utime=st.integers(-(2**63), 2**63 - 1))
def test_every_message_of_the_link_survives_it(
    frame_type: FrameType, data: st.DataObject, sequence: int, utime: int
) -> None:
    message = data.draw(messages(PAYLOADS[frame_type]))
    (frame,) = FrameDecoder().feed(encode_frame(message, sequence, utime))
    assert (frame.type, frame.sequence, frame.utime) == (frame_type, sequence, utime)
    assert plain(frame.message) == plain(message)


@given(cuts=st.lists(st.integers(0, 3 * len(GOOD)), max_size=8))
def test_frames_come_out_whole_however_the_stream_is_cut(cuts: list[int]) -> None:
    stream, decoder = 3 * GOOD, FrameDecoder()
    edges = [0, *sorted(cuts), len(stream)]
    frames = [frame for start, end in itertools.pairwise(edges) for frame in decoder.feed(stream[start:end])]
    assert [frame.sequence for frame in frames] == [7, 7, 7]
    assert decoder.held == 0


@pytest.mark.parametrize("size", range(0, len(GOOD), 5))
def test_truncated_frame_waits_for_its_end(size: int) -> None:
    decoder = FrameDecoder()
    assert decoder.feed(GOOD[:size]) == []
    assert decoder.held == size
    assert len(decoder.feed(GOOD[size:])) == 1


@given(bit=st.integers(0, 8 * len(GOOD) - 1))
def test_one_wrong_bit_is_never_a_frame(bit: int) -> None:
    damaged = bytearray(GOOD)
    damaged[bit // 8] ^= 1 << bit % 8
    decoder = FrameDecoder()
    try:
        # A longer length waits for more, up to its limit.
        assert decoder.feed(bytes(damaged)) == []
    except FrameError:
        return
    with pytest.raises(FrameError, match="checksum"):
        decoder.feed(bytes(MAX_PAYLOAD))


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"GET / HTTP/1.1\r\nHost: board\r\n\r\n", "begins with b'GET '"),
        (sealed(1, b"", MAX_SHORT_PAYLOAD + 1), "announces 4097 bytes"),
        (sealed(99, b""), "unknown frame type 99"),
        (sealed(FrameType.COMMAND, make_hello(ClientRole.OPERATOR, "x").encode()), "holds no actuator_command_t"),
        (sealed(FrameType.CLOCK, b"short"), "holds no board_clock_t"),
        (sealed(FrameType.COMMAND, command(0).encode()[:-1]), "holds no actuator_command_t"),
        (sealed(FrameType.COMMAND, command(0).encode() + b"x"), "its length is not that of its content"),
        (GOOD[:-1] + b"\x01", "wrong checksum"),
    ],
    ids=["another protocol", "oversize", "unknown type", "another message", "short", "cut", "long", "checksum"],
)
def test_what_is_no_frame_is_refused_with_the_reason(data: bytes, complaint: str) -> None:
    with pytest.raises(FrameError, match=complaint):
        FrameDecoder().feed(data)


def test_text_longer_than_its_message_is_refused() -> None:
    """LCM itself would read it as shorter."""
    payload = bytearray(make_hello(ClientRole.OPERATOR, "x").encode())
    assert payload[12:16] == struct.pack(">I", len("operator") + 1)
    payload[12:16] = struct.pack(">I", 2**31)
    with pytest.raises(FrameError, match="board_hello_t"):
        FrameDecoder().feed(sealed(FrameType.HELLO, bytes(payload)))


def test_too_long_a_message_is_not_sent() -> None:
    with pytest.raises(FrameError, match="too long"):
        encode_frame(make_hello(ClientRole.OPERATOR, "x" * MAX_PAYLOAD), 0, 0)


def _seeds() -> list[bytes]:
    frames = [encode_frame(payload(), 1, 1) for payload in PAYLOADS.values()]
    return [GOOD, *frames, encode_frame(command(10_000), 3, 5)]


def _mutate(chance: random.Random, seeds: list[bytes]) -> bytes:
    """Return one to three frames with something done to them, often under a right checksum."""
    data = bytearray(b"".join(chance.choice(seeds) for _ in range(chance.choice((1, 1, 2, 3)))))
    for _ in range(chance.randrange(4)):
        place = chance.randrange(len(data))
        deed = chance.randrange(6)
        if deed == 0:
            data[place] = chance.randrange(256)
        elif deed == 1:
            data[place] ^= 1 << chance.randrange(8)
        elif deed == 2:
            del data[place : place + chance.randrange(1, 20)]
        elif deed == 3:
            data[place:place] = chance.randbytes(chance.randrange(1, 20))
        elif deed == 4:
            data[place : place + 4] = chance.choice((b"\xff\xff\xff\xff", b"\x00\x00\x00\x00", b"\x7f\xff\xff\xff"))
        elif len(data) > HEADER_SIZE:
            payload = bytes(data[HEADER_SIZE:])[:MAX_PAYLOAD]
            data = bytearray(sealed(chance.randrange(12), payload))
        if not data:
            return b"\x00"
    return bytes(data)


def _fuzz(rounds: int, seed: int) -> dict[str, int]:
    chance, seeds = random.Random(seed), _seeds()
    count = {"frames": 0, "refused": 0, "waiting": 0}
    for _ in range(rounds):
        data, decoder = _mutate(chance, seeds), FrameDecoder()
        middle = chance.randrange(len(data) + 1)
        try:
            frames: list[Any] = decoder.feed(data[:middle]) + decoder.feed(data[middle:])
        except FrameError:
            count["refused"] += 1
            continue
        count["frames"] += len(frames)
        count["waiting"] += decoder.held > 0
        assert decoder.held < HEADER_SIZE + MAX_PAYLOAD
        consumed = len(data) - decoder.held
        # What was decoded is what was sent, to the byte.
        again = b"".join(encode_frame(frame.message, frame.sequence, frame.utime) for frame in frames)
        assert again == data[:consumed]
    return count


def test_decoder_survives_fuzzed_streams() -> None:
    count = _fuzz(20_000, seed=1)
    assert min(count.values()) > 500, count


@pytest.mark.slow
def test_decoder_survives_a_million_fuzzed_streams() -> None:
    count = _fuzz(1_000_000, seed=2)
    assert min(count.values()) > 25_000, count
