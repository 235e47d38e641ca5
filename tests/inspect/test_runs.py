"""Two runs: where they part, and whether a planner says again what it said."""

from pathlib import Path

import lcm
import matplotlib.pyplot as plt
import numpy as np
import pytest
from command_line import Run
from recorded_trials import METHOD, Recorded

from imolo.inspect.diff import compare_logs, compare_runs
from imolo.inspect.divergence import difference_over_time, draw_divergence
from imolo.messaging import channels
from imolo.messaging.channels import STREAMS
from imolo.messaging.log import read_log
from imolo.messaging.log_file import LogEvent, read_events


def rewrite(path: Path, events: list[LogEvent]) -> Path:
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for event in events:
        log.write_event(event.utime, event.channel, event.data)
    log.close()
    return path


def changed(events: list[LogEvent], channel: str, index: int, field: str, element: int, by: float) -> list[LogEvent]:
    """Return the events with one element of one message moved."""
    position = [n for n, event in enumerate(events) if event.channel == channel][index]
    message = STREAMS[channel].message_type.decode(events[position].data)
    values = list(getattr(message, field))
    values[element] += by
    setattr(message, field, values)
    return [*events[:position], events[position]._replace(data=message.encode()), *events[position + 1 :]]


def test_run_is_the_same_as_itself(recorded: Recorded, run: Run) -> None:
    code, output, errors = run("diff", recorded.first, recorded.first)
    assert (code, errors) == (0, "")
    assert "the runs are the same" in output


@pytest.mark.parametrize(
    ("channel", "field", "element"),
    [("TRUTH_ROBOT", "joint_angle", 3), ("ACTUATOR_STATE", "measured", 7), ("PLAN", "target_position", 1)],
)
def test_diff_names_the_message_field_and_time_that_were_changed(
    recorded: Recorded, tmp_path: Path, run: Run, channel: str, field: str, element: int
) -> None:
    events = read_events(recorded.first)[0]
    own = [event for event in events if event.channel == channel]
    other = rewrite(tmp_path / "other.lcmlog", changed(events, channel, 40, field, element, 0.25))
    result = compare_logs(recorded.first, other)
    assert result.first is not None
    assert (result.first.channel, result.first.index, result.first.field) == (channel, 40, f"{field}_{element}")
    assert result.first.utime == own[40].utime
    (compared,) = (each for each in result.channels if each.channel == channel)
    assert (compared.equal, compared.largest_field) == (len(own) - 1, f"{field}_{element}")
    # The sum is rounded to the spacing of doubles near the pressure.
    assert compared.largest == pytest.approx(0.25, abs=1e-9)
    code, output, _ = run("diff", recorded.first, other)
    assert code == 1
    assert f"they part at {channel} message 40 at {own[40].utime * 1e-6:.6f} s, {field}_{element}: " in output


def test_message_that_only_one_run_has_is_named(recorded: Recorded, tmp_path: Path) -> None:
    events = read_events(recorded.first)[0]
    frames = [event for event in events if event.channel == channels.MOCAP]
    shorter = [event for event in events if event is not frames[-1]]
    for runs, which in (((events, shorter), "first"), ((shorter, events), "second")):
        found = compare_runs(*runs).first
        assert str(found) == (
            f"MOCAP message {len(frames) - 1} at {frames[-1].utime * 1e-6:.6f} s is in the {which} run only"
        )


def test_other_order_of_the_same_messages_is_told(recorded: Recorded, tmp_path: Path, run: Run) -> None:
    events = read_events(recorded.first)[0]
    ordered = sorted(events, key=lambda event: event.channel)
    code, output, _ = run("diff", recorded.first, rewrite(tmp_path / "other.lcmlog", ordered))
    assert code == 1
    assert "the messages are the same, but not their order" in output


def test_channels_of_others_are_compared_by_their_bytes() -> None:
    one, other = (LogEvent(0, 7, "CAMERA", data, 0) for data in (b"\x01", b"\x02"))
    found = compare_runs([one], [other]).first
    assert str(found) == "CAMERA message 0 at 0.000007 s, bytes: '01' and '02'"


def test_difference_over_time_is_zero_until_the_runs_part(recorded: Recorded) -> None:
    first, second = read_log(recorded.first), read_log(recorded.second)
    gap = difference_over_time(first, second, "TRUTH_ROBOT.joint_angle")
    assert gap is not None
    time, values = gap
    assert values.shape == (len(time), 8)
    same = difference_over_time(first, first, "TRUTH_ROBOT.joint_angle")
    assert same is not None
    assert not same[1].any()
    # The robot starts from another pose, since the disturbance is another one.
    assert np.abs(values[0]).max() > 0.0


def test_divergence_is_drawn_for_joints_hand_ball_and_pressures(recorded: Recorded, run: Run) -> None:
    code, output, _ = run("diff", recorded.first, recorded.second, "--out", "parting.png")
    assert code == 1
    assert "the figure is parting.png" in output
    assert plt.imread("parting.png").std() > 0.0
    comparison = compare_logs(recorded.first, recorded.second)
    figure = draw_divergence(read_log(recorded.first), read_log(recorded.second), comparison.first)
    assert [axes.get_title("left") for axes in figure.axes] == ["joint angles", "right hand", "ball", "pressures"]
    assert all(len(axes.lines) >= 2 for axes in figure.axes)


def test_replayed_planner_says_the_same_to_the_byte(recorded: Recorded, run: Run) -> None:
    code, output, errors = run("replay", recorded.first, "--table", recorded.table, "--method", METHOD)
    assert (code, errors) == (0, "")
    said = [e for e in read_events(recorded.first)[0] if e.channel in ("PLAN", "BALL_STATE", "ACTUATOR_COMMAND")]
    assert f"the planner says the same: {len(said)} messages, byte by byte" in output


def test_planner_of_another_method_parts_from_the_log(recorded: Recorded, run: Run) -> None:
    # It watches the ball for longer before it starts.
    code, output, _ = run("replay", recorded.first, "--table", recorded.table, "--method", "improved")
    assert code == 1
    assert "the planner parts from the log: " in output


def test_changed_frame_changes_what_the_planner_says_next(recorded: Recorded, tmp_path: Path, run: Run) -> None:
    events = read_events(recorded.first)[0]
    frames = [event for event in events if event.channel == channels.MOCAP]
    kept = [event for event in events if event is not frames[60]]
    code, output, _ = run("replay", rewrite(tmp_path / "log", kept), "--table", recorded.table, "--method", METHOD)
    assert code == 1
    assert f"at {frames[60].utime * 1e-6:.6f} s" in output


def test_replay_refuses_an_unknown_method_and_a_log_without_a_start(
    recorded: Recorded, tmp_path: Path, run: Run
) -> None:
    code, _, errors = run("replay", recorded.first, "--table", recorded.table, "--method", "papr")
    assert (code, "did you mean 'paper'?" in errors) == (2, True)
    events = [event for event in read_events(recorded.first)[0] if event.channel != channels.TRIAL]
    code, _, errors = run("replay", rewrite(tmp_path / "log", events), "--table", recorded.table)
    assert (code, "holds no start of a trial" in errors) == (2, True)
