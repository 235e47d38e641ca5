"""The loop one would write without us: an engine's own interface, stepped with what a trial applied."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import mujoco  # noqa: TID251 - this is what the engine's module is measured against
import numpy as np

from imolo.config.model import Model
from imolo.contracts.engine import Array, Engine, Scene
from imolo.contracts.registry import BACKENDS
from imolo_backends.engines.dart_engine import DartEngine
from imolo_backends.engines.mujoco_engine import MujocoEngine
from imolo_backends.engines.pybullet_engine import PybulletEngine, pybullet

ENGINES: dict[str, type[Any]] = {"mujoco": MujocoEngine, "pybullet": PybulletEngine, "dart": DartEngine}

if not BACKENDS.status("ode").problem:
    from imolo_backends.engines.ode_engine import OdeEngine, ode

    ENGINES["ode"] = OdeEngine


if not BACKENDS.status("drake").problem:
    from imolo_backends.engines.drake_engine import DrakeEngine

    ENGINES["drake"] = DrakeEngine

if not BACKENDS.status("sapien").problem:
    from imolo_backends.engines.sapien_engine import SapienEngine

    ENGINES["sapien"] = SapienEngine


@dataclass
class Recording:
    """What a trial did to its engine, step by step, and where that led.

    Attributes:
        name: Of the engine.
        scene: How it started.
        options: The engine's own.
        joint_torque: Torques of each step [N·m], each of shape (J,).
        ball_force: Force on the ball in each step [N], each of shape (3,).
        last_motion: Joint angles [rad], joint velocities [rad/s] and ball velocity [m/s] after the last step.
    """

    name: str
    scene: Scene = field(init=False)
    options: Model = field(init=False)
    joint_torque: list[Array] = field(default_factory=list)
    ball_force: list[Array] = field(default_factory=list)
    last_motion: tuple[Array, ...] = ()

    def replay(self, clock: Callable[[], float]) -> float:
        """Return how long the bare loop takes [s].

        Raises:
            RuntimeError: It does not end where the trial ended.
        """
        engine = ENGINES[self.name](self.scene, self.options)
        loop = BARE_LOOPS[self.name](engine, np.array(self.joint_torque), np.array(self.ball_force))
        begin = clock()
        loop()
        elapsed = clock() - begin
        if not all(map(np.array_equal, engine.motion(), self.last_motion)):
            raise RuntimeError(f"the bare loop of {self.name} went another way than the trial")
        engine.close()
        return elapsed


@contextmanager
def recording(name: str) -> Iterator[Recording]:
    """Record the trial that is run meanwhile."""
    made, engine_class = Recording(name), ENGINES[name]
    create, step = engine_class.__init__, engine_class.step

    def spy_create(self: Engine, scene: Scene, options: Model) -> None:
        made.scene, made.options = scene, options
        create(self, scene, options)

    def spy_step(self: Engine, joint_torque: Array, ball_force: Array) -> None:
        made.joint_torque.append(joint_torque.copy())
        made.ball_force.append(ball_force.copy())
        step(self, joint_torque, ball_force)
        made.last_motion = tuple(part.copy() for part in self.motion())

    with mock.patch.multiple(engine_class, __init__=spy_create, step=spy_step):
        yield made


def _mujoco_loop(engine: Any, joint_torque: Array, ball_force: Array) -> Callable[[], None]:
    model, data = engine._model, engine._data
    torque = data.qfrc_applied[engine._velocity_index]
    ball = engine._ball_force

    def loop() -> None:
        for torques, force in zip(joint_torque, ball_force, strict=True):
            torque[:] = torques
            ball[:] = force
            mujoco.mj_step(model, data)

    return loop


def _pybullet_loop(engine: Any, joint_torque: Array, ball_force: Array) -> Callable[[], None]:
    client, robot, ball, joints = engine._client, engine._robot, engine._ball, engine._joints
    torque_lists, force_lists = joint_torque.tolist(), ball_force.tolist()

    def loop() -> None:
        for torques, force in zip(torque_lists, force_lists, strict=True):
            pybullet.setJointMotorControlArray(
                robot, joints, pybullet.TORQUE_CONTROL, forces=torques, physicsClientId=client
            )
            # A force in world axes needs its point in world axes.
            center, _ = pybullet.getBasePositionAndOrientation(ball, client)
            pybullet.applyExternalForce(ball, -1, force, center, pybullet.WORLD_FRAME, client)
            pybullet.stepSimulation(client)
        engine._watch.velocity = pybullet.getBaseVelocity(ball, client)[0]  # which `step` would have kept

    return loop


def _dart_loop(engine: Any, joint_torque: Array, ball_force: Array) -> Callable[[], None]:
    world, robot, ball = engine._world, engine._robot, engine._ball_body
    forces = np.zeros((len(joint_torque), robot.getNumDofs()))
    forces[:, engine._joint_index] = joint_torque
    center = np.zeros(3)

    def loop() -> None:
        for torques, force in zip(forces, ball_force, strict=True):
            robot.setForces(torques)
            ball.addExtForce(force, center, False, True)
            world.step()

    return loop


def _ode_loop(engine: Any, joint_torque: Array, ball_force: Array) -> Callable[[], None]:
    world, timestep, contacts = engine._world, engine._scene.timestep, engine._contact_joints
    robot, fixed, ball, meet = engine._robot_space, engine._fixed_space, engine._ball_shape, engine._meet
    add_torque, add_force, touches = engine._robot.add_torque, engine._ball.addForce, engine._ball_touches
    torque_lists, force_lists = joint_torque.tolist(), ball_force.tolist()

    def loop() -> None:
        for torques, force in zip(torque_lists, force_lists, strict=True):
            for add, torque in zip(add_torque, torques, strict=True):
                add(torque)
            add_force(force)
            # ODE has no contacts of its own: `meet` makes them, as every user of ODE must.
            for one, other in ((robot, fixed), (ball, fixed), (ball, robot)):
                ode.collide2(one, other, None, meet)
            world.step(timestep)
            while touches:
                touches.pop()[0].setFeedback(False)
            contacts.empty()

    return loop


def _drake_loop(engine: Any, joint_torque: Array, ball_force: Array) -> Callable[[], None]:
    diagram, root, port = engine._diagram, engine._root, engine._port
    forces = np.zeros((len(joint_torque), len(engine._force)))
    forces[:, engine._torque_index], forces[:, engine._force_index] = joint_torque, ball_force

    def loop() -> None:
        for force in forces:
            port.GetMutableData().set_value(force)
            root.SetDiscreteState(diagram.EvalUniquePeriodicDiscreteUpdate(root))
        engine._state = root.get_discrete_state_vector().CopyToVector()  # which `step` would have kept

    return loop


def _sapien_loop(engine: Any, joint_torque: Array, ball_force: Array) -> Callable[[], None]:
    system, robot, ball, no_torque = engine._system, engine._robot, engine._ball, np.zeros(3)
    forces = np.zeros_like(joint_torque)
    forces[:, engine._joint_index] = joint_torque

    def loop() -> None:
        for torques, force in zip(forces, ball_force, strict=True):
            robot.set_qf(torques)
            ball.add_force_torque(force, no_torque)
            system.step()
        engine._watch.velocity = ball.get_linear_velocity().tolist()  # which `step` would have kept

    return loop


BARE_LOOPS: dict[str, Callable[[Any, Array, Array], Callable[[], None]]] = {
    "mujoco": _mujoco_loop,
    "pybullet": _pybullet_loop,
    "dart": _dart_loop,
    "ode": _ode_loop,
    "drake": _drake_loop,
    "sapien": _sapien_loop,
}
