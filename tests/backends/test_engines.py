"""Every engine does what `Engine` promises: the same claims for all of them."""

from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from imolo.errors import BackendError, DivergenceError
from imolo_backends.engine import Array, Ball, Engine, EngineState, Scene
from imolo_backends.liberobot import (
    ARM_LINKS,
    HAND_OFFSET,
    JOINT_LIMITS,
    JOINT_NAMES,
    LINK_NAMES,
    foam_ball,
    ready_scene,
)
from imolo_backends.urdf import RobotModel, read_urdf

DT = 1e-4
G = 9.81
NO_TORQUE = np.zeros(8)
NO_FORCE = np.zeros(3)
WEIGHTLESS = (0.0, 0.0, 0.0)
FAR_UP = (0.0, 0.0, 50.0)
# Valve 8 at rest, .05 MPa, presses the legs into their stops (40 mm, reduction 2) and the arms down (25 mm).
REST_TORQUE = np.array([3.3] * 6 + [-0.6] * 2)
SINGLE_PRECISION = 5e-7  # [m] of numbers up to 4 m: PyBullet's COMs of a URDF and the link frames it hands out.

PENDULUM = """<robot name="pendulum">
  <link name="stand"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="rod"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
    <inertia ixx="0.16667" iyy="0.16667" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pivot" type="continuous"><parent link="stand"/><child link="rod"/><axis xyz="0 1 0"/></joint>
</robot>"""
SCISSORS = """<robot name="scissors">
  <link name="base"><inertial><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="one"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.2"/><geometry><box size="0.1 0.1 0.4"/></geometry></collision></link>
  <link name="two"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 -0.2"/><geometry><box size="0.1 0.1 0.4"/></geometry></collision></link>
  <joint name="first" type="continuous"><parent link="base"/><child link="one"/><axis xyz="0 1 0"/></joint>
  <joint name="second" type="continuous"><parent link="base"/><child link="two"/><origin xyz="0.06 0.03 0"/>
    <axis xyz="0 1 0"/></joint>
</robot>"""
BRICK = """<robot name="brick">
  <link name="brick"><inertial><origin xyz="0.02 0.01 -0.03" rpy="0.3 0.2 0.1"/><mass value="0.5"/>
    <inertia ixx="0.003" iyy="0.002" izz="0.0015" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.3 0.2 0.1"/></geometry></collision></link>
</robot>"""


def run(engine: Engine, time: float, torque: Array = NO_TORQUE, force: Array = NO_FORCE) -> EngineState:
    for _ in range(round(time / DT)):
        engine.step(torque, force)
    return engine.read()


def flying(**changes: Any) -> Scene:
    """Return the robot high in the air, all joints in the middle of their range."""
    scene = replace(ready_scene(), base_position=FAR_UP, joint_angle=tuple(JOINT_LIMITS.mean(axis=1).tolist()))
    return replace(scene, **changes)


def ball_scene(ball: Ball, **changes: Any) -> Scene:
    """Return a ball alone on the floor; the robot hangs far up."""
    return flying(ball=ball, fixed_base=True, **changes)


def small_scene(tmp_path: Path, urdf: str, links: tuple[str, ...], joints: tuple[str, ...], **changes: Any) -> Scene:
    path = tmp_path / "robot.urdf"
    path.write_text(urdf)
    scene = ready_scene(ball=foam_ball((3.0, 0.0, 30.0)))
    scene = replace(scene, urdf=path, link_names=links, joint_names=joints, joint_angle=(0.0,) * len(joints))
    return replace(scene, base_position=(0.0, 0.0, 1.0), base_quaternion=(1.0, 0.0, 0.0, 0.0), boxes=(), **changes)


def expected_poses(model: RobotModel, state: EngineState) -> tuple[Array, Array]:
    w, x, y, z = state.base_quaternion
    angles = dict(zip(JOINT_NAMES, state.joint_angle, strict=True))
    poses = model.link_poses(angles, state.link_position[0], Rotation.from_quat([x, y, z, w]).as_matrix())
    return np.array([poses[name][0] for name in LINK_NAMES]), np.array([poses[name][1] for name in LINK_NAMES])


def test_a_ball_falls_as_semi_implicit_euler_predicts(make_engine: Any) -> None:
    time, start = 0.5, 20.0
    state = run(make_engine(ball_scene(foam_ball((3.0, 0.0, start)))), time)
    # z = z0 - g dt² n (n + 1) / 2, which is the parabola less 1/2 g t dt; the rest is rounding.
    fall = 0.5 * G * time**2 + 0.5 * G * time * DT
    assert state.ball_position == pytest.approx([3.0, 0.0, start - fall], abs=1e-9)
    assert state.ball_velocity == pytest.approx([0.0, 0.0, -G * time], abs=1e-9)
    assert state.time == pytest.approx(time)


def test_a_free_robot_falls_as_semi_implicit_euler_predicts(make_engine: Any, tmp_path: Path) -> None:
    time = 0.2
    scene = small_scene(tmp_path, BRICK, ("brick",), (), base_velocity=(1.0, -0.5, 2.0))
    state = run(make_engine(scene), time, np.empty(0))
    fall = 0.5 * G * time**2 + 0.5 * G * time * DT
    assert state.link_position[0] == pytest.approx(
        [1.0 * time, -0.5 * time, 1.0 + 2.0 * time - fall], abs=SINGLE_PRECISION
    )
    assert state.joint_angle.shape == (0,)


def test_the_base_velocity_is_that_of_the_link_frame_in_world_axes(make_engine: Any, tmp_path: Path) -> None:
    spin, velocity = np.array([1.0, -2.0, 3.0]), np.array([0.5, 0.2, -0.1])
    start = Rotation.from_euler("xyz", [0.4, -0.3, 0.8])
    x, y, z, w = start.as_quat()
    scene = small_scene(tmp_path, BRICK, ("brick",), (), gravity=WEIGHTLESS, base_velocity=tuple(velocity))
    scene = replace(scene, base_angular_velocity=tuple(spin), base_quaternion=(w, x, y, z))
    state = run(make_engine(scene), DT, np.empty(0))
    turn = (Rotation.from_matrix(state.link_rotation[0]) * start.inv()).as_rotvec()
    # One step moves by v dt, to second order in dt: |spin|² times the COM offset, and the gyroscopic torque.
    assert (state.link_position[0] - scene.base_position) / DT == pytest.approx(velocity, abs=15.0 * DT)
    assert turn / DT == pytest.approx(spin, abs=15.0 * DT)


def test_a_thrown_ball_gets_exactly_its_velocity_from_one_step(make_engine: Any) -> None:
    ball = foam_ball((5.0, 0.0, 1.1))
    velocity, hold = np.array([-7.0, 0.4, 3.0]), np.array([0.0, 0.0, ball.mass * G])
    engine = make_engine(ball_scene(ball))
    held = run(engine, 0.05, force=hold)
    assert held.ball_position == pytest.approx(ball.position, abs=1e-9)
    assert held.ball_velocity == pytest.approx(NO_FORCE, abs=1e-9)
    thrown = run(engine, DT, force=hold + ball.mass * velocity / DT)
    assert thrown.ball_velocity == pytest.approx(velocity, abs=1e-9)
    assert thrown.ball_position == pytest.approx(np.array(ball.position) + velocity * DT, abs=1e-9)


def test_torques_act_on_the_joints_of_their_names_in_their_directions(make_engine: Any) -> None:
    # From rest one step answers with dt / M, M being the mass matrix: symmetric and positive definite. Any swap of
    # joints or sign between torques and velocities would lose one or the other.
    response = []
    for torque in np.eye(8):
        state = run(make_engine(flying(gravity=WEIGHTLESS)), DT, torque)
        response.append(state.joint_velocity / DT)
        assert state.joint_angle - flying().joint_angle == pytest.approx(state.joint_velocity * DT, abs=1e-12)
    assert np.array(response) == pytest.approx(np.transpose(response), rel=1e-6, abs=1e-6)
    assert np.linalg.eigvalsh(response).min() > 0.1


def test_joints_are_ordered_by_name_not_by_the_urdf(make_engine: Any) -> None:
    backwards = flying(joint_names=JOINT_NAMES[::-1], link_names=(LINK_NAMES[0], *LINK_NAMES[:0:-1]))
    backwards = replace(backwards, joint_angle=backwards.joint_angle[::-1])
    torque = np.linspace(-1.0, 1.0, 8)
    forth, back = run(make_engine(flying()), 0.01, torque), run(make_engine(backwards), 0.01, torque[::-1])
    assert back.joint_angle[::-1] == pytest.approx(forth.joint_angle, abs=1e-12)
    assert back.joint_velocity[::-1] == pytest.approx(forth.joint_velocity, abs=1e-9)
    assert back.link_position[:0:-1] == pytest.approx(forth.link_position[1:], abs=1e-12)


def test_read_is_current_and_agrees_with_the_urdf(make_engine: Any) -> None:
    x, y, z, w = Rotation.from_euler("xyz", [0.4, -0.3, 0.8]).as_quat()
    scene = flying(base_position=(0.5, -0.2, 3.0), base_quaternion=(w, x, y, z), base_angular_velocity=(3.0, -5.0, 2.0))
    engine, model = make_engine(scene), read_urdf(scene.urdf)
    first = engine.read()
    assert first.joint_angle == pytest.approx(scene.joint_angle, abs=1e-12)
    assert first.link_position[0] == pytest.approx(scene.base_position, abs=SINGLE_PRECISION)
    state = run(engine, 0.02, np.array([5.0, -5.0, 1.0, -5.0, 5.0, -1.0, 2.0, -2.0]))
    # Poses one step old would be off by speed times dt.
    assert np.abs(state.joint_velocity).max() * DT > 1e-4
    for now in (first, state):
        position, rotation = expected_poses(model, now)
        assert now.link_position == pytest.approx(position, abs=SINGLE_PRECISION)
        assert now.link_rotation == pytest.approx(rotation, abs=SINGLE_PRECISION)
    angle, velocity, ball_velocity = engine.motion()
    assert np.array_equal(state.joint_angle, angle)
    assert np.array_equal(state.joint_velocity, velocity)
    assert np.array_equal(state.ball_velocity, ball_velocity)


def test_motion_is_contiguous_and_read_is_a_copy(make_engine: Any) -> None:
    engine = make_engine(flying())
    assert all(array.flags.c_contiguous for array in engine.motion())
    state = engine.read()
    before = {key: np.copy(value) for key, value in vars(state).items() if isinstance(value, np.ndarray)}
    run(engine, 0.01, np.ones(8))
    assert all(np.array_equal(getattr(state, key), value) for key, value in before.items())


@pytest.mark.parametrize("side", [0, 1], ids=["lower", "upper"])
def test_joints_stop_at_their_limits(make_engine: Any, side: int) -> None:
    sign = 1.0 if side else -1.0
    start = JOINT_LIMITS[:, side] - sign * 0.1
    engine = make_engine(flying(fixed_base=True, gravity=WEIGHTLESS, joint_angle=tuple(start.tolist())))
    push = sign * np.array([5.0, 5.0, 1.0, 5.0, 5.0, 1.0, 0.5, 0.5])
    speed, inside = 0.0, np.full(8, np.inf)
    for _ in range(4000):
        engine.step(push, NO_FORCE)
        angle, velocity, _ = engine.motion()
        inside = np.minimum(inside, sign * (JOINT_LIMITS[:, side] - angle))
        speed = max(speed, float(np.abs(velocity).max()))
    assert inside.max() < np.radians(0.1)
    # The softest stop, MuJoCo's, is about critically damped with 2 ms: it gives way by less than speed times 2 ms / 2.
    assert inside.min() > -0.5 * speed * 0.002


def test_the_ready_pose_stays_for_300_ms(make_engine: Any, record_property: Any) -> None:
    engine = make_engine(ready_scene())
    first = engine.read()
    last = run(engine, 0.3, REST_TORQUE)
    drift = float(np.abs(last.link_position - first.link_position).max())
    record_property("drift [m]", drift)
    # The soft stops of MuJoCo give way by torque / (inertia w²), .05° at the ankle, which is .4 mm at the head.
    assert drift < 5e-4
    assert np.abs(last.joint_velocity).max() < 0.01


def test_fresh_instances_are_bit_equal_however_often_they_are_read(make_engine: Any) -> None:
    torques = np.random.default_rng(1).normal(0.0, 20.0, (600, 8)) * [1, 1, 0.3, 1, 1, 0.3, 0.1, 0.1]
    engines = [make_engine(ready_scene(ball=foam_ball((-0.1, 0.05, 1.4)))) for _ in range(2)]
    for torque in torques:
        for engine in engines:
            engine.step(torque, NO_FORCE)
        engines[1].read()
    first, second = (vars(engine.read()) for engine in engines)
    differing = [k for k, v in first.items() if isinstance(v, np.ndarray) and not np.array_equal(v, second[k])]
    assert differing == []


def test_the_mirrored_torques_give_the_mirrored_motion(make_engine: Any) -> None:
    mirror = [3, 4, 5, 0, 1, 2, 7, 6]
    torque = np.array([-20.0, -30.0, -5.0, -25.0, -20.0, -5.0, 1.0, 2.0])
    one = run(make_engine(ready_scene()), 0.1, torque)
    other = run(make_engine(ready_scene()), 0.1, torque[mirror])
    assert np.abs(one.link_position[0, 1]) > 1e-4
    # Iterative solvers treat the sides in some order; what is left of it after 1000 steps is far below the motion.
    assert other.joint_angle[mirror] == pytest.approx(one.joint_angle, abs=2e-3)
    assert other.link_position[0] == pytest.approx(one.link_position[0] * [1, -1, 1], abs=1e-3)


@pytest.mark.parametrize(
    "offset", [(0.0, 0.0), (0.03, -0.12), (-0.03, -0.12)], ids=["middle", "left corner", "right corner"]
)
def test_a_fast_ball_does_not_pass_through_the_plate(make_engine: Any, offset: tuple[float, float]) -> None:
    scene = flying(fixed_base=True, gravity=WEIGHTLESS, base_quaternion=(1.0, 0.0, 0.0, 0.0), joint_angle=(0.0,) * 8)
    hand = make_engine(scene).read().link_position[LINK_NAMES.index("right_arm")] + HAND_OFFSET
    ball = foam_ball(tuple(hand + np.array([0.2, *offset])), (-10.0, 0.0, 0.0))
    engine = make_engine(replace(scene, ball=ball))
    # Pushed backwards the arm is at its stop, so the plate stands like a wall.
    nearest = min(run(engine, DT).ball_position[0] for _ in range(400)) - hand[0]
    assert 0.0 < nearest <= ball.radius + 0.0015
    assert engine.read().ball_velocity[0] > 0.0


@pytest.mark.parametrize(
    ("what", "where"), [("floor", (3.0, 0.0, 0.25)), ("box", (-0.4, 0.0, 0.65)), ("right_arm", None)]
)
def test_every_contact_of_the_ball_is_caught_between_two_reads(make_engine: Any, what: str, where: Any) -> None:
    scene = flying(fixed_base=True, gravity=WEIGHTLESS, base_quaternion=(1.0, 0.0, 0.0, 0.0))
    if where is None:
        # The arm is raised to the front, its plate is level.
        scene = replace(scene, joint_angle=(0.0,) * 6 + (np.pi / 2,) * 2)
        arm = LINK_NAMES.index("right_arm")
        start = make_engine(scene).read()
        where = start.link_position[arm] + start.link_rotation[arm] @ HAND_OFFSET + [0.0, 0.0, 0.2]
    ball = foam_ball(tuple(where), (0.0, 0.0, -3.0))
    engine = make_engine(replace(scene, ball=ball))
    state = run(engine, 0.15)
    contacts = state.ball_contacts
    assert {contact.other for contact in contacts} == {what}
    assert all(0.0 < contact.time <= state.time for contact in contacts)
    assert len({contact.time for contact in contacts}) == len(contacts)
    # Straight below the ball, which is less than a step's way from where it touches or as deep as a soft contact gives.
    assert contacts[0].position[:2] == pytest.approx(np.array(where[:2]), abs=1e-6)
    # Momentum balance: the forces of all steps are all that changed the velocity. The arm turns away under the ball,
    # so that its normal tilts a little.
    push = sum(contact.force for contact in contacts) * DT
    gained = ball.mass * (state.ball_velocity[2] + 3.0)
    assert push == pytest.approx(gained, rel=1e-2 if what == "right_arm" else 1e-6)
    assert engine.read().ball_contacts == ()


@pytest.mark.parametrize("restitution", [0.3, 0.5, 0.8])
def test_the_ball_bounces_as_asked(make_engine: Any, restitution: float) -> None:
    ball = foam_ball((3.0, 0.0, 0.2), (0.0, 0.0, -4.0))
    engine = make_engine(ball_scene(ball, restitution=restitution, gravity=WEIGHTLESS))
    bounced = run(engine, 0.1).ball_velocity[2] / 4.0
    assert bounced == pytest.approx(restitution, abs=0.04)


def test_the_robot_does_not_bounce(make_engine: Any, tmp_path: Path) -> None:
    scene = small_scene(tmp_path, BRICK.replace('xyz="0.02 0.01 -0.03"', ""), ("brick",), (), restitution=0.8)
    engine = make_engine(replace(scene, base_position=(0.0, 0.0, 0.15), base_velocity=(0.0, 0.0, -2.0)))
    run(engine, 0.06, np.empty(0))
    height = max(run(engine, 0.002, np.empty(0)).link_position[0, 2] for _ in range(100))
    # With e = .8 it would rise by e² v² / 2 g = 140 mm; MuJoCo's critically damped contact keeps exp(-2) of the speed.
    assert height < 0.05 + np.exp(-4.0) * 2.2**2 / (2.0 * G) + 1e-3


def test_a_continuous_joint_on_a_fixed_base_is_a_pendulum(make_engine: Any, tmp_path: Path) -> None:
    scene = small_scene(tmp_path, PENDULUM, ("stand", "rod"), ("pivot",), fixed_base=True)
    scene = replace(scene, joint_angle=(np.pi / 2,))
    state = run(make_engine(scene), 10 * DT, np.array([1.0]))
    # The rod lies along -x; gravity turns it back to 0, the torque away from it.
    acceleration = (1.0 - 2.0 * G * 0.5) / (0.16667 + 2.0 * 0.25)
    assert state.joint_velocity[0] == pytest.approx(acceleration * 10 * DT, rel=1e-4)
    assert state.link_position[0] == pytest.approx(scene.base_position, abs=1e-12)


@pytest.mark.parametrize(("start", "torque"), [(0.0, 1.0), (7.0, 1.0), (-3.0, -1.0)])
def test_a_continuous_joint_counts_its_turns(make_engine: Any, tmp_path: Path, start: float, torque: float) -> None:
    scene = small_scene(tmp_path, PENDULUM, ("stand", "rod"), ("pivot",), fixed_base=True, gravity=WEIGHTLESS)
    time, inertia = 3.0, 0.16667 + 2.0 * 0.25
    state = run(make_engine(replace(scene, joint_angle=(start,))), time, np.array([torque]))
    turned = 0.5 * torque / inertia * time * (time + DT)
    assert state.joint_angle[0] - start == pytest.approx(turned, rel=1e-4)
    assert abs(turned) > 2.0 * np.pi


def test_the_robot_does_not_touch_itself(make_engine: Any, tmp_path: Path) -> None:
    scene = small_scene(
        tmp_path, SCISSORS, ("base", "one", "two"), ("first", "second"), gravity=WEIGHTLESS, fixed_base=True
    )
    # The two boxes overlap; without gravity and torque nothing may move.
    state = run(make_engine(scene), 0.05, np.zeros(2))
    assert np.abs(state.joint_velocity).max() < 1e-9


def test_what_has_rested_for_long_answers_to_the_first_force(make_engine: Any) -> None:
    ball = foam_ball()
    hold = np.array([0.0, 0.0, ball.mass * G])
    engine = make_engine(ready_scene(ball=ball))
    run(engine, 0.6, REST_TORQUE, hold)
    throw = hold + ball.mass * np.array([-7.0, 0.0, 3.0]) / DT
    state = run(engine, DT, REST_TORQUE + np.repeat([0.0, 4.0], [6, 2]), throw)
    assert state.ball_velocity == pytest.approx([-7.0, 0.0, 3.0], abs=1e-9)
    assert state.joint_velocity[6:].min() > 0.01


@pytest.mark.parametrize(
    ("value", "message"),
    [("mass", "mass of left_arm"), ("com", "COM of left_arm"), ("inertia", "inertia of left_arm")],
)
def test_a_link_that_is_not_the_urdfs_is_refused(
    make_engine: Any, engine_module: ModuleType, monkeypatch: pytest.MonkeyPatch, value: str, message: str
) -> None:
    def misread(path: Path) -> RobotModel:
        model = read_urdf(path)
        link = model.links["left_arm"]
        model.links["left_arm"] = replace(link, **{value: getattr(link, value) * 1.001})
        return model

    monkeypatch.setattr(engine_module, "read_urdf", misread)
    with pytest.raises(BackendError, match=message):
        make_engine(ready_scene())


def test_a_limit_that_is_not_the_urdfs_is_refused(
    make_engine: Any, engine_module: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    def misread(path: Path) -> RobotModel:
        model = read_urdf(path)
        model.joints["left_knee"] = replace(model.joints["left_knee"], limits=(0.0, 2.0))
        return model

    monkeypatch.setattr(engine_module, "read_urdf", misread)
    with pytest.raises(BackendError, match="limits of left_knee"):
        make_engine(ready_scene())


def test_names_that_are_not_in_the_urdf_are_refused_with_a_hint(make_engine: Any) -> None:
    scene = ready_scene()
    with pytest.raises(BackendError, match=r"'right_hips' is not in liberobot\.urdf; did you mean 'right_hip'"):
        make_engine(replace(scene, joint_names=("right_hips", *JOINT_NAMES[1:])))
    with pytest.raises(BackendError, match="first link is 'left_arm'; expected the base 'trunk'"):
        make_engine(replace(scene, link_names=LINK_NAMES[::-1]))


def test_a_diverged_state_is_never_hidden(make_engine: Any) -> None:
    engine = make_engine(flying())
    torque = np.zeros(8)
    torque[3] = np.nan
    try:
        angle = run(engine, 0.001, torque).joint_angle[3]
    except DivergenceError:
        angle = np.nan
    assert not np.isfinite(angle)


def test_unknown_options_are_refused(make_engine: Any) -> None:
    with pytest.raises(ValidationError, match="no_such_option"):
        make_engine(ready_scene(), no_such_option=1)


def test_closing_twice_is_harmless(make_engine: Any) -> None:
    engine = make_engine(ready_scene())
    engine.close()
    engine.close()


def test_an_arm_swung_at_the_ball_hits_it(make_engine: Any) -> None:
    scene = flying(fixed_base=True, base_quaternion=(1.0, 0.0, 0.0, 0.0), joint_angle=(0.0,) * 8)
    shoulder = make_engine(scene).read().link_position[LINK_NAMES.index("left_arm")]
    ball = foam_ball(tuple(shoulder + np.array([0.40, 0.0, 0.0])))
    engine = make_engine(replace(scene, ball=ball))
    hold = np.array([0.0, 0.0, ball.mass * G])
    state = run(engine, 0.4, np.array([0.0] * 6 + [0.0, 6.0]), hold)
    assert {contact.other for contact in state.ball_contacts} <= set(ARM_LINKS)
    assert state.ball_velocity[2] > 3.0
