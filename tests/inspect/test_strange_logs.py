"""Logs of other recorders, other clocks, other programs, and files that are no logs: shown, or refused in one line."""

import logging
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import IMOLO, Run, is_one_line_about
from recorded_trials import WALL, Recorded, write_events

from imolo.errors import BusError, ResultsError
from imolo.inspect.export import ExportFormat, export
from imolo.inspect.top import log_table
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log_file import HEADER, SEARCHED, SYNC, LogEvent, LogReader, read_events
from imolo.view.sessions import LiveSession
from imolo_msgs import plan_t, truth_ball_t, truth_robot_t

Events = list[LogEvent]

HOUR = 3_600_000_000  # [µs]


def wall(events: Events) -> Events:
    return [event._replace(utime=WALL + event.utime) for event in events]


def nanoseconds(events: Events) -> Events:
    return [event._replace(utime=1000 * (WALL + event.utime)) for event in events]


def negative(events: Events) -> Events:
    return [event._replace(utime=event.utime - 500_000) for event in events]


def stepping_back(events: Events) -> Events:
    half = len(events) // 2
    return [event._replace(utime=WALL + event.utime - (HOUR if n >= half else 0)) for n, event in enumerate(events)]


def beside(channel: str, data: bytes) -> Callable[[Events], Events]:
    return lambda events: [each for event in events for each in (event, event._replace(channel=channel, data=data))]


def of_another_type(events: Events) -> Events:
    """Another program speaks on MOCAP alone."""
    return [event._replace(data=bytes(48)) if event.channel == "MOCAP" else event for event in events]


def doubled(events: Events) -> Events:
    return [event for event in events for _ in range(2)]


def nested(events: Events) -> Events:
    """Messages that carry a log, whose numbers go on as if its events were those of this log."""
    block = b"".join(event.data for event in events[:5])
    return [*events[:50], LogEvent(0, events[49].utime, "FILE_BLOCK", block, 0), *events[50:]]


STRANGE = {
    "wall": wall,
    "nanoseconds": nanoseconds,
    "negative": negative,
    "stepping back": stepping_back,
    "long channel": beside("/robot/left/arm/joint_states/filtered/with/a/very/long/name/of/a/topic", b"x" * 50),
    "UTF-8 channel": beside("KRAFT_MESSPLATTE_süd", b"x"),
    "ANSI channel": beside("\x1b[31mRED", b"x"),
    "no data": beside("HELLO", b""),
    "another type": of_another_type,
    "doubled": doubled,
    "nested": nested,
}
NOT_IN_MCAP = ("nanoseconds", "negative")


@pytest.fixture(params=STRANGE)
def strange(request: pytest.FixtureRequest, recorded: Recorded, tmp_path: Path) -> tuple[str, Path]:
    name = request.param
    return name, write_events(tmp_path / "strange.lcmlog", STRANGE[name](list(read_events(recorded.first))))


def test_every_command_shows_a_strange_log_or_says_why_not(
    strange: tuple[str, Path], recorded: Recorded, run: Run, caplog: pytest.LogCaptureFixture
) -> None:
    name, path = strange
    plot = ("TRUTH_BALL.true_ball_position", "PLAN.state", "--out", "x.png")
    for command, code in (
        (("top", path), 0),
        (("plot", path, *plot), 0),
        (("diff", path, recorded.first, "--out", "y.png"), 1),
        (("export", path, "--to", "csv"), 2 if name == "another type" else 0),
        (("export", path, "--out", "x.mcap"), 2 if name == "another type" or name in NOT_IN_MCAP else 0),
    ):
        caplog.clear()
        found, output, errors = run(*command)
        assert found == code, errors
        assert (errors == "") if code != 2 else is_one_line_about(errors, path.name)
        assert "\x1b[31m" not in output + errors
        assert not any("damaged" in message for message in caplog.messages) or name == "another type"
        assert sum("steps back" in message for message in caplog.messages) == (name == "stepping back")
    assert not [left for left in Path().rglob("*") if left.name.endswith(".tmp")]
    if name in NOT_IN_MCAP:
        assert not Path("x.mcap").exists()


@pytest.mark.parametrize("to", ["mcap", "csv"])
def test_log_whose_name_is_no_text_is_exported_again_and_again(recorded: Recorded, run: Run, to: str) -> None:
    path = Path(os.fsdecode(b"s\xfcd.lcmlog"))
    path.write_bytes(recorded.first.read_bytes())
    for _ in range(2):
        code, _, errors = run("export", path, "--to", to)
        assert (code, errors) == (0, "")


@pytest.mark.parametrize("to", ["mcap", "csv"])
def test_log_of_others_alone_is_not_exported(recorded: Recorded, tmp_path: Path, run: Run, to: str) -> None:
    others = [event._replace(channel="CAMERA", data=b"x") for event in read_events(recorded.first)]
    path = write_events(tmp_path / "others.lcmlog", others)
    code, output, errors = run("export", path, "--to", to)
    assert (code, output) == (2, "")
    assert is_one_line_about(errors, path.name)
    assert list(tmp_path.iterdir()) == [path]


def test_clock_that_steps_back_goes_on_where_it_was(recorded: Recorded, tmp_path: Path) -> None:
    events = list(read_events(recorded.first))
    path = write_events(tmp_path / "log", stepping_back(events))
    title = str(log_table(path, 140).title)
    half = len(events) // 2
    span = events[-1].utime - events[0].utime - (events[half].utime - events[half - 1].utime)
    assert title == f"{path}, {span * 1e-6:.3f} s"
    with LogReader(path) as reader:
        times = [event.utime + reader.shift for event in reader]
    assert times == sorted(times)


@pytest.mark.parametrize(("later", "others"), [((), ""), ((100_000,), ", and 1 more"), ((9, 8), ", and 2 more")])
def test_step_back_is_told_once_with_when_and_how_far(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, later: tuple[int, ...], others: str
) -> None:
    utimes = (10, 2_000_000, 500_000, 500_000, 600_000, *later)
    events = [LogEvent(0, utime, "A", b"", 0) for utime in utimes]
    path = write_events(tmp_path / "log", events)
    with caplog.at_level(logging.WARNING):
        assert len(list(read_events(path))) == len(events)
    (message,) = caplog.messages
    assert f"steps back by 1.500000 s after 2.000000 s{others}; what follows" in message


def test_nested_log_is_one_message(recorded: Recorded, tmp_path: Path) -> None:
    inner = write_events(tmp_path / "inner", list(read_events(recorded.first))[:40]).read_bytes()
    events = [LogEvent(0, n, "FILE", inner if n == 0 else b"x", 0) for n in range(3)]
    path = write_events(tmp_path / "log", events)
    assert [event.data for event in read_events(path)] == [event.data for event in events]


# Files that are no logs, and large ones


@pytest.mark.parametrize("kind", ["fifo", "device", "folder"])
def test_what_has_no_end_is_refused(tmp_path: Path, run: Run, kind: str) -> None:
    path = Path("/dev/zero") if kind == "device" else tmp_path / kind
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    for command in ("top", "export", "view"):
        code, _, errors = run(command, path)
        assert code == 2
        assert is_one_line_about(errors, f"{path} is a folder, pipe or device")


def test_large_file_that_is_no_log_is_refused_after_its_beginning(tmp_path: Path, run: Run) -> None:
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    code, _, errors = run("top", path)
    assert code == 2
    assert is_one_line_about(errors, "sparse is no LCM log")
    read = 0
    with LogReader(path) as reader:
        load = reader._load

        def count(start: int, length: int) -> int:
            nonlocal read
            read = max(read, start + length)
            return load(start, length)

        reader._load = count  # type: ignore[method-assign]
        with pytest.raises(BusError):
            list(reader)
    assert read <= SEARCHED + 10_000


def test_images_among_our_messages_are_not_read(recorded: Recorded, tmp_path: Path) -> None:
    """A log with 2 GB of images is read by a process that may not have 700 MB."""
    path = tmp_path / "log"
    write_events(path, read_events(recorded.first))
    size, image = path.stat().st_size, 900_000
    with path.open("r+b") as file:
        number = len(list(read_events(path)))
        for count in range(2200):
            file.seek(size + count * (HEADER.size + 6 + image))
            file.write(HEADER.pack(SYNC, number + count, 1_000_000 + count, 6, image) + b"CAMERA")
        file.truncate(file.tell() + image)
    limit = 700_000_000

    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    # One thread: the stacks of BLAS's others count as memory too.
    environment = {**os.environ, "COLUMNS": "120", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [IMOLO, "top", path], preexec_fn=bounded, capture_output=True, text=True, timeout=120, env=environment
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "CAMERA" in done.stdout
    assert " 2200 " in done.stdout


def test_message_of_ours_that_claims_a_gigabyte_is_passed_over(tmp_path: Path) -> None:
    path, length = tmp_path / "log", 1 << 30
    with path.open("wb") as file:
        file.write(HEADER.pack(SYNC, 0, 7, 5, length) + b"MOCAP")
        file.truncate(file.tell() + length)
    (event,) = read_events(path)
    assert event.data == b""


# Exports


@pytest.mark.parametrize("to", ["mcap", "csv", "parquet"])
def test_logs_with_numbers_for_endings_are_exported_side_by_side(
    recorded: Recorded, tmp_path: Path, run: Run, to: str
) -> None:
    made = []
    for number, source in enumerate((recorded.first, recorded.second)):
        log = tmp_path / f"lcmlog-2026-03-14.{number:02}"
        log.write_bytes(source.read_bytes())
        made += export(log, ExportFormat(to), None)
    assert len(set(made)) == len(made)
    assert all(path.exists() for path in made)


@pytest.mark.parametrize("to", list(ExportFormat))
def test_export_replaces_its_own_and_nothing_else(recorded: Recorded, tmp_path: Path, to: ExportFormat) -> None:
    out = tmp_path / "out"
    made = export(recorded.first, to, out)
    before = [path.read_bytes() for path in made]
    with pytest.raises(ResultsError, match=f"is the export of {recorded.first}; choose another --out"):
        export(recorded.second, to, out)
    with pytest.raises(ResultsError, match="is the export of"):
        export(recorded.first, to, out, trial=0)
    assert [path.read_bytes() for path in made] == before
    export(recorded.first, to, out)
    other = tmp_path / "other"
    (other if to is ExportFormat.MCAP else other / f"PLAN.{to}").parent.mkdir(exist_ok=True)
    (other if to is ExportFormat.MCAP else other / f"PLAN.{to}").write_text("somebody's work")
    with pytest.raises(ResultsError, match="was not exported from a log"):
        export(recorded.first, to, other)


# Terminals


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_terminal_without_unicode_gets_a_table(recorded: Recorded, tmp_path: Path, encoding: str) -> None:
    path = write_events(tmp_path / "log", beside("süd→", b"x")(list(read_events(recorded.first))))
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "COLUMNS": "100"}
    done = subprocess.run([IMOLO, "top", path], capture_output=True, timeout=120, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "\\u2192" in done.stdout.decode(encoding)


def test_ctrl_c_while_imolo_is_imported_ends_it_without_a_trace() -> None:
    """The module of the commands is made to wait where it would be imported."""
    script = (
        "import sys, time\n"
        "class Waits:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'imolo.command_line.main':\n"
        "            print('importing', flush=True)\n"
        "            try:\n"
        "                time.sleep(60)\n"
        "            except KeyboardInterrupt:\n"
        "                print('swallowed')\n"
        "sys.meta_path.insert(0, Waits())\n"
        "from imolo.command_line.start import main\n"
        "main()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "importing\n"
    process.send_signal(2)
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, output, errors) == (130, "", "")


# Strangers


def test_stranger_on_our_channels_is_passed_over_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    bus = Bus()
    session = LiveSession(bus)
    ball = truth_ball_t()
    ball.utime = 5
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            bus.publish(channels.TRUTH_BALL, ball)
            for channel in (channels.TRUTH_BALL, channels.TRIAL):
                bus.publish_raw(channel, b"\x12\x34" * 24)
                bus.publish_raw(channel, b"")
                bus.publish_raw(channel, plan_t().encode())
            bus.drain()
    assert session.at()[channels.TRUTH_BALL].utime == 5
    assert len(caplog.messages) == 2
    assert "something else than truth_ball_t on TRUTH_BALL" in caplog.messages[0]
    bus.close()


def test_view_passes_over_a_robot_of_another_number_of_joints_and_says_so_once(
    recorded: Recorded, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """As where another robot plays than the one that is looked at."""
    from imolo.view import viewer

    def shorter(event: LogEvent) -> LogEvent:
        if event.channel != channels.TRUTH_ROBOT:
            return event
        message = truth_robot_t.decode(event.data)
        message.num_joints -= 1
        message.joint_angle, message.joint_velocity = message.joint_angle[:-1], message.joint_velocity[:-1]
        return event._replace(data=message.encode())

    session = viewer.RecordedSession(write_events(tmp_path / "log", map(shorter, read_events(recorded.first))), "one")
    with caplog.at_level(logging.WARNING):
        viewer.write_html([session], tmp_path / "view.html", 10.0)
    session.close()
    body = viewer.describe(session.robot)
    joints = len(body.joint_names)
    assert caplog.messages == [f"a robot of {joints - 1} joints is not shown; {body.name} has {joints}"]
    assert (tmp_path / "view.html").stat().st_size > 0


def test_view_of_hours_asks_for_a_trial(recorded: Recorded, tmp_path: Path, run: Run) -> None:
    events = list(read_events(recorded.first))
    later = [event._replace(utime=24 * HOUR + event.utime) for event in events]
    path = write_events(tmp_path / "log", [*events, *later])
    code, _, errors = run("view", path, "--html", "x.html")
    assert code == 2
    assert is_one_line_about(errors, "choose one trial with --trial")
