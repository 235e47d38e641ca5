"""Fields by name: a wrong one is refused with the nearest, and units are those of the .lcm files."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from recorded_trials import Recorded, write_events

from imolo.errors import FieldError
from imolo.inspect.definitions import definition_files, field_units
from imolo.inspect.fields import column_name, leaf_name, leaves, parse_selector, selected
from imolo.inspect.names import Names
from imolo.inspect.series import read_series, samples
from imolo.messaging import channels
from imolo.messaging.channels import STREAMS
from imolo.messaging.log import read_log
from imolo.messaging.log_file import LogEvent, read_events
from imolo_msgs import marker_t, mocap_frame_t, plan_t, truth_ball_t


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("TRUTH_BALL.true_ball_velocity[-1]", "m/s"),
        ("MOCAP.markers[0].marker_position[1]", "m"),
        ("PLAN.predicted_position[:][2]", "m"),
        ("PLAN.answered_frame", ""),
        ("BALL_STATE.covariance[0][0]", ""),
        ("ACTUATOR_STATE.measured[2]", "Pa"),
        ("ACTUATOR_COMMAND.target[0][1:3]", "Pa"),
        ("ACTUATOR_COMMAND.target", "Pa"),
        ("PLAN.theta[0]", ""),
        ("PLAN.theta[1]", "s"),
        ("PLAN.theta[-1]", "s"),
        ("PLAN.theta[1:]", "s"),
        ("PLAN.theta", ""),  # its two elements differ
        ("PLAN.theta[2]", ""),  # which this robot does not have
        ("TRUTH_ROBOT.joint_angle[0:3]", "rad"),
        ("TRUTH_ROBOT.joint_velocity[1]", "rad/s"),
    ],
)
def test_unit_is_that_of_the_comment_or_what_the_robot_says(recorded: Recorded, text: str, unit: str) -> None:
    assert read_series(recorded.first, [parse_selector(text)])[0].unit == unit


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("TRUTH_ROBT.joint_angle", "unknown channel 'TRUTH_ROBT'; did you mean 'TRUTH_ROBOT'?"),
        ("PLAN.thta", "PLAN has no field 'thta'; did you mean 'theta'?"),
        ("PLAN.target_position[3]", "index 3 is out of range; the array has 3 elements"),
        ("PLAN.state[0]", "there is no array to take [0] of"),
        ("PLAN.theta.k", ".k needs a message before it"),
        ("MOCAP.markers.marker_id", ".marker_id needs a message before it; give an index"),
        ("MOCAP.markers[0]", "names no field; fields: marker_id, marker_position"),
        ("MOCAP", "names no field; fields: utime"),
        ("TRIAL.event", "holds text, not numbers"),
        ("PLAN theta", "cannot read ' theta'"),
        ("PLAN.theta[1", "cannot read '[1'"),
        ("", "unknown channel ''"),
    ],
)
def test_wrong_field_is_refused_with_what_is_right(text: str, message: str) -> None:
    with pytest.raises(FieldError) as caught:
        parse_selector(text)
    assert message in str(caught.value)


def test_series_holds_what_the_messages_hold(recorded: Recorded) -> None:
    messages = read_log(recorded.first).messages["TRUTH_ROBOT"]
    (found,) = read_series(recorded.first, [parse_selector("TRUTH_ROBOT.joint_angle[1:3]")])
    assert found.time.tolist() == [message.utime * 1e-6 for message in messages]
    assert found.values.tolist() == [list(message.joint_angle[1:3]) for message in messages]
    assert found.labels == ("TRUTH_ROBOT.joint_angle[right_knee]", "TRUTH_ROBOT.joint_angle[right_ankle]")


def test_element_that_a_message_does_not_have_is_nan(recorded: Recorded) -> None:
    log = read_log(recorded.first)
    (found,) = read_series(recorded.first, [parse_selector("PLAN.predicted_position[0][2]")])
    for plan, value in zip(log.messages["PLAN"], found.values[:, 0], strict=True):
        assert np.isnan(value) if plan.num_predictions == 0 else value == plan.predicted_position[0][2]


def test_silent_channel_is_refused_with_those_that_speak(recorded: Recorded, tmp_path: Path) -> None:
    path = write_events(tmp_path / "log", [event for event in read_events(recorded.first) if event.channel != "PLAN"])
    with pytest.raises(FieldError, match=r"has no PLAN; it has ROBOT, ACTUATOR_COMMAND, ACTUATOR_STATE, MOCAP"):
        read_series(path, [parse_selector("PLAN.state")])


def test_leaf_has_a_name_for_tables_and_one_for_people() -> None:
    frame = mocap_frame_t()
    frame.markers = [marker_t(), marker_t()]
    path = [path for path, _ in leaves(frame)][-1]
    assert path == ("markers", 1, "marker_position", 2)
    assert column_name(path) == "markers_1_marker_position_2"
    assert leaf_name("MOCAP", path) == "markers[1].marker_position[2]"


def test_elements_have_the_names_that_the_robot_of_the_log_gives_them(recorded: Recorded) -> None:
    names = Names.of(recorded.first)
    assert leaf_name("ACTUATOR_STATE", ("measured", 1), names) == "measured[valve 2: extends right knee]"
    assert leaf_name("ACTUATOR_COMMAND", ("target", 0, 1), names) == "target[0][valve 2: extends right knee]"
    assert leaf_name("PLAN", ("theta", 1), names) == "theta[t_w]"
    assert leaf_name("TRUTH_ROBOT", ("effector_position", 0, 2), names) == "effector_position[right_hand][2]"
    assert leaf_name("PLAN", ("theta", 2), names) == "theta[2]"  # which this robot does not have


def test_log_without_a_robot_has_indices_for_names(recorded: Recorded, tmp_path: Path) -> None:
    events = [event for event in read_events(recorded.first) if event.channel != channels.ROBOT]
    (found,) = read_series(write_events(tmp_path / "log", events), [parse_selector("ACTUATOR_STATE.measured[1:2]")])
    assert (found.labels, found.unit) == (("ACTUATOR_STATE.measured[1]",), "")


def test_names_are_sought_no_longer_than_until_a_trial_goes_on(recorded: Recorded, tmp_path: Path) -> None:
    events = list(read_events(recorded.first))
    (robot,) = (event for event in events if event.channel == channels.ROBOT)
    start, *others = (event for event in events if event.channel == channels.TRIAL)
    for log, known in (([start, start, robot], True), ([robot, start], True), ([start, others[0], robot], False)):
        names = Names.of(write_events(tmp_path / "log", log))
        assert (names.robot is not None) is known


@pytest.mark.parametrize("index", [-3, 2])
def test_index_up_to_the_edge_of_an_array_is_taken(index: int) -> None:
    assert parse_selector(f"TRUTH_BALL.true_ball_position[{index}]").steps[-1] == index


@pytest.mark.parametrize("index", [-4, 3])
def test_index_past_the_edge_of_an_array_is_refused(index: int) -> None:
    with pytest.raises(FieldError, match=f"index {index} is out of range; the array has 3 elements"):
        parse_selector(f"TRUTH_BALL.true_ball_position[{index}]")


@pytest.mark.parametrize(
    ("slice_text", "elements"),
    [("[:]", [0, 1, 2]), ("[1:]", [1, 2]), ("[:2]", [0, 1]), ("[0:2]", [0, 1]), ("[-1:]", [2]), ("[-1]", [-1])],
)
def test_slice_selects_as_python_does(slice_text: str, elements: list[int]) -> None:
    selector = parse_selector(f"TRUTH_BALL.true_ball_position{slice_text}")
    message = truth_ball_t()
    message.true_ball_position = [10.0, 11.0, 12.0]
    found = list(selected(message, selector.steps))
    assert found == [(("true_ball_position", n), message.true_ball_position[n]) for n in elements]


def test_element_before_the_first_of_a_short_array_is_left_out() -> None:
    plan = plan_t()
    plan.num_predictions, plan.predicted_position = 1, [[1.0, 2.0, 3.0]]
    for index, expected in ((-2, []), (-1, [1.0]), (0, [1.0]), (1, [])):
        steps = parse_selector(f"PLAN.predicted_position[{index}][0]").steps
        assert [value for _, value in selected(plan, steps)] == expected


def test_long_series_keeps_its_outline_and_its_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One value of a thousand is a peak; a hundredth of the numbers are kept."""
    monkeypatch.setattr("imolo.inspect.series.NUMBERS", 200)
    count, peak = 5000, 3333
    events = []
    for number in range(count):
        truth = truth_ball_t()
        truth.utime = 1000 * number
        truth.true_ball_position = [7.0 if number == peak else 0.001 * number % 1.0, 0.0, 0.0]
        events.append(LogEvent(number, truth.utime, "TRUTH_BALL", truth.encode(), 0))
    path = write_events(tmp_path / "log", events)
    selector = parse_selector("TRUTH_BALL.true_ball_position[0]")
    (found,) = read_series(path, [selector])
    assert 20 <= len(found.time) <= 200
    # The largest of a few neighbours takes their last time.
    near = abs(found.time - 0.001 * peak) <= 0.001 * 4 * count / len(found.time)
    assert found.values[near].max() == 7.0
    assert (found.time[0], found.time[-1]) == (0.0, 0.001 * (count - 1))
    assert np.all(np.diff(found.time) >= 0.0)
    (sampled,) = read_series(path, [selector], thin=samples)
    for time, (value,) in zip(sampled.time, sampled.values, strict=True):
        number = round(1000 * time)
        assert value == (7.0 if number == peak else 0.001 * number % 1.0)


def test_every_time_has_its_unit() -> None:
    for channel in STREAMS.values():
        for name in channel.message_type.__slots__:
            if name.endswith("utime"):
                assert field_units()[channel.message_type.__name__, name] == "us"


def test_wheel_holds_every_definition() -> None:
    pyproject = Path(__file__).parents[2] / "pyproject.toml"
    wheel = tomllib.loads(pyproject.read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert set(wheel["force-include"]) == {f"lcmtypes/{path.name}" for path in definition_files()}
