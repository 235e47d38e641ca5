"""Two runs: where they part, and whether a planner says again what it said."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from command_line import Run
from recorded_trials import METHOD, Recorded, write_events

from imolo.inspect.diff import _compare_values, _Parting, compare_logs, compare_runs
from imolo.inspect.divergence import FLOOR, PANELS, difference_over_time, draw_divergence
from imolo.inspect.fields import parse_selector
from imolo.inspect.plot import short_names
from imolo.inspect.series import Series, read_series
from imolo.messaging import channels
from imolo.messaging.channels import STREAMS
from imolo.messaging.log_file import LogEvent, read_events
from imolo_msgs import actuator_state_t, marker_t, mocap_frame_t, robot_t, trial_event_t, truth_ball_t


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
    assert "the runs are the same: they are identical, byte by byte" in output


def test_figure_of_identical_runs_says_so(recorded: Recorded, run: Run) -> None:
    code, output, errors = run("diff", recorded.first, recorded.first, "--out", "same.png")
    assert (code, errors, "the figure is same.png" in output) == (0, "", True)
    figure = draw_divergence(recorded.first, recorded.first, None)
    assert "they are identical" in figure.get_suptitle()
    for axes in figure.axes:
        assert axes.get_yscale() == "linear"
        assert not any(line.get_ydata().any() for line in axes.lines)


def test_infinite_difference_is_the_largest_and_nan_is_itself() -> None:
    message, other = actuator_state_t(), actuator_state_t()
    message.num_measured = other.num_measured = 8
    message.measured = [float("nan"), 1.0, 2.0, *[0.0] * 5]
    other.measured = [float("nan"), 1.5, 2.0, *[0.0] * 4, float("inf")]
    one, two = (LogEvent(0, 7, "ACTUATOR_STATE", each.encode(), 0) for each in (message, other))
    (channel,) = compare_runs([one], [two]).channels
    assert channel.first is not None
    assert (channel.first.field, channel.first.values) == ("measured[1]", (1.0, 1.5))
    assert (channel.largest, channel.largest_field) == (float("inf"), "measured[7]")


def test_messages_with_other_bytes_and_the_same_numbers_differ() -> None:
    zero, other = actuator_state_t(), actuator_state_t()
    zero.num_measured = other.num_measured = 8
    zero.measured, other.measured = [0.0] * 8, [-0.0] * 8
    for one, two in ((zero.encode(), other.encode()), (zero.encode(), zero.encode() + b"x")):
        (channel,) = compare_runs(*([LogEvent(0, 7, "ACTUATOR_STATE", data, 0)] for data in (one, two))).channels
        assert channel.equal == 0
        assert channel.first is not None
        assert (channel.first.field, channel.first.values) == ("bytes", (one.hex(), two.hex()))


def test_same_recording_has_the_same_order_and_times() -> None:
    first = [LogEvent(0, 7, "MOCAP", b"a", 0), LogEvent(1, 8, "PLAN", b"b", 0), LogEvent(2, 9, "HERS", b"", 0)]
    later = [*first[:2], first[2]._replace(utime=10)]
    swapped = [first[0], first[2]._replace(utime=8), first[1]._replace(utime=9)]
    for second, same in ((first, True), (later, False), (swapped, False)):
        found = compare_runs(first, second)
        assert (found.first, found.same_recording) == (None, same)
        assert [channel.counts for channel in found.channels] == [(1, 1)] * 3
    shorter = compare_runs(first, first[:2])
    assert not shorter.same_recording
    assert [channel.counts for channel in shorter.channels] == [(1, 1), (1, 1), (1, 0)]


def test_element_that_only_one_message_has_is_named() -> None:
    frame, more = mocap_frame_t(), mocap_frame_t()
    more.markers = [marker_t()]
    more.num_markers = 0
    one = frame.encode()
    more.num_markers = 1
    found = compare_runs([LogEvent(0, 7, "MOCAP", one, 0)], [LogEvent(0, 7, "MOCAP", more.encode(), 0)]).first
    assert found is not None
    assert (found.field, found.values) == ("num_markers", (0, 1))


def test_array_that_is_longer_in_one_message_has_its_first_new_element_named() -> None:
    short, long = [[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    for one, other, values in ((short, long, (None, 4.0)), (long, short, (4.0, None))):
        parting = _Parting()
        _compare_values(one, other, ("predicted_position",), parting)
        assert parting.first == (("predicted_position", 1, 0), *values)


def test_long_messages_of_others_are_compared_and_shown_where_they_part(tmp_path: Path) -> None:
    paths = []
    for name, byte in (("a", b"\x01"), ("b", b"\x02")):
        image = bytes(300_000) + byte + bytes(1000)
        paths.append(write_events(tmp_path / name, [LogEvent(0, 7, "CAMERA", image, 0)]))
    assert compare_logs(paths[0], paths[0]).first is None
    found = str(compare_logs(*paths).first)
    assert found.startswith("CAMERA message 0 at 0.000007 s, bytes from 300000: '01")
    assert len(found) < 200


@pytest.mark.parametrize(
    ("channel", "field", "element", "name"),
    [
        ("TRUTH_ROBOT", "joint_angle", 3, "left_hip"),
        ("ACTUATOR_STATE", "measured", 7, "valve 8: lowers arms, bends legs"),
        ("PLAN", "target_position", 1, "1"),
    ],
)
def test_diff_names_the_message_field_and_time_that_were_changed(
    recorded: Recorded, tmp_path: Path, run: Run, channel: str, field: str, element: int, name: str
) -> None:
    events = list(read_events(recorded.first))
    own = [event for event in events if event.channel == channel]
    other = write_events(tmp_path / "other.lcmlog", changed(events, channel, 40, field, element, 0.25))
    result = compare_logs(recorded.first, other)
    assert result.first is not None
    assert (result.first.channel, result.first.index, result.first.field) == (channel, 40, f"{field}[{name}]")
    assert result.first.utime == own[40].utime
    (compared,) = (each for each in result.channels if each.channel == channel)
    assert (compared.equal, compared.largest_field) == (len(own) - 1, f"{field}[{name}]")
    # The sum is rounded to the spacing of doubles near the pressure.
    assert compared.largest == pytest.approx(0.25, abs=1e-9)
    code, output, _ = run("diff", recorded.first, other)
    assert code == 1
    assert f"they part at {channel} message 40 at {own[40].utime * 1e-6:.6f} s, {field}[{name}]: " in " ".join(
        output.split()
    )


def test_runs_of_two_backends_part_where_more_than_their_names_differs(recorded: Recorded) -> None:
    events = list(read_events(recorded.first))

    def of_dart(event: LogEvent) -> LogEvent:
        if event.channel != channels.TRIAL:
            return event
        message = trial_event_t.decode(event.data)
        message.backend = "dart"
        return event._replace(data=message.encode())

    other = [of_dart(event) for event in events]
    named = compare_runs(events, other).first
    assert named is not None
    assert (named.channel, named.index, named.field, named.values) == (channels.TRIAL, 0, "backend", ("mujoco", "dart"))
    for channel, index, field in ((channels.TRIAL, 2, "event_position"), ("TRUTH_ROBOT", 40, "joint_angle")):
        found = compare_runs(events, changed(other, channel, index, field, 1, 0.25)).first
        assert found is not None
        assert (found.channel, found.index, found.field.partition("[")[0]) == (channel, index, field)
    last = max(number for number, event in enumerate(other) if event.channel == channels.TRIAL)
    shorter = compare_runs(events, other[:last] + other[last + 1 :]).first
    assert shorter is not None
    assert (shorter.channel, shorter.field) == (channels.TRIAL, "")


def test_message_that_only_one_run_has_is_named(recorded: Recorded, tmp_path: Path) -> None:
    events = list(read_events(recorded.first))
    frames = [event for event in events if event.channel == channels.MOCAP]
    shorter = [event for event in events if event is not frames[-1]]
    for runs, which in (((events, shorter), "first"), ((shorter, events), "second")):
        found = compare_runs(*runs).first
        assert str(found) == (
            f"MOCAP message {len(frames) - 1} at {frames[-1].utime * 1e-6:.6f} s is in the {which} run only"
        )


def test_other_order_of_the_same_messages_is_told(recorded: Recorded, tmp_path: Path, run: Run) -> None:
    events = list(read_events(recorded.first))
    ordered = sorted(events, key=lambda event: event.channel)
    code, output, _ = run("diff", recorded.first, write_events(tmp_path / "other.lcmlog", ordered))
    assert code == 1
    assert "the messages are the same, but not their order" in output


def test_channels_of_others_are_compared_by_their_bytes() -> None:
    one, other = (LogEvent(0, 7, "CAMERA", data, 0) for data in (b"\x01", b"\x02"))
    found = compare_runs([one], [other]).first
    assert str(found) == "CAMERA message 0 at 0.000007 s, bytes: '01' and '02'"


def test_difference_over_time_is_zero_until_the_runs_part(recorded: Recorded) -> None:
    selector = parse_selector("TRUTH_ROBOT.joint_angle")
    (first,), (second,) = (read_series(path, [selector]) for path in (recorded.first, recorded.second))
    gap = difference_over_time(first, second)
    assert gap is not None
    assert gap.values.shape == (len(gap.time), 8)
    same = difference_over_time(first, first)
    assert same is not None
    assert not same.values.any()
    # The robot starts from another pose, since the disturbance is another one.
    assert np.abs(gap.values[0]).max() > 0.0


def line(time: list[float], values: list[float], label: str = "x") -> Series:
    return Series(np.array(time), np.array(values).reshape(-1, 1), (label,))


def test_difference_is_second_minus_first_over_the_time_of_both() -> None:
    gap = difference_over_time(line([0.0, 1.0, 2.0, 3.0], [5.0, 5.0, 5.0, 5.0]), line([1.0, 3.0], [10.0, 20.0]))
    assert gap is not None
    assert (gap.time.tolist(), gap.values[:, 0].tolist()) == ([1.0, 2.0, 3.0], [5.0, 10.0, 15.0])


def test_runs_without_a_common_time_or_element_have_no_difference() -> None:
    one = line([0.0, 1.0], [0.0, 0.0])
    assert difference_over_time(one, line([1.5, 2.0], [0.0, 0.0])) is None
    assert difference_over_time(one, line([0.0, 1.0], [0.0, 0.0], "y")) is None
    assert difference_over_time(one, Series(np.zeros(0), np.zeros((0, 0)), ())) is None


@pytest.mark.parametrize(
    ("gap", "scale"),
    [(0.0, "linear"), (1e-9, "linear"), ([0.1, 0.5], "linear"), ([0.1, 0.9], "linear"), ([0.1, 1.1], "log")],
)
def test_axes_are_linear_where_a_logarithm_says_nothing(
    recorded: Recorded, tmp_path: Path, gap: float | list[float], scale: str
) -> None:
    """The ball of one run is moved by `gap` [mm]: not at all, below what is drawn, within a decade, over more."""
    events = []
    ball = [event for event in read_events(recorded.first) if event.channel == "TRUTH_BALL"]
    for number, event in enumerate(ball):
        message = truth_ball_t.decode(event.data)
        low, high = gap if isinstance(gap, list) else (gap, gap)
        moved = high if number == len(ball) - 1 else low
        x, y, z = message.true_ball_position
        message.true_ball_position = [x, y, z + 1e-3 * moved]
        events.append(event._replace(data=message.encode()))
    one, other = write_events(tmp_path / "a", ball), write_events(tmp_path / "b", events)
    axes = draw_divergence(one, other, None).axes[2]
    assert axes.get_yscale() == scale
    assert not len(axes.texts)
    drawn = axes.lines[0].get_ydata()
    assert np.isfinite(drawn).all()


def test_divergence_is_drawn_for_joints_hand_ball_and_pressures(recorded: Recorded, run: Run) -> None:
    code, output, _ = run("diff", recorded.first, recorded.second, "--out", "parting.png")
    assert code == 1
    assert "the figure is parting.png" in output
    assert plt.imread("parting.png").std() > 0.0
    comparison = compare_logs(recorded.first, recorded.second)
    figure = draw_divergence(recorded.first, recorded.second, comparison.first)
    first, second = short_names([recorded.first, recorded.second])
    assert figure.get_suptitle() == f"{second} less {first}\nthey part at {comparison.first}"
    assert [axes.get_title("left") for axes in figure.axes] == ["joint angles", "right hand", "ball", "pressures"]
    assert all(len(axes.lines) >= 2 for axes in figure.axes)
    # The angles go apart for good; the pressures differ while a valve switches, and no more after it.
    assert [figure.axes[number].get_yscale() for number in (0, 3)] == ["log", "linear"]
    assert figure.axes[0].get_ylabel() == "difference [°]"
    drawn = [value for line in figure.axes[0].lines[:8] for value in line.get_ydata() if np.isfinite(value)]
    assert min(drawn) >= FLOOR
    names = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert (len(names), names[0]) == (8, "right hip")
    assert [line.get_linestyle() for line in figure.axes[0].lines[:8]] == ["-", "--"] * 4


def test_each_unit_of_joints_and_channels_has_axes_of_its_own(recorded: Recorded, tmp_path: Path) -> None:
    """As if the first joint slid, and the first channel were a motor's."""
    logs = []
    for path in (recorded.first, recorded.second):
        events = list(read_events(path))
        (robot,) = (number for number, event in enumerate(events) if event.channel == channels.ROBOT)
        message = robot_t.decode(events[robot].data)
        message.joint_unit, message.channel_unit = ["m", *message.joint_unit[1:]], ["N·m", *message.channel_unit[1:]]
        events[robot] = events[robot]._replace(data=message.encode())
        logs.append(write_events(tmp_path / path.name, events))
    figure = draw_divergence(logs[0], logs[1], None)
    assert [(axes.get_title("left"), axes.get_ylabel()) for axes in figure.axes] == [
        ("ways of joints", "difference [mm]"),
        ("joint angles", "difference [°]"),
        ("right hand", "difference [mm]"),
        ("ball", "difference [mm]"),
        ("actuators", "difference [N·m]"),
        ("pressures", "difference [kPa]"),
    ]
    (first,), (second,) = (read_series(path, [parse_selector(PANELS[0].field)]) for path in logs)
    gap = difference_over_time(first, second)
    assert gap is not None
    for axes, column, factor in ((figure.axes[0], 0, 1e3), (figure.axes[1], 1, np.degrees(1.0))):
        drawn = axes.lines[0].get_ydata()
        assert np.abs(drawn[-1]) == pytest.approx(factor * np.abs(gap.values[-1, column]))


def test_replayed_planner_says_the_same_to_the_byte(recorded: Recorded, run: Run) -> None:
    code, output, errors = run("replay", recorded.first, "--table", recorded.table, "--method", METHOD)
    assert (code, errors) == (0, "")
    said = [e for e in list(read_events(recorded.first)) if e.channel in ("PLAN", "BALL_STATE", "ACTUATOR_COMMAND")]
    assert f"the planner says the same: {len(said)} messages, byte by byte" in output


def test_planner_of_another_method_parts_from_the_log(recorded: Recorded, run: Run) -> None:
    # It watches the ball for longer before it starts.
    code, output, _ = run("replay", recorded.first, "--table", recorded.table, "--method", "improved")
    assert code == 1
    assert "the planner parts from the log: " in output


def test_changed_frame_changes_what_the_planner_says_next(recorded: Recorded, tmp_path: Path, run: Run) -> None:
    events = list(read_events(recorded.first))
    frames = [event for event in events if event.channel == channels.MOCAP]
    kept = [event for event in events if event is not frames[60]]
    code, output, _ = run("replay", write_events(tmp_path / "log", kept), "--table", recorded.table, "--method", METHOD)
    assert code == 1
    assert f"at {frames[60].utime * 1e-6:.6f} s" in output


def test_replay_is_of_the_start_whatever_was_told_before(recorded: Recorded, tmp_path: Path, run: Run) -> None:
    events = list(read_events(recorded.first))
    other = trial_event_t()
    other.event = "touch"
    early = LogEvent(0, 0, channels.TRIAL, other.encode(), 0)
    path = write_events(tmp_path / "log", [early, *events])
    code, output, errors = run("replay", path, "--table", recorded.table, "--method", METHOD)
    assert (code, errors) == (0, "")
    assert "the planner says the same" in output


def test_replay_refuses_an_unknown_method_and_a_log_without_a_start(
    recorded: Recorded, tmp_path: Path, run: Run
) -> None:
    code, _, errors = run("replay", recorded.first, "--table", recorded.table, "--method", "papr")
    assert (code, "did you mean 'paper'?" in errors) == (2, True)
    events = [event for event in list(read_events(recorded.first)) if event.channel != channels.TRIAL]
    code, _, errors = run("replay", write_events(tmp_path / "log", events), "--table", recorded.table)
    assert (code, "holds no start of a trial" in errors) == (2, True)
