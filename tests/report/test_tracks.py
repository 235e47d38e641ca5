"""Motion in a page: thinned, quantised, and taken from the markers where there is no truth."""

from copy import copy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from results_folder import END, write_log

from imolo.config.loading import body_of, config_for
from imolo.contracts.urdf import read_urdf
from imolo.errors import ResultsError
from imolo.messaging.log import read_log
from imolo.report.robot_shapes import robot_shapes
from imolo.report.tracks import PATH_STEP, RATE, STEPS, pack, trial_tracks, unpack

ROBOT = body_of(config_for("mujoco").robot)

# Below this a step of the largest number over 32767 is no normal number any more.
NUMBERS = st.floats(-1e3, 1e3).filter(lambda value: value == 0.0 or abs(value) > 1e-290)


@given(st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), max_size=20))
def test_packed_numbers_are_right_to_half_a_step(rows: list[tuple[float, float, float]]) -> None:
    values = np.array(rows, dtype=float).reshape(-1, 3)
    largest = np.abs(values).max(initial=0.0)
    back = unpack(pack(values))
    assert back.shape == values.shape
    # Half a step, and the rounding of a division and a product.
    assert np.all(np.abs(back - values) <= (0.5 / STEPS + 4e-16) * largest)


def test_poses_are_thinned_but_reach_from_the_first_to_the_last(tmp_path: Path) -> None:
    write_log(tmp_path / "trial.lcmlog", 0)
    tracks = trial_tracks(read_log(tmp_path / "trial.lcmlog"), ROBOT)
    time = unpack(tracks["robot"]["time"])
    step = tracks["robot"]["time"]["step"]
    assert abs(time[0]) <= step
    assert abs(time[-1] - END * 1e-6) <= step
    assert np.all(np.diff(time)[:-1] >= 1.0 / RATE - 1e-4 - step)
    height = unpack(tracks["robot"]["position"])[:, 2]
    # The trunk rises at 1 m/s, so its height is the time.
    assert np.all(np.abs(height - time) <= 0.5 * (step + tracks["robot"]["position"]["step"]) + 1e-12)


def test_predicted_path_ends_at_the_floor(tmp_path: Path) -> None:
    write_log(tmp_path / "trial.lcmlog", 0)
    plans = trial_tracks(read_log(tmp_path / "trial.lcmlog"), ROBOT)["plans"]
    path = unpack(plans["path"])
    every = round(PATH_STEP / 0.01)
    above = [1.5 - 0.02 * i for i in range(90) if 1.5 - 0.02 * i >= -1e-9]
    assert plans["count"] == [len(path)] == [len(above[::every])]
    assert path[:, 2].min() >= -plans["path"]["step"]


def test_log_without_truth_shows_its_markers(tmp_path: Path) -> None:
    write_log(tmp_path / "trial.lcmlog", 0, truth=False)
    tracks = trial_tracks(read_log(tmp_path / "trial.lcmlog"), ROBOT)
    assert "robot" not in tracks
    time = unpack(tracks["markers"]["time"])
    assert tracks["markers"]["count"] == [2] * len(time)  # the ball is no marker of the robot
    position = unpack(tracks["markers"]["position"])
    assert np.all(np.abs(position[::2, 2] - time) <= tracks["markers"]["position"]["step"])
    hand = unpack(tracks["hand"]["position"])
    assert np.all(np.abs(hand[:, 2] - unpack(tracks["hand"]["time"])) <= tracks["hand"]["position"]["step"])


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize(("effector", "y"), [(0, -0.16), (1, 0.16)])
def test_hand_is_the_one_that_was_to_hit(tmp_path: Path, truth: bool, effector: int, y: float) -> None:
    write_log(tmp_path / "trial.lcmlog", 0, truth=truth, effector=effector)
    hand = trial_tracks(read_log(tmp_path / "trial.lcmlog"), ROBOT)["hand"]["position"]
    assert np.all(np.abs(unpack(hand)[:, 1] - y) <= hand["step"])


def test_shapes_are_those_of_the_urdf_with_parents_first() -> None:
    links = robot_shapes(ROBOT)["links"]
    model = read_urdf(ROBOT.urdf)
    assert len(links) == len(model.links)
    assert all(link["parent"] < number for number, link in enumerate(links))
    joints = {link["angle"]: link for link in links[1:]}
    for number, name in enumerate(ROBOT.joint_names):
        joint = model.joints[name]
        assert joints[number]["at"] == joint.position.tolist()
        assert joints[number]["axis"] == joint.axis.tolist()
    assert sum(len(link["shapes"]) for link in links) == ROBOT.urdf.read_text().count("<visual>")


def test_broken_urdf_is_named(tmp_path: Path) -> None:
    robot = copy(ROBOT)
    object.__setattr__(robot, "urdf", tmp_path / "robot.urdf")  # which was whole when the body was made of it
    robot.urdf.write_text("<robot>")
    with pytest.raises(ResultsError, match=r"robot\.urdf"):
        robot_shapes(robot)


def test_a_plan_for_no_effector_of_the_robot_shows_the_first_one(tmp_path: Path) -> None:
    write_log(tmp_path / "trial.lcmlog", 0)
    log = read_log(tmp_path / "trial.lcmlog")
    shown = []
    for effector in (0, -1, 7):
        for plan in log.messages["PLAN"]:
            plan.effector = effector
        shown.append(trial_tracks(log, ROBOT)["hand"])
    assert log.messages["PLAN"]
    assert shown[0] == shown[1] == shown[2]
