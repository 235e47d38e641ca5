"""Logs of several trials, as `imolo record` writes them: trials follow one another, or one of them is chosen."""

import csv
import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, is_one_line_about
from mcap.reader import make_reader
from recorded_trials import PAUSE, WALL, Recorded, write_events, write_session

from imolo.contracts.trial import EventName
from imolo.errors import FieldError
from imolo.inspect.diff import compare_logs
from imolo.inspect.fields import parse_selector
from imolo.inspect.plot import draw_fields
from imolo.inspect.series import read_series
from imolo.inspect.top import log_table
from imolo.inspect.trials import Timeline, TrialEvents
from imolo.messaging import channels
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import read_log
from imolo.messaging.log_file import LogEvent, LogReader, read_events
from imolo.view.sessions import recorded_sessions
from imolo_msgs import heartbeat_t, trial_event_t, truth_ball_t

BALL = parse_selector("TRUTH_BALL.true_ball_position")


@pytest.fixture
def session(recorded: Recorded, tmp_path: Path) -> Path:
    return write_session(tmp_path / "session.lcmlog", recorded.first, recorded.second)


def test_plot_shows_trials_one_after_the_other(session: Path, recorded: Recorded) -> None:
    (found,) = read_series(session, [BALL])
    (first,), (second,) = (read_series(path, [BALL]) for path in (recorded.first, recorded.second))
    count = len(first.time)
    assert found.time[:count].tolist() == first.time.tolist()
    assert found.values[:count].tolist() == first.values.tolist()
    # The line is broken between them.
    assert np.isnan(found.values[count]).all()
    assert found.time[count + 1 :] == pytest.approx(second.time + 1e-6 * PAUSE, abs=1e-9)
    assert found.values[count + 1 :].tolist() == second.values.tolist()


def test_chosen_trial_is_what_its_own_log_is(session: Path, recorded: Recorded) -> None:
    for trial, path in enumerate((recorded.first, recorded.second)):
        (found,), (own,) = read_series(session, [BALL], trial), read_series(path, [BALL])
        assert (found.time.tolist(), found.values.tolist()) == (own.time.tolist(), own.values.tolist())
        comparison = compare_logs(session, path, (trial, None))
        assert (comparison.first, comparison.same_recording) == (None, True)


@pytest.mark.parametrize("trial", [2, 7])
def test_trial_that_is_not_there_is_one_line(session: Path, run: Run, trial: int) -> None:
    for command in (
        ("top", session),
        ("plot", session, "PLAN.state", "--out", "x.png"),
        ("diff", session, session),
        ("export", session),
        ("view", session, "--html", "x.html"),
    ):
        code, _, errors = run(*command, "--trial", trial)
        assert code == 2
        assert is_one_line_about(errors, f"has no trial {trial}; it holds 2 trials, counted from 0")
    assert not list(session.parent.glob("*mcap*"))


def test_diff_of_a_session_asks_for_a_trial(session: Path, recorded: Recorded, run: Run) -> None:
    code, _, errors = run("diff", session, recorded.first)
    assert code == 2
    assert is_one_line_about(errors, "session.lcmlog holds several trials; choose one with --trial")
    code, output, _ = run("diff", session, recorded.second, "--trial", 1, "--trial", 0, "--out", "x.png")
    assert (code, "identical" in output) == (0, True)


def test_what_programs_say_beside_a_trial_is_no_part_of_it(recorded: Recorded, tmp_path: Path) -> None:
    events = []
    for number, event in enumerate(read_events(recorded.first)):
        beat = heartbeat_t()
        beat.pid = number
        events += [event, LogEvent(0, event.utime, channels.HEARTBEAT, beat.encode(), 0)]
    path = write_events(tmp_path / "log", events)
    assert compare_logs(path, recorded.first, (0, 0)).same_recording
    assert compare_logs(path, recorded.first).first is not None
    # They have no time of their own, and are shown when they were heard.
    (beats,) = read_series(path, [parse_selector("HEARTBEAT.pid")])
    assert beats.time.tolist() == [event.utime * 1e-6 for event in read_events(recorded.first)]


def start_of(number: int, utime: int, recorded: int) -> LogEvent:
    event = trial_event_t()
    event.utime, event.trial, event.event = utime, number, EventName.START
    return LogEvent(0, recorded, channels.TRIAL, event.encode(), 0)


def ball_at(utime: int, recorded: int) -> LogEvent:
    ball = truth_ball_t()
    ball.utime = utime
    return LogEvent(0, recorded, channels.TRUTH_BALL, ball.encode(), 0)


def test_trial_that_ran_faster_than_it_was_recorded_ends_before_the_next(tmp_path: Path) -> None:
    """A lock-step session: 4 s are simulated within 1 s on the wall, where the next trial starts at 2 s."""
    events = [start_of(0, 0, WALL), ball_at(4_000_000, WALL + 1_000_000)]
    events += [start_of(1, 500, WALL + 2_000_000), ball_at(700, WALL + 2_100_000)]
    path = write_events(tmp_path / "log", events)
    with LogReader(path, CHANNELS) as reader:
        timeline = Timeline(TrialEvents(reader), CHANNELS)
        heard = [(each.time - WALL, each.trial) for each in timeline]
    assert heard == [(0, 0), (4_000_000, 0), (4_000_000, 1), (4_000_200, 1)]
    assert timeline.origin == WALL


@pytest.mark.parametrize(("count", "visible"), [(1, True), (2, False)])
def test_line_of_a_single_message_is_drawn_as_a_point(tmp_path: Path, count: int, visible: bool) -> None:
    path = write_events(tmp_path / "log", [ball_at(300 * number, WALL + 300 * number) for number in range(count)])
    assert all((line.get_marker() == ".") == visible for line in draw_fields([path], [BALL]).axes[0].lines)


def test_log_of_messages_without_a_time_of_their_own_begins_with_the_first(tmp_path: Path) -> None:
    beats = [LogEvent(0, WALL + late, channels.HEARTBEAT, heartbeat_t().encode(), 0) for late in (0, 600)]
    with LogReader(write_events(tmp_path / "log", beats), CHANNELS) as reader:
        timeline = Timeline(TrialEvents(reader), CHANNELS)
        assert [(each.time - WALL, each.trial) for each in timeline] == [(0, -1), (600, -1)]
    assert timeline.origin == WALL


def test_log_without_a_trial_is_on_the_clock_of_its_messages(tmp_path: Path) -> None:
    path = write_events(tmp_path / "log", [ball_at(300, WALL), ball_at(900, WALL + 600)])
    (found,) = read_series(path, [BALL])
    assert found.time.tolist() == [300e-6, 900e-6]


def test_top_leaves_the_pauses_between_trials_out_of_the_rates(session: Path, recorded: Recorded, run: Run) -> None:
    table = log_table(session, 140)
    assert f"{(PAUSE + list(read_events(recorded.second))[-1].utime) * 1e-6:.3f} s, 2 trials" in str(table.title)
    rates = dict(zip(table.columns[0]._cells, table.columns[3]._cells, strict=True))
    assert float(str(rates["ACTUATOR_STATE"])) == pytest.approx(1000.0, rel=1e-2)
    one, own = log_table(session, 140, 1), log_table(recorded.second, 140)
    for column, its_own in zip(one.columns, own.columns, strict=True):
        assert column._cells == its_own._cells


def test_view_shows_one_trial_at_a_time(session: Path, recorded: Recorded) -> None:
    (shown,) = recorded_sessions([session], ["x"])
    with closing(shown):
        assert shown.duration == pytest.approx(
            1e-6 * PAUSE + read_log(recorded.second).messages["TRIAL"][-1].utime * 1e-6
        )
        assert shown.at(0.3)["TRIAL"].trial == 0
        # Where nothing happens, what was last seen of the trial stays.
        assert shown.at(4.9)["TRIAL"].event == EventName.END
        # As soon as the next trial starts, nothing of the one before is left.
        assert set(shown.at(1e-6 * PAUSE)) == {"TRIAL"}
        assert shown.at(1e-6 * PAUSE)["TRIAL"].event == EventName.START
        later = shown.at(1e-6 * PAUSE + 0.3)
        assert all(0.29 < later[name].utime * 1e-6 <= 0.3 for name in ("TRUTH_ROBOT", "TRUTH_BALL", "MOCAP", "PLAN"))
    (second,) = recorded_sessions([session], ["x"], trial=1)
    (own,) = recorded_sessions([recorded.second], ["x"])
    with closing(second), closing(own):
        for time in np.arange(0.0, own.duration, 0.1):
            moments = [{name: m.encode() for name, m in each.at(time).items()} for each in (second, own)]
            assert moments[0] == moments[1]


def test_mcap_of_a_session_is_on_one_clock(session: Path, run: Run, tmp_path: Path) -> None:
    code, _, errors = run("export", session, "--out", tmp_path / "s.mcap")
    assert (code, errors) == (0, "")
    entities = deletions = 0
    last = 0
    with (tmp_path / "s.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            assert message.log_time >= last
            last = message.log_time
            if channel.topic not in ("/scene", "/tf"):
                continue
            content = json.loads(message.data)
            for each in content.get("entities", []) + content.get("deletions", []) + content.get("transforms", []):
                stamp = each["timestamp"]["sec"] * 10**9 + each["timestamp"]["nsec"]
                assert stamp == message.log_time
            entities += len(content.get("entities", []))
            for deletion in content.get("deletions", []):
                assert (deletion["type"], message.log_time) == (1, 1000 * (WALL + deletions * PAUSE))
                deletions += 1
    assert deletions == 2
    assert entities > 100


def test_tables_of_a_session_say_which_trial_a_row_is_of(session: Path, recorded: Recorded, run: Run) -> None:
    run("export", session, "--to", "csv", "--out", "tables")
    with Path("tables/TRIAL.csv").open(newline="") as file:
        trials = [row["trial_in_log"] for row in csv.DictReader(file)]
    counts = [len(read_log(path).messages["TRIAL"]) for path in (recorded.first, recorded.second)]
    assert trials == ["0"] * counts[0] + ["1"] * counts[1]
    run("export", session, "--to", "csv", "--trial", 1, "--out", "one")
    run("export", recorded.second, "--to", "csv", "--out", "own")
    for path in Path("own").glob("*.csv"):
        one = (Path("one") / path.name).read_text().splitlines()
        own = path.read_text().splitlines()
        assert [line.partition(",")[2] for line in one] == [line.partition(",")[2] for line in own]


def test_silent_channel_of_a_trial_is_refused(session: Path) -> None:
    with pytest.raises(FieldError, match=r"has no HEARTBEAT; it has ROBOT, ACTUATOR_COMMAND"):
        read_series(session, [parse_selector("HEARTBEAT.pid")], 1)
