"""Logs: what is sent is what is read, by us and by the tools of LCM."""

import subprocess
import sys
from pathlib import Path

import lcm
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import messages, plain

from imolo.errors import BusError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import Recorder, read_log
from imolo_msgs import mocap_frame_t, plan_t

BIN = Path(sys.executable).parent
FRAMES = 20


def record(path: Path) -> None:
    """Write `FRAMES` frames, one per millisecond, each followed by a plan."""
    utime = 0
    bus = Bus()
    with Recorder(bus, path, lambda: utime):
        for number in range(FRAMES):
            utime = 1000 * number
            frame, plan = mocap_frame_t(), plan_t()
            frame.utime = plan.utime = utime
            frame.frame_number = plan.answered_frame = number
            bus.publish(channels.MOCAP, frame)
            bus.publish(channels.PLAN, plan)
            bus.drain()


def events(path: Path) -> list[tuple[int, str, bytes]]:
    log = lcm.EventLog(str(path), "r")
    try:
        return [(event.timestamp, event.channel, event.data) for event in log]
    finally:
        log.close()


def write(path: Path, *sent: tuple[str, bytes]) -> Path:
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for utime, (channel, data) in enumerate(sent):
        log.write_event(utime, channel, data)
    log.close()
    return path


@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_log_holds_what_was_sent_when_it_was_sent(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("log") / "trial.lcmlog"
    sent = data.draw(st.lists(st.sampled_from(sorted(CHANNELS)).flatmap(_with_message), max_size=8))
    bus = Bus()
    now = 0
    with Recorder(bus, path, lambda: now):
        for now, (channel, message) in enumerate(sent):  # noqa: B007 (the clock reads it)
            bus.publish(channel, message)
            bus.drain()
    log = read_log(path)
    for name in CHANNELS:
        expected = [(when, plain(message)) for when, (channel, message) in enumerate(sent) if channel == name]
        assert [(t, plain(m)) for t, m in zip(log.received[name], log.messages[name], strict=True)] == expected


def _with_message(channel: str) -> st.SearchStrategy[tuple[str, object]]:
    return st.tuples(st.just(channel), messages(CHANNELS[channel].message_type))


def test_event_reader_of_lcm_sees_the_same(tmp_path: Path) -> None:
    path = tmp_path / "trial.lcmlog"
    record(path)
    log = read_log(path)
    for name in (channels.MOCAP, channels.PLAN):
        raw = [(time, data) for time, channel, data in events(path) if channel == name]
        assert raw == [(t, m.encode()) for t, m in zip(log.received[name], log.messages[name], strict=True)]
        assert len(raw) == FRAMES


def test_lcm_logplayer_plays_every_message(tmp_path: Path) -> None:
    path, played = tmp_path / "trial.lcmlog", tmp_path / "played.lcmlog"
    record(path)
    subprocess.run(
        [BIN / "lcm-logplayer", "--speed=1000", f"--lcm-url=file://{played}?mode=w", path],
        check=True,
        capture_output=True,
        timeout=30,
    )
    # The player stamps by its own clock.
    assert [event[1:] for event in events(played)] == [event[1:] for event in events(path)]


def test_lcm_logfilter_keeps_one_channel(tmp_path: Path) -> None:
    path, filtered = tmp_path / "trial.lcmlog", tmp_path / "filtered.lcmlog"
    record(path)
    subprocess.run([BIN / "lcm-logfilter", "-c", channels.MOCAP, path, filtered], check=True, timeout=30)
    assert events(filtered) == [event for event in events(path) if event[1] == channels.MOCAP]
    assert [frame.frame_number for frame in read_log(filtered).messages[channels.MOCAP]] == list(range(FRAMES))


def test_log_is_complete_when_the_trial_fails(tmp_path: Path) -> None:
    bus = Bus()
    with pytest.raises(RuntimeError, match="engine"), Recorder(bus, tmp_path / "log", lambda: 7):  # noqa: PT012
        bus.publish(channels.PLAN, plan_t())
        bus.drain()
        raise RuntimeError("the engine broke")
    assert read_log(tmp_path / "log").received[channels.PLAN] == [7]


def test_log_replaces_an_older_one(tmp_path: Path) -> None:
    record(tmp_path / "log")
    with Recorder(Bus(), tmp_path / "log", lambda: 0):
        pass
    assert events(tmp_path / "log") == []


def test_foreign_channels_are_passed_over(tmp_path: Path) -> None:
    path = write(tmp_path / "log", ("CAMERA", b"\x00" * 12), (channels.PLAN, plan_t().encode()))
    log = read_log(path)
    assert {name: len(messages) for name, messages in log.messages.items() if messages} == {channels.PLAN: 1}


def test_channel_of_another_type_names_file_and_event(tmp_path: Path) -> None:
    path = write(tmp_path / "log", (channels.PLAN, plan_t().encode()), *[(channels.MOCAP, plan_t().encode())] * 2)
    with pytest.raises(BusError, match=f"{path}: event 1 on MOCAP is no mocap_frame_t"):
        read_log(path)


# Fingerprint of the trial_event_t of imolo 0.1, and a message with nothing in it.
OLDER_EVENT = bytes.fromhex("85d8afedc33c97b7") + bytes(80)


@pytest.mark.parametrize("older", [("VALVE_COMMAND", b""), ("VALVE_PRESSURE", b""), (channels.TRIAL, OLDER_EVENT)])
def test_log_of_imolo_0_1_is_refused_in_a_line_that_says_what_to_do(tmp_path: Path, older: tuple[str, bytes]) -> None:
    path = write(tmp_path / "log", (channels.MOCAP, mocap_frame_t().encode()), older)
    with pytest.raises(BusError) as caught:
        read_log(path)
    assert str(caught.value) == (
        f"{path} was recorded before robots were plug-ins; read it with imolo 0.1, or record it again"
    )


def test_shortened_message_names_file_and_event(tmp_path: Path) -> None:
    path = write(tmp_path / "log", (channels.MOCAP, mocap_frame_t().encode()[:-1]))
    with pytest.raises(BusError, match="event 0 on MOCAP"):
        read_log(path)


def test_file_that_is_no_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_text("no log at all\n" * 10)
    with pytest.raises(BusError, match="log"):
        read_log(path)


def test_missing_log_is_named(tmp_path: Path) -> None:
    with pytest.raises(BusError, match=f"there is no log {tmp_path / 'gone'}"):
        read_log(tmp_path / "gone")


@pytest.mark.parametrize("place", ["file/below", "folder"])
def test_log_that_cannot_be_written_is_a_bus_error(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder").mkdir()
    with pytest.raises(BusError, match=r"cannot write the log .*choose a folder"):
        Recorder(Bus(), tmp_path / place, lambda: 0)
