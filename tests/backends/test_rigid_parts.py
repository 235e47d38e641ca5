"""Links that fixed joints hold together are one body with the same mass, inertia and joints."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imolo.contracts.urdf import RobotModel, read_urdf
from imolo_backends.engines.rigid_parts import find_places, merge_fixed
from imolo_robots.liberobot.body import URDF

MASS, SIDES = 2.0, np.array([0.3, 0.2, 0.1])


def box_inertia(mass: float, sides: np.ndarray) -> np.ndarray:
    return mass / 12.0 * np.diag(np.sum(sides**2) - sides**2)


def halves(tmp_path: Path) -> RobotModel:
    """Return a box sawn in two across x; the second half is turned and hangs on the first, and carries a joint."""
    xx, yy, zz = np.diag(box_inertia(0.5 * MASS, SIDES * [0.5, 1.0, 1.0]))
    link = (
        '<link name="{name}"><inertial><origin xyz="{com}"/><mass value="1"/>'
        f'<inertia ixx="{{x}}" iyy="{{y}}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    path = tmp_path / "halves.urdf"
    path.write_text(
        '<robot name="halves">'
        + link.format(name="rear", com="-0.075 0 0", x=xx, y=yy)
        # Its frame is turned by 90° about z: what is x for the box is -y for this half.
        + link.format(name="front", com="0 -0.075 0", x=yy, y=xx)
        + link.format(name="arm", com="0 0 0", x=xx, y=yy)
        + '<joint name="turn" type="continuous"><parent link="front"/><child link="arm"/><origin xyz="0 -0.15 0"/>'
        '<axis xyz="1 0 0"/></joint>'
        '<joint name="weld" type="fixed"><parent link="rear"/><child link="front"/>'
        f'<origin xyz="0 0 0" rpy="0 0 {np.pi / 2}"/></joint></robot>'
    )
    return read_urdf(path)


def test_two_halves_of_a_box_are_the_box(tmp_path: Path) -> None:
    merged = merge_fixed(halves(tmp_path))
    assert list(merged.links) == ["rear", "arm"]
    whole = merged.links["rear"]
    assert whole.mass == pytest.approx(MASS)
    assert whole.com == pytest.approx(np.zeros(3), abs=1e-15)
    assert whole.inertia == pytest.approx(box_inertia(MASS, SIDES), abs=1e-15)


def test_a_joint_on_a_welded_link_stays_where_it_was(tmp_path: Path) -> None:
    robot = halves(tmp_path)
    merged, places = merge_fixed(robot), find_places(robot)
    assert set(merged.joints) == {"turn"}
    angle, base = {"turn": 0.7}, (np.array([0.1, 0.2, 0.3]), Rotation.from_euler("xyz", [0.4, -0.3, 0.8]).as_matrix())
    before, after = robot.link_poses(angle, *base), merged.link_poses(angle, *base)
    for name, (position, rotation) in before.items():
        part_position, part_rotation = after[places[name].part]
        assert part_position + part_rotation @ places[name].position == pytest.approx(position)
        assert part_rotation @ places[name].rotation == pytest.approx(rotation)


def test_a_robot_without_fixed_joints_keeps_all_but_its_shapes() -> None:
    robot = read_urdf(URDF)
    merged = merge_fixed(robot)
    assert set(merged.joints) == set(robot.joints)
    for name, link in robot.links.items():
        one, other = vars(merged.links[name]), vars(replace(link, collisions=()))
        assert all(np.array_equal(one[key], other[key]) for key in ("mass", "com", "collisions"))
        assert one["inertia"] == pytest.approx(link.inertia, rel=1e-15)
