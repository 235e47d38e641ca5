"""Plots, the table of channels, and the view in the browser."""

import base64
import io
import re
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import matplotlib.pyplot as plt
import msgspec
import numpy as np
import pytest
import zstandard
from command_line import Run
from recorded_trials import Recorded, write_events
from requirements import needs
from rich.console import Console

from imolo.config.loading import known_body
from imolo.contracts.trial import EventName
from imolo.inspect.fields import parse_selector
from imolo.inspect.plot import draw_fields, short_names
from imolo.inspect.series import read_series
from imolo.inspect.statistics import BusStatistics, ChannelStatistics, _short
from imolo.inspect.top import WIDE, live_table, watch
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import read_log
from imolo.messaging.log_file import read_events
from imolo.messaging.transport import MEMORY
from imolo.view.sessions import LiveSession, recorded_sessions
from imolo_msgs import mocap_frame_t, plan_t, trial_event_t, truth_robot_t

# Plots


def test_plot_draws_every_element_of_every_log(recorded: Recorded) -> None:
    logs = [recorded.first, recorded.second]
    selectors = [parse_selector("ACTUATOR_STATE.measured[0:3]"), parse_selector("PLAN.theta[1]")]
    pressures, theta = draw_fields(logs, selectors).axes
    assert (len(pressures.lines), len(theta.lines)) == (6, 2)
    assert (pressures.get_ylabel(), theta.get_ylabel(), theta.get_xlabel()) == ("[Pa]", "[s]", "time [s]")
    (expected,) = read_series(logs[1], selectors[1:])
    # Before its motion has started a plan has no theta.
    drawn, values = theta.lines[1].get_xydata(), np.column_stack([expected.time, expected.values])
    assert np.array_equal(drawn, values, equal_nan=True)


@pytest.mark.parametrize("count", [1, 2])
def test_plot_of_one_log_is_titled_by_it(recorded: Recorded, count: int) -> None:
    logs = [recorded.first, recorded.second][:count]
    assert draw_fields(logs, [parse_selector("PLAN.theta[1]")]).get_suptitle() == (str(logs[0]) if count == 1 else "")


def test_plot_writes_a_figure(recorded: Recorded, run: Run) -> None:
    code, output, errors = run("plot", recorded.first, "MOCAP.frame_number", "--out", "plot.png")
    assert (code, output, errors) == (0, "the figure is plot.png\n", "")
    assert plt.imread("plot.png").std() > 0.0


def test_plot_of_an_unknown_field_is_one_line(recorded: Recorded, run: Run) -> None:
    code, _, errors = run("plot", recorded.first, "PLAN.thet", "--out", "plot.png")
    assert (code, errors.count("\n"), "did you mean 'theta'?" in errors) == (2, 1, True)


def test_figure_of_an_unknown_kind_is_one_line(recorded: Recorded, run: Run) -> None:
    code, _, errors = run("plot", recorded.first, "PLAN.state", "--out", "plot.txt")
    assert (code, errors.count("\n"), "cannot write the figure plot.txt" in errors) == (2, 1, True)


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["a/mujoco/hit/x.lcmlog", "a/dart/hit/x.lcmlog"], ["mujoco", "dart"]),
        (["a/x_1.lcmlog", "a/x_2.lcmlog"], ["x_1", "x_2"]),
        (["a/x.lcmlog"], ["x"]),
        (["x.lcmlog", "x.lcmlog"], ["x", "x"]),
        (["lcmlog-2026-03-14.00", "lcmlog-2026-03-14.01"], ["lcmlog-2026-03-14.00", "lcmlog-2026-03-14.01"]),
        (["a/x", "a/x.lcmlog"], ["x", "x.lcmlog"]),
        (["/logs/x.lcmlog", "x.lcmlog"], ["/logs/x", "x"]),
        ([".lcmlog"], [".lcmlog"]),
        (["x\x1b[31m.lcmlog"], ["x\\x1b[31m"]),
    ],
)
def test_logs_are_called_by_what_differs_in_their_paths(paths: list[str], names: list[str]) -> None:
    assert short_names([Path(path) for path in paths]) == names


# Channels


def test_rates_of_a_log_are_those_of_the_channel_table(recorded: Recorded) -> None:
    statistics = BusStatistics()
    for event in read_events(recorded.first):
        statistics.add(event.channel, event.data, event.utime * 1e-6)
    found = {channel.channel: channel for channel in statistics.channels}
    assert list(found) == list(channels.STREAMS)
    # Stamps are multiples of the 1 ms between two looks at the bus, over most of a second.
    assert found["ACTUATOR_STATE"].mean_rate == pytest.approx(1000.0, rel=1e-2)
    assert found["TRUTH_ROBOT"].mean_rate == pytest.approx(240.0, rel=1e-2)
    assert found["ACTUATOR_STATE"].missing == 0
    assert found["BALL_STATE"].missing is None


def test_gaps_in_the_numbers_are_counted_and_a_new_trial_is_none() -> None:
    statistics = ChannelStatistics(channels.MOCAP)
    for index, number in enumerate((1, 2, 5, 6, 1, 2, 4, 2**31 - 1, 5, 7)):  # one is a stranger's
        frame = mocap_frame_t()
        frame.frame_number = number
        statistics.add(frame.encode(), 0.01 * index)
    assert (statistics.count, statistics.missing) == (10, 4)


def test_messages_of_another_type_and_of_others_are_counted() -> None:
    wrong, foreign = ChannelStatistics(channels.MOCAP), ChannelStatistics("CAMERA")
    for statistics in (wrong, foreign):
        statistics.add(trial_event_t().encode(), 0.0)
    assert (wrong.undecoded, foreign.undecoded, wrong.count, foreign.count) == (1, 0, 1, 1)


@pytest.mark.parametrize("count", [1, 2, 5, 41])
def test_rate_of_a_running_session_is_that_of_the_last_second(count: int) -> None:
    """A message every 50 ms; the rate is asked for with the last one."""
    statistics = ChannelStatistics("CAMERA")
    for number in range(count):
        statistics.add(b"", 0.05 * number)
    now = 0.05 * (count - 1) + 1e-6
    # Within the first second the messages so far are divided by the time so far.
    expected = count / max(now, 1e-3) if now < 1.0 else 20.0
    assert statistics.rate(now) == pytest.approx(expected)
    assert statistics.rate(now + 1.0) == 0.0


def test_rate_beyond_what_is_remembered_is_that_of_what_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imolo.inspect.statistics.MOST_RECENT", 100)
    statistics = ChannelStatistics("CAMERA")
    for number in range(500):
        statistics.add(b"", 0.001 * number)
    assert statistics.rate(0.499) == pytest.approx(100 / 0.099)


@pytest.mark.parametrize(("length", "shown"), [(8, "1 1 1 1 1 1 1 1]"), (9, "1 1 1 1 1 1 1 1 …]")])
def test_long_array_is_cut(length: int, shown: str) -> None:
    assert _short([1.0] * length) == f"[{shown}"


def test_single_gap_has_no_jitter_and_no_gap_no_rate() -> None:
    statistics = ChannelStatistics("CAMERA")
    statistics.add(b"", 5.0)
    assert (statistics.mean_rate, statistics.jitter) == (0.0, 0.0)
    statistics.add(b"", 5.5)
    assert (statistics.mean_rate, statistics.jitter) == (2.0, 0.0)
    statistics.pause()
    statistics.add(b"", 9.0)
    assert (statistics.mean_rate, statistics.jitter, statistics.count) == (2.0, 0.0, 3)


def test_silent_channel_is_dim_after_a_second() -> None:
    statistics = BusStatistics()
    statistics.add("PLAN", plan_t().encode(), 10.0)
    for age, style in ((1.0, ""), (1.1, "dim")):
        table = live_table(statistics, "url", 10.0 + age, WIDE)
        assert table.rows[-1].style == style
        assert len(table.columns) == 8
        assert len(live_table(statistics, "url", 10.0 + age, WIDE - 1).columns) == 7


def test_jitter_is_the_spread_of_the_gaps() -> None:
    statistics = ChannelStatistics("CAMERA")
    for time in (0.0, 0.010, 0.030, 0.040, 0.060):
        statistics.add(b"", time)
    # Gaps of 10 and 20 ms in turn: 5 ms from their mean.
    assert statistics.jitter == pytest.approx(0.005)
    assert statistics.mean_rate == pytest.approx(4 / 0.060)


@pytest.mark.parametrize("width", [40, 80, 140])
def test_top_shows_every_channel_of_a_log_and_cuts_no_number(
    recorded: Recorded, run: Run, monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    monkeypatch.setattr("imolo.inspect.commands.console.width", width)
    code, output, errors = run("top", recorded.first)
    assert (code, errors) == (0, "")
    assert all(re.search(rf"^ {name} ", output, flags=re.MULTILINE) for name in channels.STREAMS)
    assert ("mocap_frame_t" in output) == (width == 140)
    assert max(map(len, output.splitlines())) <= width
    assert not re.search(r"\w…", output)
    assert ("…" in output) == (width > 40)


def test_long_name_of_a_channel_leaves_room_for_the_numbers(
    recorded: Recorded, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("imolo.inspect.commands.console.width", 80)
    events = list(read_events(recorded.first))
    long = [event._replace(channel="/robot/left/arm/joint_states" * 3) for event in events[:10]]
    code, output, _ = run("top", write_events(tmp_path / "long.lcmlog", [*events, *long]))
    (line,) = (line for line in output.splitlines() if line.startswith(" MOCAP "))
    assert code == 0
    assert line.split()[1] == str(sum(event.channel == channels.MOCAP for event in events))


@pytest.mark.parametrize("mark", [pytest.param(None, marks=needs("netns"))], ids=["udpm"])
def test_top_follows_a_bus(recorded: Recorded, mark: None) -> None:
    """In a network namespace: the log is played while top looks on."""
    imolo, player = (Path(sys.executable).with_name(name) for name in ("imolo", "lcm-logplayer"))
    url = "udpm://239.255.76.67:7667?ttl=0"
    script = (
        "ip link set lo up; ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo; "
        f"({imolo} top --bus '{url}' --seconds 6 > {recorded.first}.top) & top=$!; sleep 3; "
        f"{player} --speed=1 --lcm-url='{url}' {recorded.first}; wait $top"
    )
    subprocess.run(
        ["unshare", "--net", "sh", "-c", script], check=True, capture_output=True, timeout=60, env={"COLUMNS": "140"}
    )
    shown = Path(f"{recorded.first}.top").read_text()
    for name, messages in read_log(recorded.first).messages.items():
        assert re.search(rf"^ {name} +\w+_t +{len(messages)} ", shown, flags=re.MULTILINE), shown


def test_picture_is_drawn_anew_while_top_looks_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imolo.inspect.top.REFRESH", 0.05)
    screen = io.StringIO()
    watch(MEMORY, Console(file=screen, force_terminal=True, width=120, height=40), seconds=1.0)
    assert screen.getvalue().count(channels.MOCAP) > 2  # not only at its start and at its end


# View


def decode_view(html: str) -> list[tuple[float, dict[str, object]]]:
    """Return the timed messages of a viser page, as its player reads them."""
    (data,) = re.findall(r'__VISER_EMBED_DATA__="([^"]+)"', html)
    packed = base64.b64decode(data)
    inner = zstandard.ZstdDecompressor().decompressobj().decompress(packed[8:])
    length = int.from_bytes(inner[:8], "little")
    content = msgspec.msgpack.decode(inner[8 : 8 + length])
    return [(time, message) for time, message in content["messages"]]


@pytest.mark.filterwarnings("default")
def test_page_plays_robot_ball_and_plan_of_every_log_without_a_network(
    recorded: Recorded, run: Run, tmp_path: Path
) -> None:
    path = tmp_path / "view.html"
    code, output, errors = run("view", recorded.first, recorded.second, "--html", path, "--speed", "1")
    assert (code, output, errors) == (0, f"the view is {path}\n", "")
    messages = decode_view(path.read_text())
    duration = max(read_log(log).messages["TRIAL"][-1].utime for log in (recorded.first, recorded.second)) * 1e-6
    assert messages[-1][0] == pytest.approx(duration, abs=0.05)
    for number in (0, 1):
        moved = {str(message.get("name")) for time, message in messages if time > 0.0}
        root = f"/session_{number}"
        assert {f"{root}/{part}" for part in ("robot", "ball", "markers", "prediction", "target")} <= moved
        # The joints move as well.
        assert any(name.startswith(f"{root}/robot/visual/") for name in moved)


def test_recorded_session_shows_the_newest_messages_by_their_own_time(recorded: Recorded) -> None:
    (session,) = recorded_sessions([recorded.first], ["x"])
    with closing(session):
        moment = session.at(0.3)
        assert all(0.29 < moment[name].utime * 1e-6 <= 0.3 for name in ("TRUTH_ROBOT", "TRUTH_BALL", "MOCAP", "PLAN"))
        assert session.at(0.3)["PLAN"] is moment["PLAN"]  # what is not new is not drawn again
        assert set(session.at(0.0)) == {"TRIAL"}


def test_live_session_shows_what_came_last() -> None:
    bus = Bus()
    session = LiveSession(bus)
    for utime in (1, 2):
        truth = truth_robot_t()
        truth.utime = utime
        bus.publish(channels.TRUTH_ROBOT, truth)
    bus.drain()
    assert session.at()["TRUTH_ROBOT"].utime == 2
    assert "MOCAP" not in session.at()
    start = trial_event_t()
    start.event, start.robot = EventName.START, "liberobot"
    bus.publish(channels.TRIAL, start)
    bus.drain()
    assert set(session.at()) == {"TRIAL"}
    assert session.robot == "liberobot"


def test_plug_in_tells_what_its_robot_looks_like(recorded: Recorded) -> None:
    robot = known_body("liberobot")
    assert robot is not None
    assert robot.urdf.is_file()
    truth = read_log(recorded.first).messages[channels.TRUTH_ROBOT][0]
    assert len(robot.joint_names) == len(truth.joint_angle)
    assert len(robot.effectors) == len(truth.effector_position)
    assert known_body("atlas") is None


@pytest.mark.parametrize("arguments", [["--html", "x.html"], ["gone.lcmlog"]])
def test_view_of_nothing_is_one_line(run: Run, arguments: list[str]) -> None:
    code, _, errors = run("view", *arguments)
    assert (code, errors.count("\n")) == (2, 1)
