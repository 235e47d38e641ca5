"""`imolo check --robot`: the robots that come along conform, and one that is wrong is told so in one line."""

from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from imolo.config.loading import config_for
from imolo.conformance import Verdict
from imolo.conformance.check import Outcome
from imolo.conformance.robot_suite import RobotSuite, robot_suites
from imolo.contracts.registry import ROBOTS
from imolo.contracts.urdf import Joint, JointType
from imolo.errors import ConfigError, ImoloError
from imolo.scaffold.files import write_files
from imolo_backends.actuators.motors import MotorsConfig

Wrong = Callable[[str, str], RobotSuite]

NUMBERS = count()


@pytest.fixture
def wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Wrong:
    """Return what makes the checks of a new robot, some text of its files replaced by another."""
    # Modules, distributions and configs are remembered by name.
    name = f"wrong_{next(NUMBERS)}"

    def make(text: str, other: str) -> RobotSuite:
        folder = tmp_path / name
        write_files("robot", name, folder)
        found = 0
        for path in (folder / name).iterdir():
            content = path.read_text(encoding="utf-8")
            found += content.count(text)
            path.write_text(content.replace(text, other), encoding="utf-8")
        assert found, text
        info = folder / f"{name}-0.1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n", encoding="utf-8")
        (info / "entry_points.txt").write_text(f"[imolo.robots]\n{name} = {name}.robot:ROBOT\n", encoding="utf-8")
        monkeypatch.syspath_prepend(folder)
        (suite,) = robot_suites(name, ["mujoco"])
        assert isinstance(suite, RobotSuite)
        return suite

    return make


def failures(suite: RobotSuite) -> list[Outcome]:
    return [one for name in suite.checks for one in suite.run(name) if one.verdict is not Verdict.PASS]


@pytest.mark.parametrize("robot", ROBOTS.names())
def test_robot_that_comes_along_conforms(robot: str) -> None:
    (suite,) = robot_suites(robot, ["mujoco"])
    assert len(suite.checks) >= 6
    assert failures(suite) == []


def test_new_robot_has_nothing_to_fail(wrong: Wrong) -> None:
    assert failures(wrong("20", "20")) == []


def test_frame_without_mass_is_part_of_the_link_that_carries_it(wrong: Wrong) -> None:
    tool = '<link name="tool"/><joint name="grip" type="fixed"><parent link="arm"/><child link="tool"/></joint></robot>'
    assert [one.verdict for one in wrong("</robot>", tool).run("masses")] == [Verdict.PASS] * 2


@pytest.mark.parametrize(
    ("text", "other", "parts"),
    [
        ('"shoulder", "arm")', '"shoulder", "amr")', ("marker 'shoulder'", "'amr'", "did you mean 'arm'")),
        ("fixed_base=True", 'fixed_base=True, joint_names=("elbow",)', ("joint 'elbow'", "known: shoulder")),
        ('<mass value="0.5"/>', '<mass value="0"/>', ("link 'arm' moves and has mass 0", "give it an <inertial>")),
        ("{target: [0.0]}", "{target: [0.0, 0.0]}", ("phase 2 has 1 targets, the first one 2",)),
    ],
    ids=["marker", "joint", "mass", "targets"],
)
def test_robot_that_cannot_be_is_refused_in_one_line(
    wrong: Wrong, text: str, other: str, parts: tuple[str, ...]
) -> None:
    with pytest.raises(ImoloError) as caught:
        _ = wrong(text, other).checks
    said = str(caught.value)
    assert "\n" not in said
    assert all(part in said for part in parts), said


def test_valve_that_feeds_nothing_is_refused_in_one_line() -> None:
    arm = config_for("mujoco", robot={"name": "pneumatic_arm"}).simulation.actuators.model_dump(mode="json")
    arm["cylinders"][1]["down"] = 3
    with pytest.raises(ConfigError, match="valve 4 feeds no chamber; name it in `up` or `down` of a cylinder"):
        config_for("mujoco", robot={"name": "pneumatic_arm"}, simulation={"actuators": arm})


def test_target_that_a_channel_cannot_have_is_told_with_its_range(wrong: Wrong) -> None:
    found = failures(wrong("{target: [2.4], until", "{target: [9.0], until"))
    assert {one.check for one in found} == {"motion"}
    for one in found:
        assert one.measurement is not None
        assert "9" in one.measurement.quantity
        assert "-0.5 to 2.6" in one.measurement.quantity.replace("..", " to ")
        assert "\n" not in one.measurement.quantity


def test_ready_pose_beyond_a_limit_is_told_with_its_joint(wrong: Wrong) -> None:
    found = failures(wrong("fixed_base=True", "fixed_base=True, ready=(3.0,)"))
    (beyond,) = (one.measurement for one in found if one.check == "ranges")
    assert beyond is not None
    assert beyond.measured == pytest.approx(3.0 - 2.6)
    assert "shoulder" in beyond.quantity
    (pose,) = (one.remark for one in found if one.check == "ready_pose")
    assert "shoulder cannot start at 171.887°; its range is -28.648° to 148.969°" in pose


def test_effector_without_a_shape_is_told(wrong: Wrong) -> None:
    found = failures(wrong("collision>", "visual>"))
    assert any("(plate)" in one.measurement.quantity for one in found if one.measurement is not None)


def joint(name: str, kind: JointType = "revolute") -> Joint:
    return Joint(name, kind, "base", "link", np.zeros(3), np.eye(3), np.array([1.0, 0.0, 0.0]), None)


def motors(*names: str, unit: str = "rad") -> MotorsConfig:
    motor: dict[str, object] = {
        "unit": unit,
        "stiffness": 1.0,
        "damping": 1.0,
        "torque_limit": 1.0,
        "speed_limit": 1.0,
        "low": -1.0,
        "high": 1.0,
    }
    return MotorsConfig.model_validate({"motors": [{"name": name, **motor} for name in names]})


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("shoulder", "ellbow"), "motor 'ellbow' stands where the joint is 'elbow'; did you mean 'elbow'"),
        (("elbow", "shoulder"), "motor 'elbow' stands where the joint is 'shoulder'"),
        (("shoulder",), "1 motors for 2 joints; give one for each of: shoulder, elbow"),
        (("A1", "ebow"), "did you mean 'elbow'"),
    ],
)
def test_motors_that_do_not_fit_the_joints_are_refused(names: tuple[str, ...], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        motors(*names).check_joints((joint("shoulder"), joint("elbow")))


def test_motors_may_bear_names_of_their_own() -> None:
    motors("A1", "A2").check_joints((joint("shoulder"), joint("elbow")))


def test_motor_of_a_joint_that_slides_moves_by_meters() -> None:
    with pytest.raises(ConfigError, match="motor 'lift': joint 'lift' slides; give it `unit: m`"):
        motors("lift").check_joints((joint("lift", "prismatic"),))
    motors("lift", unit="m").check_joints((joint("lift", "prismatic"),))
    with pytest.raises(ConfigError, match="motor 'turn': joint 'turn' turns; give it `unit: rad`"):
        motors("turn", unit="m").check_joints((joint("turn"),))


def test_two_motors_of_one_name_are_refused() -> None:
    with pytest.raises(ValueError, match="two motors are named 'elbow'"):
        motors("elbow", "elbow")


def test_motor_of_no_joint_ends_the_checks_in_one_line(wrong: Wrong) -> None:
    found = failures(wrong("name: shoulder", "name: shuolder"))
    assert found
    assert all("did you mean 'shoulder'" in one.remark for one in found if one.remark)
