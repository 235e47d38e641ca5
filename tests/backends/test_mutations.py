"""Mistakes that engines and their adapters are known for are caught by the conformance kit.

A mutation is put into the real engine behind the back of what its constructor checks, as a future version of an engine
might do it.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from mutants import (
    BULLET,
    ENGINES,
    MUJOCO,
    TOUCHABLE_LINKS,
    assert_caught,
    changed,
)

from imolo.contracts.engine import Array, Ball, EngineState, Scene
from imolo_backends.conformance.bodies import BALL_RADIUS
from imolo_backends.engines import mujoco_engine, pybullet_engine
from imolo_backends.engines.dart_engine import DartEngine
from imolo_backends.engines.mujoco_engine import MujocoEngine
from imolo_backends.engines.pybullet_engine import PybulletEngine


def set_gravity(engine: Any, gravity: Array) -> None:
    if isinstance(engine, MujocoEngine):
        engine._model.opt.gravity[:] = gravity
    elif isinstance(engine, PybulletEngine):
        BULLET.setGravity(*gravity, physicsClientId=engine._client)
    else:
        engine._world.setGravity(gravity)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_wrong_gravity_is_caught(engine: Any) -> None:
    mutated = changed(engine, lambda self, scene: set_gravity(self, np.array(scene.gravity) * 9.80 / 9.81))
    assert_caught(engine, mutated, "free_fall", "projectile", "rod_pendulum", "double_pendulum", "robot_drop")


def add_kilogram(engine: Any, scene: Scene) -> None:
    link = scene.link_names[-1]
    if isinstance(engine, MujocoEngine):
        engine._model.body(link).mass[0] += 1.0
        MUJOCO.mj_setConst(engine._model, engine._data)
        engine._start()
    elif isinstance(engine, PybulletEngine):
        where = {
            "bodyUniqueId": engine._robot,
            "linkIndex": engine._link_index[link],
            "physicsClientId": engine._client,
        }
        mass, _, moments, *_ = BULLET.getDynamicsInfo(*where.values())
        BULLET.changeDynamics(**where, mass=mass + 1.0, localInertiaDiagonal=moments)
    else:
        node = engine._robot.getBodyNode(link)
        node.setMass(node.getMass() + 1.0)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_phantom_kilogram_is_caught(engine: Any) -> None:
    assert_caught(engine, changed(engine, add_kilogram), "mass_matrix", "robot_drop")


def swapped_torques(self: Any, joint_torque: Array, ball_force: Array) -> None:
    super(type(self), self).step(joint_torque[SWAP], ball_force)


def swapped_motion(self: Any) -> tuple[Array, Array, Array]:
    angle, velocity, ball = super(type(self), self).motion()
    return angle[SWAP], velocity[SWAP], ball


SWAP = [3, 1, 2, 0, 4, 5, 6, 7]  # right and left hip, whose links are alike


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("methods", "checks"),
    [
        pytest.param({"step": swapped_torques}, ("mass_matrix", "joint_limits"), id="torques"),
        pytest.param({"motion": swapped_motion}, ("mass_matrix", "current_read"), id="reading"),
        pytest.param({"step": swapped_torques, "motion": swapped_motion}, ("current_read", "mass_matrix"), id="both"),
    ],
)
def test_swapped_joints_are_caught(engine: Any, methods: dict[str, Any], checks: tuple[str, ...]) -> None:
    def for_robots(name: str) -> Any:
        def method(self: Any, *args: Any) -> Any:
            robot = len(self._scene.joint_names) == len(SWAP)
            return methods[name](self, *args) if robot else getattr(engine, name)(self, *args)

        return method

    assert_caught(engine, type("Swapped", (engine,), {name: for_robots(name) for name in methods}), *checks)


@pytest.mark.parametrize("engine", ENGINES)
def test_velocities_of_the_step_before_are_caught(engine: Any) -> None:
    class Late(engine):  # type: ignore[misc]
        before: Any = None

        def step(self, joint_torque: Array, ball_force: Array) -> None:
            self.before = super().motion()[1].copy()
            super().step(joint_torque, ball_force)

        def motion(self) -> tuple[Array, Array, Array]:
            angle, velocity, ball = super().motion()
            return angle, velocity if self.before is None else self.before, ball

    assert_caught(engine, Late, "current_read", "mass_matrix")


class LateMujoco(MujocoEngine):
    """Links are where mj_step leaves them, one step behind the joints."""

    def read(self) -> EngineState:
        with mock.patch.object(MUJOCO, "mj_kinematics"):
            return super().read()


def test_mujocos_lag_of_one_step_is_caught() -> None:
    assert_caught(MujocoEngine, LateMujoco, "current_read")


class ViewMujoco(MujocoEngine):
    """Joint angles are MuJoCo's own memory."""

    def read(self) -> EngineState:
        return replace(super().read(), joint_angle=self.motion()[0])


def test_a_view_instead_of_a_copy_is_caught() -> None:
    assert_caught(MujocoEngine, ViewMujoco, "copies")


def reset_when_unstable(engine: Any, _: Scene) -> None:
    engine._model.opt.disableflags &= ~MUJOCO.mjtDisableBit.mjDSBL_AUTORESET


def test_mujocos_reset_of_a_diverged_state_is_caught() -> None:
    assert_caught(MujocoEngine, changed(MujocoEngine, reset_when_unstable), "divergence")


def collide_with_itself(engine: Any, _: Scene) -> None:
    model = engine._model
    for mask in (model.geom_contype, model.geom_conaffinity, model.body_contype, model.body_conaffinity):
        mask[:] = 1


def test_self_collision_is_caught() -> None:
    assert_caught(MujocoEngine, changed(MujocoEngine, collide_with_itself), "no_self_collision")


def damp(engine: Any, _: Scene) -> None:
    for body in (engine._robot, engine._ball):
        for link in range(-1, BULLET.getNumJoints(body, physicsClientId=engine._client)):
            BULLET.changeDynamics(
                body,
                link,
                linearDamping=0.04,
                angularDamping=0.04,
                jointDamping=0.04,
                physicsClientId=engine._client,
            )


def test_pybullets_default_damping_is_caught() -> None:
    checks = ("free_fall", "projectile", "tumbling_box", "spinning_joint", "rod_pendulum", "robot_drop")
    assert_caught(PybulletEngine, changed(PybulletEngine, damp), *checks)


def brake(engine: Any, _: Scene) -> None:
    for joint in engine._joints:
        BULLET.setJointMotorControl2(
            engine._robot, joint, BULLET.VELOCITY_CONTROL, force=0.01, physicsClientId=engine._client
        )


def test_pybullets_motors_that_hold_joints_are_caught() -> None:
    assert_caught(PybulletEngine, changed(PybulletEngine, brake), "spinning_joint", "mass_matrix")


def start_at_com(engine: Any, scene: Scene) -> None:
    if not scene.fixed_base:
        BULLET.resetBaseVelocity(
            engine._robot, scene.base_velocity, scene.base_angular_velocity, physicsClientId=engine._client
        )


def test_a_base_velocity_of_the_com_is_caught() -> None:
    assert_caught(PybulletEngine, changed(PybulletEngine, start_at_com), "base_frame", "robot_drop")


def do_not_enforce_limits(engine: Any, _: Scene) -> None:
    for joint in engine._robot.getJoints():
        joint.setLimitEnforcement(False)


def test_limits_that_dart_does_not_enforce_are_caught() -> None:
    assert_caught(DartEngine, changed(DartEngine, do_not_enforce_limits), "joint_limits", "standing")


def drop_friction(engine: Any, _: Scene) -> None:
    # Bullet drops `lateralFriction` from a call that also sets damping; what stays is its default.
    for body, link in [*engine._names, (engine._ball, pybullet_engine.BASE)]:
        BULLET.changeDynamics(body, link, lateralFriction=0.5, physicsClientId=engine._client)


def test_friction_that_pybullet_drops_is_caught() -> None:
    assert_caught(PybulletEngine, changed(PybulletEngine, drop_friction), "friction_asked")


def soften(engine: Any, _: Scene) -> None:
    default = (0.02, 1.0)
    engine._model.geom_solref[:] = default
    engine._model.jnt_solref[:] = default


def test_mujocos_default_softness_is_caught() -> None:
    assert_caught(MujocoEngine, changed(MujocoEngine, soften), "joint_limits", "standing", "push_off", "fast_ball_10")


@pytest.mark.parametrize(
    ("longer", "checks"),
    # In stiffness a hundred times, and ten thousand times.
    [(10.0, ["robot_does_not_bounce"]), (100.0, ["robot_does_not_bounce", "push_off"])],
)
def test_contacts_of_the_robot_that_are_too_soft_are_caught(longer: float, checks: list[str]) -> None:
    def soften_robot(engine: Any, _: Scene) -> None:
        of_robot = np.arange(engine._model.ngeom) != engine._ball_geom
        engine._model.geom_solref[of_robot, 0] *= longer

    assert_caught(MujocoEngine, changed(MujocoEngine, soften_robot), *checks)


def add_inertia(engine: Any, scene: Scene) -> None:
    moment = 1.3 * scene.ball.inertia
    if isinstance(engine, MujocoEngine):
        engine._model.body(mujoco_engine.BALL).inertia[:] = moment
        MUJOCO.mj_setConst(engine._model, engine._data)
        engine._start()
    elif isinstance(engine, PybulletEngine):
        BULLET.changeDynamics(
            engine._ball,
            pybullet_engine.BASE,
            mass=scene.ball.mass,
            localInertiaDiagonal=[moment] * 3,
            physicsClientId=engine._client,
        )
    else:
        inertia = engine._ball_body.getInertia()
        inertia.setMoment(moment * np.eye(3))
        engine._ball_body.setInertia(inertia)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_ball_whose_moment_of_inertia_is_off_by_30_percent_is_caught(engine: Any) -> None:
    assert_caught(engine, changed(engine, add_inertia), "slide_to_roll")


def other_ball(**values: Callable[[Ball], float]) -> Callable[[Any], Any]:
    """Return what makes an engine load a ball with other values than the scene's."""

    def of(engine: Any) -> Any:
        def load(self: Any, scene: Scene, options: Any) -> None:
            changes: dict[str, Any] = {name: value(scene.ball) for name, value in values.items()}
            engine.__init__(self, replace(scene, ball=replace(scene.ball, **changes)), options)

        return type(f"OtherBall{engine.__name__}", (engine,), {"__init__": load})

    return of


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    "mutate",
    [
        pytest.param(other_ball(inertia=lambda ball: 0.4 * ball.mass * ball.radius**2), id="solid"),
        pytest.param(other_ball(radius=lambda _: BALL_RADIUS), id="radius"),
    ],
)
def test_a_ball_that_is_always_the_same_is_caught(engine: Any, mutate: Callable[[Any], Any]) -> None:
    assert_caught(engine, mutate(engine), "slide_to_roll")


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("body", ["floor", "block", "step", *TOUCHABLE_LINKS])
def test_touches_of_one_body_that_are_not_told_are_caught(engine: Any, body: str) -> None:
    class Silent(engine):  # type: ignore[misc]
        def read(self) -> EngineState:
            state: EngineState = super().read()
            told = tuple(contact for contact in state.ball_contacts if contact.other != body)
            return replace(state, ball_contacts=told)

    assert_caught(engine, Silent, "contact_report")


def test_touches_of_a_second_shape_that_are_not_told_are_caught() -> None:
    class Silent(MujocoEngine):
        """Tells of the plates, but not of the rods above them."""

        def read(self) -> EngineState:
            state = super().read()
            above = state.link_position[0, 2] + 0.36 - 0.18 if len(state.link_position) > 1 else np.inf
            return replace(state, ball_contacts=tuple(c for c in state.ball_contacts if c.position[2] < above))

    assert_caught(MujocoEngine, Silent, "contact_report")
