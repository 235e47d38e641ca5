"""Robots whose URDF nobody here made, as they come in PyBullet's wheel: with meshes, fixed and sliding joints."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ENGINES
from requirements import AVAILABLE, needs
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from imolo.contracts.engine import Ball, Engine, EngineState, Scene
from imolo.contracts.urdf import read_urdf
from imolo.errors import BackendError
from imolo_backends.engines.plain_urdf import NO_MASS, fill_masses, plain_urdf

DT = 1e-4
NO_GRAVITY = (0.0, 0.0, 0.0)
WITH_MESHES = tuple(name for name in AVAILABLE if name != "ode")
FAR_BALL = Ball(0.045, 0.01, 8.1e-6, (5.0, 0.0, 20.0))
KUKA, PANDA, XARM = "kuka_iiwa/model.urdf", "franka_panda/panda.urdf", "xarm/xarm6_robot.urdf"
# Off the limits, where they stay for .3 s (the Panda's fingers for .1 s): a stop is the engine's own affair.
POSE = {
    KUKA: (0.3, 0.5, -0.2, -1.2, 0.4, 0.8, 0.1),
    PANDA: (0.3, 0.5, -0.2, -1.2, 0.4, 1.8, 0.1, 0.02, 0.02),
    XARM: (0.3, 0.5, -1.5, 0.2, 0.4, 0.1),
}


@pytest.fixture(scope="module")
def data() -> Path:
    """Return the folder of PyBullet's robots."""
    return Path(import_module("pybullet_data").getDataPath())


def arm(urdf: Path, joint_angle: tuple[float, ...], **changes: Any) -> Scene:
    """Return an arm on the floor, welded to it, far from the ball."""
    model = read_urdf(urdf)
    scene = Scene(
        urdf=urdf,
        joint_names=tuple(name for name, joint in model.joints.items() if joint.kind != "fixed"),
        link_names=(model.base, *(name for name in model.links if name != model.base)),
        base_position=(0.0, 0.0, 1.0),
        base_quaternion=(1.0, 0.0, 0.0, 0.0),
        joint_angle=joint_angle,
        ball=FAR_BALL,
        boxes=(),
        timestep=DT,
        friction=0.5,
        restitution=0.8,
        fixed_base=True,
    )
    return replace(scene, **changes)


@contextmanager
def loaded(name: str, scene: Scene) -> Iterator[Engine]:
    module, engine, options = ENGINES[name]
    made = getattr(import_module(module), engine)(scene, getattr(import_module(module), options)())
    try:
        yield made
    finally:
        made.close()


def precision(name: str) -> float:
    module, _, options = ENGINES[name]
    relative: float = getattr(import_module(module), options)().precision
    return relative


def run(name: str, scene: Scene, duration: float) -> EngineState:
    torque, force = np.zeros(len(scene.joint_names)), np.zeros(3)
    with loaded(name, scene) as engine:
        for _ in range(round(duration / scene.timestep)):
            engine.step(torque, force)
        return engine.read()


@pytest.mark.parametrize("robot", POSE)
def test_a_foreign_arm_falls_alike_in_every_engine_that_has_meshes(data: Path, robot: str) -> None:
    scene = arm(data / robot, POSE[robot])
    ends = [run(name, scene, 0.3 if robot != PANDA else 0.1) for name in WITH_MESHES]
    limits = np.array([read_urdf(scene.urdf).joints[name].limits for name in scene.joint_names])
    assert (limits[:, 0] < ends[0].joint_angle).all()
    assert (ends[0].joint_angle < limits[:, 1]).all()
    # The same equation and the same integrator. In double precision what is left is PyBullet's inertia of massless
    # links, at most 1e-12 kg m² beside 1e-4, and its link frames, which are in single precision.
    assert max(np.abs(end.joint_angle - scene.joint_angle).max() for end in ends) > 0.01
    for name, end in zip(WITH_MESHES, ends, strict=True):
        rounding = precision(name) * 3000  # steps, of numbers up to 1
        assert end.joint_angle == pytest.approx(ends[0].joint_angle, abs=max(1e-7, rounding))
        assert end.link_position == pytest.approx(ends[0].link_position, abs=max(1e-6, rounding))


@pytest.mark.parametrize("robot", POSE)
def test_masses_of_the_copy_are_those_of_the_file(data: Path, robot: str) -> None:
    # That an engine loaded the copy is what every constructor checks.
    model = read_urdf(data / robot)
    with plain_urdf(data / robot, fill_masses(model)) as copy:
        plain = read_urdf(copy)
    assert list(plain.links) == list(model.links)
    assert list(plain.joints) == list(model.joints)
    for name, link in model.links.items():
        mass = link.mass or NO_MASS
        assert plain.links[name].mass == mass
        assert plain.links[name].com == pytest.approx(link.com, abs=1e-12)
        assert plain.links[name].inertia == pytest.approx(link.inertia, rel=1e-9, abs=1e-12)
    for joint in plain.joints.values():
        assert (joint.damping, joint.friction) == (0.0, 0.0)
        assert min(joint.effort, joint.speed) >= 1e9 or joint.limits is None


@pytest.mark.parametrize(
    ("robot", "link", "neighbour", "velocity"),
    [
        pytest.param(KUKA, "lbr_iiwa_link_5", "lbr_iiwa_link_5", (0.0, 5.0, 0.0), id="stl"),
        pytest.param(PANDA, "panda_hand", "panda_leftfinger", (0.0, 0.0, 5.0), id="obj"),
    ],
)
@pytest.mark.parametrize("engine_name", WITH_MESHES)
def test_a_ball_touches_the_hull_of_a_mesh_where_it_is(
    data: Path, engine_name: str, robot: str, link: str, neighbour: str, velocity: tuple[float, float, float]
) -> None:
    scene = arm(data / robot, POSE[robot], gravity=NO_GRAVITY)
    start = corners_of(scene, link).mean(axis=0) - 0.06 * np.array(velocity)
    end = run(engine_name, replace(scene, ball=replace(FAR_BALL, position=tuple(start), velocity=velocity)), 0.06)
    touch = end.ball_contacts[0]
    assert touch.other in (link, neighbour)
    hull = ConvexHull(corners_of(scene, touch.other))
    depth = float((hull.equations @ np.append(touch.position, 1.0)).max())
    # It enters by at most the way of a step, .5 mm; around a hull Bullet puts 1 mm, PhysX rounds it off by .02 mm.
    assert (
        -5.0 * DT - (5e-5 if engine_name == "sapien" else 0.0)
        <= depth
        <= (1.5e-3 if engine_name == "pybullet" else 5.0 * DT)
    )


def corners_of(scene: Scene, link: str) -> np.ndarray:
    """Return the corners of a link's mesh in the world [m], shape (V, 3)."""
    model = read_urdf(scene.urdf)
    angles = dict(zip(scene.joint_names, scene.joint_angle, strict=True))
    position, rotation = model.link_poses(angles, np.array(scene.base_position), np.eye(3))[link]
    (shape,) = model.links[link].collisions
    assert shape.mesh is not None
    return position + (shape.position + shape.mesh.vertices @ shape.rotation.T) @ rotation.T


@pytest.mark.parametrize("name", [pytest.param("ode", marks=needs("ode"))])
def test_ode_says_that_it_has_no_meshes(data: Path, name: str) -> None:
    with (
        pytest.raises(BackendError, match="ODE has no convex shapes, but lbr_iiwa_link_0 has a mesh; give it boxes"),
        loaded(name, arm(data / KUKA, POSE[KUKA])),
    ):
        pass


def brick(folder: Path, shape: str) -> Path:
    corners = [(x, y, z) for x in (-50, 50) for y in (-100, 100) for z in (-30, 30)]  # [mm]
    (folder / "brick.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners))
    path = folder / "brick.urdf"
    path.write_text(
        '<robot name="brick"><link name="brick"><inertial><mass value="1"/>'
        '<inertia ixx="0.00363" iyy="0.00113" izz="0.00417" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"<collision><geometry>{shape}</geometry></collision></link></robot>"
    )
    return path


@pytest.mark.parametrize("engine_name", WITH_MESHES)
def test_a_mesh_in_millimetres_rests_on_the_floor_as_the_box_it_is(tmp_path: Path, engine_name: str) -> None:
    heights = []
    for shape in ('<mesh filename="brick.obj" scale="0.001 0.001 0.001"/>', '<box size="0.1 0.2 0.06"/>'):
        scene = arm(brick(tmp_path, shape), (), fixed_base=False, base_position=(0.0, 0.0, 0.031))
        heights.append(run(engine_name, scene, 0.2).link_position[0, 2])
    # Around a hull Bullet puts 1 mm; the rest is what contacts give way to a kilogram.
    assert heights[0] == pytest.approx(heights[1], abs=1.1e-3 if engine_name == "pybullet" else 1e-4)


SLIDER = """<robot name="slider">
<link name="world"/>
<joint name="weld" type="fixed"><parent link="world"/><child link="rail"/></joint>
<link name="rail"/>
<joint name="flange" type="fixed"><parent link="rail"/><child link="mount"/><origin xyz="0 0 0.5"/></joint>
<link name="mount"/>
<joint name="slide" type="prismatic"><parent link="mount"/><child link="cart"/><origin rpy="0 0 0.7"/>
<axis xyz="2 0 0"/><limit lower="-0.3" upper="0.5" effort="0.1" velocity="0.001"/>
<dynamics damping="5" friction="5"/></joint>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<transmission name="ignored"/>
<joint name="follower" type="prismatic"><parent link="mount"/><child link="other"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="slide" multiplier="2"/></joint>
<link name="other"><inertial><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""


def test_a_slide_obeys_its_force_alone(tmp_path: Path, engine_name: str) -> None:
    """Not the damping, friction, effort, speed and mimic of the file, which are the actuators' affair."""
    path = tmp_path / "slider.urdf"
    path.write_text(SLIDER)
    scene = arm(path, (0.1, 0.2), timestep=1e-3)
    assert scene.link_names[0] == "rail"
    force, steps = np.array([3.0, 0.0]), 400
    with loaded(engine_name, scene) as engine:
        start = engine.read().link_position[scene.link_names.index("cart")]
        for _ in range(steps):
            engine.step(force, np.zeros(3))
        state = engine.read()
    # Semi-implicit Euler: v = a t and x = a t (t + dt) / 2.
    time = steps * scene.timestep
    way = 0.5 * 3.0 / 2.0 * time * (time + scene.timestep)
    rounding = max(1e-6, precision(engine_name) * steps)  # of numbers up to 1
    assert state.joint_velocity == pytest.approx([1.5 * time, 0.0], abs=rounding)
    assert state.joint_angle == pytest.approx([0.1 + way, 0.2], abs=rounding)
    along = Rotation.from_rotvec([0.0, 0.0, 0.7]).apply([1.0, 0.0, 0.0])
    assert start == pytest.approx([0.0, 0.0, 1.5] + 0.1 * along, abs=1e-6)
    assert state.link_position[scene.link_names.index("cart")] == pytest.approx(start + way * along, abs=rounding)


def test_a_slide_stops_at_its_limit(tmp_path: Path, engine_name: str) -> None:
    path = tmp_path / "slider.urdf"
    path.write_text(SLIDER)
    scene = arm(path, (0.45, 0.0))
    with loaded(engine_name, scene) as engine:
        for _ in range(5000):
            engine.step(np.array([2.0, 0.0]), np.zeros(3))
        angle, _, _ = engine.motion()
        # A stop of 1 ms yields by F / (m w²), 1 µm; at .3 m/s the cart enters by .03 mm in a step.
        assert angle[0] == pytest.approx(0.5, abs=1e-3)


def test_a_moving_base_without_mass_is_refused(tmp_path: Path, engine_name: str) -> None:
    path = tmp_path / "slider.urdf"
    path.write_text(SLIDER)
    with (
        pytest.raises(
            BackendError, match="base 'rail' has no mass and is to move; give it an <inertial>, or set fixed"
        ),
        loaded(engine_name, arm(path, (0.0, 0.0), fixed_base=False)),
    ):
        pass
