"""Damaged logs: what is whole is read, what is not is told, and nothing else happens."""

import logging
import struct
from pathlib import Path

import lcm
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tries import tries

from imolo.errors import BusError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import Recorder, read_log
from imolo.messaging.log_file import HEADER, SYNC, Damage, LogEvent, LogReader, read_events
from imolo_msgs import actuator_state_t, mocap_frame_t

COUNT = 12


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bytes of a log of `COUNT` sensor readings and frames in turn, one every 10 ms."""
    path = tmp_path_factory.mktemp("whole") / "log"
    utime, bus = 0, Bus()
    with Recorder(bus, path, lambda: utime):
        for number in range(COUNT):
            utime = 10_000 * number
            message = mocap_frame_t() if number % 2 else actuator_state_t()
            message.utime = utime
            bus.publish(channels.MOCAP if number % 2 else channels.ACTUATOR_STATE, message)
            bus.drain()
    return path.read_bytes()


@pytest.fixture
def starts(whole: bytes, tmp_path: Path) -> list[int]:
    (tmp_path / "whole").write_bytes(whole)
    return [event.offset for event in read_events(tmp_path / "whole")]


def numbers(path: Path, content: bytes) -> list[int]:
    path.write_bytes(content)
    return [event.number for event in read_events(path)]


def read(path: Path) -> tuple[list[LogEvent], list[Damage]]:
    with LogReader(path) as reader:
        return list(reader), reader.damage


def test_whole_log_reads_as_lcm_reads_it(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(whole)
    events, damage = read(path)
    reader = lcm.EventLog(str(path), "r")
    expected = [(event.eventnum, event.timestamp, event.channel, event.data) for event in reader]
    reader.close()
    assert [event[:4] for event in events] == expected
    assert damage == []


def test_cut_log_is_read_up_to_the_last_whole_event(whole: bytes, starts: list[int], tmp_path: Path) -> None:
    path = tmp_path / "log"
    for length in range(1, len(whole)):
        path.write_bytes(whole[:length])
        complete = sum(start <= length for start in (*starts[1:], len(whole)))
        if complete == 0:
            with pytest.raises(BusError, match="is no LCM log"):
                read(path)
            continue
        events, damage = read(path)
        assert len(events) == complete
        assert bool(damage) == (length not in starts)


def test_cut_log_says_when_and_where(
    whole: bytes, starts: list[int], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "log"
    path.write_bytes(whole[: starts[7] + 40])
    with caplog.at_level(logging.WARNING):
        log = read_log(path)
    assert len(log.messages[channels.ACTUATOR_STATE]) == 4
    place = f"bytes {starts[7]} to {starts[7] + 40}"
    assert caplog.messages == [f"{path} is damaged: the log is cut off after 0.060000 s ({place}); the rest was read"]


@pytest.mark.parametrize(("broken", "others"), [((2,), ""), ((2, 5), ", and 1 more"), ((2, 5, 8), ", and 2 more")])
def test_first_damage_is_told_and_the_others_are_counted(
    whole: bytes,
    starts: list[int],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    broken: tuple[int, ...],
    others: str,
) -> None:
    content = bytearray(whole)
    for number in broken:
        content[starts[number]] ^= 1
    with caplog.at_level(logging.WARNING):
        numbers(tmp_path / "log", bytes(content))
    (message,) = caplog.messages
    assert f"(bytes {starts[2]} to {starts[3]}){others}; the rest was read" in message


def test_garbage_after_the_last_event_costs_no_event(whole: bytes, tmp_path: Path) -> None:
    assert numbers(tmp_path / "log", whole + b"garbage" * 9) == list(range(COUNT))


def test_hole_costs_the_events_it_touches(whole: bytes, starts: list[int], tmp_path: Path) -> None:
    content = whole[: starts[3] + 10] + whole[starts[5] + 9 :]
    assert numbers(tmp_path / "log", content) == [n for n in range(COUNT) if n not in (3, 4, 5)]


def test_damaged_sync_word_costs_one_event(whole: bytes, starts: list[int], tmp_path: Path) -> None:
    content = bytearray(whole)
    content[starts[4]] ^= 0xFF
    assert numbers(tmp_path / "log", bytes(content)) == [n for n in range(COUNT) if n != 4]


@pytest.mark.parametrize("length", [-1, 0, 1, 50, 2**20, 2**31 - 1])
@pytest.mark.parametrize("field", [20, 24], ids=["channel", "data"])
def test_damaged_length_costs_one_event(
    whole: bytes, starts: list[int], tmp_path: Path, field: int, length: int
) -> None:
    content = bytearray(whole)
    content[starts[4] + field : starts[4] + field + 4] = struct.pack(">i", length)
    assert numbers(tmp_path / "log", bytes(content)) == [n for n in range(COUNT) if n != 4]


def test_sync_word_inside_a_message_is_no_event(tmp_path: Path) -> None:
    data = SYNC * 20
    header = HEADER.pack(SYNC, 0, 7, 1, len(data))
    assert numbers(tmp_path / "log", header + b"A" + data) == [0]
    assert numbers(tmp_path / "log", b"x" + header + b"A" + data) == [0]


def test_damaged_message_is_passed_over_and_told(whole: bytes, starts: list[int], tmp_path: Path) -> None:
    content = bytearray(whole)
    content[starts[5] + HEADER.size + len(channels.MOCAP)] ^= 1  # first byte of the fingerprint
    path = tmp_path / "log"
    path.write_bytes(content)
    log = read_log(path)
    assert [frame.utime for frame in log.messages[channels.MOCAP]] == [10_000, 30_000, 70_000, 90_000, 110_000]
    assert [str(part) for part in log.damage] == [
        f"a damaged message on MOCAP after 0.050000 s (bytes {starts[5]} to {starts[6]})"
    ]


def test_strangers_alone_on_a_channel_cost_no_message_of_the_others(whole: bytes, tmp_path: Path) -> None:
    name, data = b"HEARTBEAT", b"another type"
    path = tmp_path / "log"
    path.write_bytes(whole + HEADER.pack(SYNC, COUNT, 10_000 * COUNT, len(name), len(data)) + name + data)
    log = read_log(path)
    assert len(log.messages[channels.MOCAP]) == len(log.messages[channels.ACTUATOR_STATE]) == COUNT // 2
    assert [part.what for part in log.damage] == ["a damaged message on HEARTBEAT"]


def test_log_of_strangers_alone_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(HEADER.pack(SYNC, 0, 0, 5, 12) + b"MOCAP" + b"another type")
    with pytest.raises(BusError, match="event 0 on MOCAP is no mocap_frame_t"):
        read_log(path)


@settings(max_examples=tries(200), deadline=None)
@given(data=st.data())
def test_any_damage_costs_no_more_than_it_touches(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Overwrite a part of the file: events that end before it or start after it are read, or the file is refused."""
    path = tmp_path_factory.getbasetemp() / "damaged.lcmlog"
    path.write_bytes(whole)
    events, _ = read(path)
    first = data.draw(st.integers(0, len(whole) - 1))
    patch = data.draw(st.binary(min_size=1, max_size=150))[: len(whole) - first]
    path.write_bytes(whole[:first] + patch + whole[first + len(patch) :])
    ends = [event.offset for event in events[1:]] + [len(whole)]
    untouched = [
        event for event, end in zip(events, ends, strict=True) if end <= first or event.offset >= first + len(patch)
    ]
    try:
        found, _ = read(path)
        read_log(path)
    except BusError:
        return
    assert set(untouched) <= set(found)


@settings(max_examples=tries(200), deadline=None)
@given(content=st.lists(st.one_of(st.binary(max_size=40), st.just(SYNC)), max_size=12).map(b"".join))
def test_any_bytes_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "bytes.lcmlog"
    path.write_bytes(content)
    try:
        events, damage = read(path)
    except BusError:
        return
    # Every byte is either part of an event or told to be damaged.
    covered = sum(HEADER.size + len(event.channel) + len(event.data) for event in events)
    assert covered + sum(part.end - part.start for part in damage) == len(content)
