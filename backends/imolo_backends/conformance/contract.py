"""What `Engine` promises: clock, frames, order, copies, determinism.

A claim that is either true or false is measured as the size of what contradicts it, which must be 0.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from imolo.conformance import Measurement
from imolo.contracts.engine import Array
from imolo.errors import DivergenceError
from imolo_backends.conformance.bodies import (
    GRAVITY,
    HIGH,
    JOINT_NAMES,
    LINK_NAMES,
    WEIGHTLESS,
    ball_scene,
    flying_robot,
    lopsided_scene,
    overlapping_scene,
    solid_ball,
    standing_robot,
)
from imolo_backends.conformance.reference import Mechanism, rotation_of, rotation_vector
from imolo_backends.conformance.subject import ROUNDING, SceneCheck, Subject

# Presses the standing robot's joints into their stops.
REST_TORQUE = np.array([3.3] * 6 + [-0.6] * 2)  # [N·m]
# No two of them are equal, and they move every joint by some degrees within 20 ms.
PUSH = np.array([5.0, -4.5, 1.0, -4.0, 3.5, -0.8, 1.5, -1.2])  # [N·m]
TILT = tuple(np.roll(Rotation.from_euler("xyz", [0.4, -0.3, 0.8]).as_quat(), 1).tolist())  # w, x, y, z
MIRROR = [3, 4, 5, 0, 1, 2, 7, 6]  # the joints of the other side
ARRAYS = (
    "joint_angle",
    "joint_velocity",
    "link_position",
    "link_rotation",
    "base_quaternion",
    "ball_position",
    "ball_velocity",
)


def clock(subject: Subject) -> Iterator[Measurement]:
    """Time starts at 0 and grows by exactly one timestep per step."""
    timestep, steps = 1e-4, 1000
    with subject.run(flying_robot(timestep=timestep)) as run:
        times = np.array([state.time for state in run.states(steps * timestep, timestep)])
    late = float(np.abs(times - timestep * np.arange(steps + 1)).max())
    yield Measurement("distance from n dt", "s", 0.0, late, 1e-12, "rounding of 1000 additions")


def copies(subject: Subject) -> Iterator[Measurement]:
    """What was read does not change later, and motion() is contiguous and the same as read()."""
    with subject.run(flying_robot()) as run:
        first = run.advance(0.001, PUSH)
        kept = {name: getattr(first, name).copy() for name in ARRAYS}
        last = run.advance(0.01, PUSH)
        motion = run.engine.motion()
        scattered = sum(not array.flags.c_contiguous for array in motion)
        changed = _largest(_distance(getattr(first, name), kept[name]) for name in ARRAYS)
        read = (last.joint_angle, last.joint_velocity, last.ball_velocity)
        differing = _largest(_distance(one, other) for one, other in zip(motion, read, strict=True))
    yield Measurement("change of a copy", "", 0.0, changed, 0.0, "copies are copies")
    yield Measurement("arrays of motion() that are not contiguous", "", 0.0, scattered, 0.0, "compiled code reads them")
    yield Measurement("motion() less read()", "", 0.0, differing, 0.0, "the same state")


def determinism(subject: Subject) -> Iterator[Measurement]:
    """Two fresh instances agree to the last bit after 600 steps in contact, though one is read at every step."""
    torques = np.random.default_rng(1).normal(0.0, 20.0, (600, 8)) * [1.0, 1.0, 0.3, 1.0, 1.0, 0.3, 0.1, 0.1]
    scene = standing_robot(ball=solid_ball((0.0, 0.05, 1.4)))
    ends = []
    for reads in (False, True):
        with subject.run(scene) as run:
            for torque in torques:
                run.engine.step(torque, np.zeros(3))
                if reads:
                    run.engine.read()
            ends.append(run.engine.read())
    first, second = ends
    difference = _largest(_distance(getattr(first, name), getattr(second, name)) for name in ARRAYS)
    yield Measurement("largest difference", "", 0.0, difference, 0.0, "bit-equal")


def joint_order(subject: Subject) -> Iterator[Measurement]:
    """Joints and links follow the names that the scene gives, not the URDF."""
    scene, duration = flying_robot(timestep=1e-4), 0.02
    backwards = replace(
        scene,
        joint_names=JOINT_NAMES[::-1],
        link_names=(LINK_NAMES[0], *LINK_NAMES[:0:-1]),
        joint_angle=scene.joint_angle[::-1],
    )
    forth = subject.final_state(scene, duration, PUSH)
    back = subject.final_state(backwards, duration, PUSH[::-1])
    for quantity, unit, one, other in (
        ("angles", "rad", forth.joint_angle, back.joint_angle[::-1]),
        ("velocities", "rad/s", forth.joint_velocity, back.joint_velocity[::-1]),
        ("links", "m", forth.link_position[1:], back.link_position[:0:-1]),
    ):
        yield Measurement(f"difference of {quantity}", unit, 0.0, _distance(one, other), 1e-9, "the same motion")


def mirror(subject: Subject) -> Iterator[Measurement]:
    """Mirrored torques give the mirrored push-off from the block."""
    # Neither the feet leave the block nor the joints meet their other stops meanwhile.
    torque, duration = np.array([-6.0, -35.0, -5.0, -3.0, -25.0, -5.0, 1.0, 2.0]), 0.06
    one, other = (subject.final_state(standing_robot(), duration, each) for each in (torque, torque[MIRROR]))
    mirrored = other.joint_angle[MIRROR], other.link_position[0] * [1.0, -1.0, 1.0]
    angles = _distance(mirrored[0], one.joint_angle) / _distance(one.joint_angle[MIRROR], one.joint_angle)
    trunk = _distance(mirrored[1], one.link_position[0]) / abs(float(one.link_position[0, 1]))
    basis = "what an iterative solver leaves of its order of the feet"
    yield Measurement("joint angles, difference over asymmetry", "", 0.0, angles, 0.01, basis)
    yield Measurement("trunk, difference over way sideways", "", 0.0, trunk, 0.01, basis)


def current_read(subject: Subject) -> Iterator[Measurement]:
    """A read tells the state after the last step: poses, angles and velocities belong together."""
    timestep = 1e-4
    scene = flying_robot(
        timestep=timestep, base_position=(0.5, -0.2, 3.0), base_quaternion=TILT, base_angular_velocity=(3.0, -5.0, 2.0)
    )
    mechanism = Mechanism(scene)
    with subject.run(scene) as run:
        first = run.engine.read()
        before = run.advance(0.02, PUSH)
        last = run.advance(timestep, PUSH)
    start = _distance(first.joint_angle, np.array(scene.joint_angle))
    yield Measurement(
        "angles at the start", "rad", 0.0, start, subject.rounding(3.0, least=1e-12), "as asked, rounding"
    )
    start = _distance(first.link_position[0], np.array(scene.base_position))
    yield Measurement("base at the start", "m", 0.0, start, ROUNDING, "as asked, single precision")
    for when, state in (("at the start", first), ("after 20 ms", last)):
        positions, rotations = mechanism.poses(state)
        basis = "kinematics of the URDF, single precision"
        # A step moves the links by up to 1 mm.
        yield Measurement(f"links {when}", "m", 0.0, _distance(state.link_position, positions), ROUNDING, basis)
        yield Measurement(f"rotations {when}", "", 0.0, _distance(state.link_rotation, rotations), ROUNDING, basis)
    # Semi-implicit Euler moves the angles by the new velocity, every better integrator by their mean, to third order.
    mean = 0.5 * (before.joint_velocity + last.joint_velocity)
    moved = last.joint_velocity if subject.order == 1 else mean
    acceleration = float(np.abs(last.joint_velocity - before.joint_velocity).max()) / timestep
    error = _distance((last.joint_angle - before.joint_angle) / timestep, moved)
    basis = "a velocity one step old is off by α dt; a tenth of it"
    yield Measurement("angle gained per step and velocity", "rad/s", 0.0, error, 0.1 * acceleration * timestep, basis)


def base_frame(subject: Subject) -> Iterator[Measurement]:
    """The base velocity is that of the origin of the link frame, in world axes, wherever the COM is."""
    timestep = 1e-4
    velocity, spin = np.array([0.5, 0.2, -0.1]), np.array([1.0, -2.0, 3.0])
    scene = lopsided_scene(
        timestep=timestep,
        gravity=WEIGHTLESS,
        base_quaternion=TILT,
        base_velocity=tuple(velocity.tolist()),
        base_angular_velocity=tuple(spin.tolist()),
    )
    steps = 10
    with subject.run(scene) as run:
        first = run.engine.read()
        last = run.advance(steps * timestep)
    duration = steps * timestep
    moved = (last.link_position[0] - first.link_position[0]) / duration
    turned = rotation_vector(rotation_of(last) @ rotation_of(first).T) / duration
    drift = float(spin @ spin) * duration  # [rad/s]
    lever, rounding = 0.04, ROUNDING / duration
    error = _distance(moved, velocity)
    yield Measurement(
        "velocity of the frame", "m/s", 0.0, error, 2.0 * lever * drift + rounding, "2 w² r t, r to the COM"
    )
    error = _distance(turned, spin)
    yield Measurement("angular velocity", "rad/s", 0.0, error, drift + rounding, "w² t: gyroscopic torques")


def units(subject: Subject) -> Iterator[Measurement]:
    """A ball that is held by its weight is thrown by m v / dt during one step."""
    timestep = 1e-4
    ball = solid_ball((5.0, 0.0, 1.1))
    velocity = np.array([-7.0, 0.4, 3.0])
    with subject.run(ball_scene(ball, timestep=timestep)) as run:
        held = run.advance(0.05, force=run.weight)
        thrown = run.advance(timestep, force=run.weight + ball.mass * velocity / timestep)
    way = _distance(held.ball_position, np.array(ball.position))
    speed = float(np.abs(held.ball_velocity).max())
    far, fast = float(np.linalg.norm(ball.position)), float(np.linalg.norm(velocity))
    rounding = subject.rounding(far, round(0.05 / timestep))
    yield Measurement("way while held", "m", 0.0, way, rounding, "no force, rounding")
    rounding = subject.rounding(GRAVITY * 0.05, round(0.05 / timestep))
    yield Measurement("speed while held", "m/s", 0.0, speed, rounding, "no force, rounding")
    error = _distance(thrown.ball_velocity, velocity)
    yield Measurement("velocity less the one thrown", "m/s", 0.0, error, subject.rounding(fast), "F dt = m v, rounding")
    share = 1.0 if subject.order == 1 else 0.5
    error = _distance(thrown.ball_position - held.ball_position, share * velocity * timestep)
    yield Measurement("way in that step", "m", 0.0, error, subject.rounding(far), "v dt (order 1) or ½ v dt, rounding")


def no_self_collision(subject: Subject) -> Iterator[Measurement]:
    """Links that overlap do not push each other."""
    scene = overlapping_scene(gravity=WEIGHTLESS, fixed_base=True, base_position=HIGH)
    state = subject.final_state(scene, 0.05)
    speed = float(np.abs(state.joint_velocity).max())
    yield Measurement("joint velocity", "rad/s", 0.0, speed, 1e-9, "no force, rounding")


def no_sleep(subject: Subject) -> Iterator[Measurement]:
    """What has rested for .6 s answers the first force."""
    ball, pull = solid_ball(), 4.0
    scene = standing_robot(ball=ball)
    velocity = np.array([-7.0, 0.0, 3.0])
    with subject.run(scene) as run:
        run.advance(0.6, REST_TORQUE, run.weight)
        torque = REST_TORQUE + np.repeat([0.0, pull], [6, 2])
        before = run.engine.read().joint_velocity
        state = run.advance(scene.timestep, torque, run.weight + ball.mass * velocity / scene.timestep)
    gained = float((state.joint_velocity - before)[6:].min())
    arm = Mechanism(scene).mass_matrix(state.joint_angle, rotation_of(state))[12, 12]
    expected = pull * scene.timestep / arm
    thrown = _distance(state.ball_velocity, velocity)
    rounding = subject.rounding(float(np.linalg.norm(velocity)))
    basis = "F dt = m v, rounding"
    yield Measurement("velocity of the ball less the one thrown", "m/s", 0.0, thrown, rounding, basis)
    # The arms were pressed into their stops with .6 N·m, which a hard stop no longer gives back.
    basis = "τ dt / I of an arm; what its stop bore is 15 %, the recoil of the trunk a few"
    yield Measurement("velocity of the arms", "rad/s", expected, gained, 0.2 * expected, basis)


def divergence(subject: Subject) -> Iterator[Measurement]:
    """A torque that is not a number is never hidden."""
    torque = np.where(np.arange(8) == 3, np.nan, 0.0)
    with subject.run(flying_robot()) as run:
        try:
            angle = run.advance(2.0 * run.scene.timestep, torque).joint_angle[3]
        except DivergenceError:
            angle = np.nan
    hidden = float(np.isfinite(angle))
    yield Measurement("finite angles read", "", 0.0, hidden, 0.0, "DivergenceError, or NaN in the state")


def standing(subject: Subject) -> Iterator[Measurement]:
    """The robot, pressed into its stops, stands on the block for 300 ms."""
    with subject.run(standing_robot()) as run:
        first = run.engine.read()
        last = run.advance(0.3, REST_TORQUE)
    drift = _distance(last.link_position, first.link_position)
    speed = float(np.abs(last.joint_velocity).max())
    # Soft stops give way by torque / (inertia w²), .05° at the ankle, which is .4 mm at the shoulders.
    yield Measurement("way of the farthest link", "m", 0.0, drift, 5e-4, "stops of 2 ms give way by τ T² / I")
    yield Measurement("joint velocity", "rad/s", 0.0, speed, 0.01, "at rest; what iterative solvers leave")


def _distance(one: Array, other: Array) -> float:
    """Return the largest difference of two arrays."""
    return float(np.abs(one - other).max(initial=0.0))


def _largest(distances: Iterable[float]) -> float:
    """Return the largest; NaN if one of them is, which `max` would lose."""
    return float(np.max(list(distances)))


SCENES: tuple[SceneCheck, ...] = (
    clock,
    copies,
    determinism,
    joint_order,
    mirror,
    current_read,
    base_frame,
    units,
    no_self_collision,
    no_sleep,
    divergence,
    standing,
)
