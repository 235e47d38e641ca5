"""Fields by name: a wrong one is refused with the nearest, and units are those of the .lcm files."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from recorded_trials import Recorded

from imolo.errors import FieldError
from imolo.inspect.definitions import definition_files, field_units
from imolo.inspect.fields import columns, flatten, parse_selector, series
from imolo.messaging.channels import STREAMS
from imolo.messaging.log import read_log
from imolo_msgs import marker_t, mocap_frame_t


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("ACTUATOR_STATE.measured[2]", "Pa"),
        ("TRUTH_ROBOT.joint_angle[0:3]", "rad"),
        ("TRUTH_ROBOT.joint_velocity", "rad/s"),
        ("TRUTH_BALL.true_ball_velocity[-1]", "m/s"),
        ("MOCAP.markers[0].marker_position[1]", "m"),
        ("PLAN.theta[0]", "-"),
        ("PLAN.theta[1]", "s"),
        ("PLAN.theta", ""),  # its two elements differ
        ("PLAN.predicted_position[:][2]", "m"),
        ("PLAN.answered_frame", ""),
        ("BALL_STATE.covariance[0][0]", ""),
    ],
)
def test_unit_is_that_of_the_comment(text: str, unit: str) -> None:
    assert parse_selector(text).unit == unit


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("TRUTH_ROBT.joint_angle", "unknown channel 'TRUTH_ROBT'; did you mean 'TRUTH_ROBOT'?"),
        ("PLAN.thta", "PLAN has no field 'thta'; did you mean 'theta'?"),
        ("PLAN.theta[2]", "index 2 is out of range; the array has 2 elements"),
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
    log = read_log(recorded.first)
    messages = log.messages["TRUTH_ROBOT"]
    found = series(log, parse_selector("TRUTH_ROBOT.joint_angle[1:3]"))
    assert found.time.tolist() == [message.utime * 1e-6 for message in messages]
    assert found.values.tolist() == [list(message.joint_angle[1:3]) for message in messages]
    assert found.labels == ("TRUTH_ROBOT.joint_angle[1]", "TRUTH_ROBOT.joint_angle[2]")


def test_element_that_a_message_does_not_have_is_nan(recorded: Recorded) -> None:
    log = read_log(recorded.first)
    found = series(log, parse_selector("PLAN.predicted_position[0][2]"))
    for plan, value in zip(log.messages["PLAN"], found.values[:, 0], strict=True):
        assert np.isnan(value) if plan.num_predictions == 0 else value == plan.predicted_position[0][2]


def test_silent_channel_is_refused_with_those_that_speak(recorded: Recorded) -> None:
    log = read_log(recorded.first)
    log.messages["PLAN"] = []
    with pytest.raises(FieldError, match=r"has no PLAN; it has ROBOT, ACTUATOR_COMMAND, ACTUATOR_STATE, MOCAP"):
        series(log, parse_selector("PLAN.state"))


def test_columns_of_longer_messages_are_empty_for_shorter_ones() -> None:
    frames = []
    for count in (1, 2):
        frame = mocap_frame_t()
        frame.markers = [marker_t() for _ in range(count)]
        frame.num_markers = count
        frames.append(frame)
    table = columns(frames)
    assert table["markers_0_marker_id"] == [0, 0]
    assert table["markers_1_marker_position_2"] == [None, 0.0]
    assert list(table) == [name for name, _ in flatten(frames[1])]


def test_every_time_has_its_unit() -> None:
    for channel in STREAMS.values():
        for name in channel.message_type.__slots__:
            if name.endswith("utime"):
                assert field_units()[channel.message_type.__name__, name] == ("us",)


def test_wheel_holds_every_definition() -> None:
    pyproject = Path(__file__).parents[2] / "pyproject.toml"
    wheel = tomllib.loads(pyproject.read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert set(wheel["force-include"]) == {f"lcmtypes/{path.name}" for path in definition_files()}
