"""The loop one would write without us: an engine's own interface, stepped with what a trial applied."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
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

BareLoop = Callable[[slice], None]
"""Takes some of a trial's steps."""

ENGINES: dict[str, type[Any]] = {"mujoco": MujocoEngine, "pybullet": PybulletEngine, "dart": DartEngine}

if not BACKENDS.status("ode").problem:
    from imolo_backends.engines.ode_engine import OdeEngine, ode
    from imolo_backends.engines.ode_step import SLIDING, read_joints

    ENGINES["ode"] = OdeEngine


if not BACKENDS.status("drake").problem:
    from imolo_backends.engines.drake_engine import DrakeEngine
    from imolo_backends.engines.drake_shapes import DrakeShapes

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
        damped: By step: the speed of meeting [m/s] for which Drake's ball was damped in it.
    """

    name: str
    scene: Scene = field(init=False)
    options: Model = field(init=False)
    joint_torque: list[Array] = field(default_factory=list)
    ball_force: list[Array] = field(default_factory=list)
    last_motion: tuple[Array, ...] = ()
    damped: dict[int, float] = field(default_factory=dict)

    def lists(self) -> tuple[Any, Any]:
        """Return torques and forces as Python's numbers."""
        return np.array(self.joint_torque).tolist(), np.array(self.ball_force).tolist()

    def replay(self, steps: int) -> Array:
        """Return how long the bare loop takes for each so many steps [s].

        Raises:
            RuntimeError: It does not end where the trial ended.
        """
        engine = ENGINES[self.name](self.scene, self.options)
        loop = BARE_LOOPS[self.name](engine, self)
        times = [time.process_time()]
        for start in range(0, len(self.joint_torque), steps):
            loop(slice(start, start + steps))
            times.append(time.process_time())
        if not all(map(np.array_equal, engine.motion(), self.last_motion)):
            raise RuntimeError(f"the bare loop of {self.name} went another way than the trial")
        engine.close()
        return np.diff(times)


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

    with mock.patch.multiple(engine_class, __init__=spy_create, step=spy_step), ExitStack() as stack:
        if name == "drake":
            damp = DrakeShapes.damp_ball

            def spy_damp(self: DrakeShapes, context: Any, speed: float) -> None:
                made.damped[len(made.joint_torque) - 1] = speed
                damp(self, context, speed)

            stack.enter_context(mock.patch.object(DrakeShapes, "damp_ball", spy_damp))
        yield made


def _mujoco_loop(engine: Any, trial: Recording) -> BareLoop:
    model, data = engine._model, engine._data
    torque = data.qfrc_applied[engine._velocity_index]
    ball = engine._ball_force

    def loop(part: slice) -> None:
        for torques, force in zip(trial.joint_torque[part], trial.ball_force[part], strict=True):
            torque[:] = torques
            ball[:] = force
            mujoco.mj_step(model, data)

    return loop


def _pybullet_loop(engine: Any, trial: Recording) -> BareLoop:
    client, robot, ball, joints = engine._client, engine._robot, engine._ball, engine._joints
    torque_lists, force_lists = trial.lists()

    def loop(part: slice) -> None:
        for torques, force in zip(torque_lists[part], force_lists[part], strict=True):
            pybullet.setJointMotorControlArray(
                robot, joints, pybullet.TORQUE_CONTROL, forces=torques, physicsClientId=client
            )
            # A force in world axes needs its point in world axes.
            center, _ = pybullet.getBasePositionAndOrientation(ball, client)
            pybullet.applyExternalForce(ball, -1, force, center, pybullet.WORLD_FRAME, client)
            pybullet.stepSimulation(client)
        engine._watch.velocity = pybullet.getBaseVelocity(ball, client)[0]  # which `step` would have kept

    return loop


def _dart_loop(engine: Any, trial: Recording) -> BareLoop:
    world, robot, ball = engine._world, engine._robot, engine._ball_body
    forces = np.zeros((len(trial.joint_torque), robot.getNumDofs()))
    forces[:, engine._joint_index] = trial.joint_torque
    center = np.zeros(3)

    def loop(part: slice) -> None:
        for torques, force in zip(forces[part], trial.ball_force[part], strict=True):
            robot.setForces(torques)
            ball.addExtForce(force, center, False, True)
            world.step()

    return loop


def _ode_loop(engine: Any, trial: Recording) -> BareLoop:
    world, timestep, contacts = engine._world, engine._scene.timestep, ode.JointGroup()
    robot, fixed, ball = engine._robot_space, engine._fixed_space, engine._ball_shape
    meet = _ode_meet(engine._scene, engine._options, world, engine._ball, contacts)
    add_torque, add_force = [hinge.addTorque for hinge in engine._robot.hinges], engine._ball.addForce
    torque_lists, force_lists = trial.lists()

    def loop(part: slice) -> None:
        for torques, force in zip(torque_lists[part], force_lists[part], strict=True):
            for add, torque in zip(add_torque, torques, strict=True):
                add(torque)
            add_force(force)
            # ODE has no contacts of its own: `meet` makes them, as every user of ODE must.
            for one, other in ((robot, fixed), (ball, fixed), (ball, robot)):
                ode.collide2(one, other, None, meet)
            world.step(timestep)
            contacts.empty()
        read_joints(engine._robot.joints, engine._robot.offset, *engine.motion()[:2])  # which `step` would have done

    return loop


def _ode_meet(scene: Scene, options: Any, world: Any, ball: Any, group: Any) -> Callable[[None, Any, Any], None]:
    """Return what makes the contacts of two shapes, with the module's own interface and our default options."""
    fall = np.array(scene.gravity) * scene.timestep
    stopped, gravity = scene.friction * math.hypot(*fall), fall.tolist()

    def slide(first: Any, second: Any, position: Any, normal: Any) -> tuple[Any, float]:
        (one, other), sign = (first, second) if first else (second, first), -1.0 if first and second else 1.0
        vx, vy, vz = other.getPointVel(position) if other else gravity
        (x, y, z), (nx, ny, nz) = one.getPointVel(position), normal
        x, y, z = x + sign * vx, y + sign * vy, z + sign * vz
        closing = x * nx + y * ny + z * nz
        x, y, z = x - closing * nx, y - closing * ny, z - closing * nz
        speed = math.sqrt(x * x + y * y + z * z)
        return ((x / speed, y / speed, z / speed) if speed > SLIDING else None), speed

    def meet(_: None, first: Any, second: Any) -> None:
        contacts = ode.collide(first, second)
        bodies = first.getBody(), second.getBody()
        if len(contacts) > options.max_contacts:
            contacts.sort(key=lambda contact: -contact.getContactGeomParams()[2])
        for contact in contacts[: options.max_contacts]:
            mode = ode.ContactApprox1 | ode.ContactSoftERP
            contact.setMu(scene.friction)
            contact.setSoftERP(options.contact_erp)
            if ball in bodies:
                mode |= ode.ContactBounce
                contact.setBounce(scene.restitution)
                contact.setBounceVel(options.restitution_velocity)
            direction, speed = slide(*bodies, *contact.getContactGeomParams()[:2])
            if direction is not None:
                mode |= ode.ContactFDir1
                contact.setFDir1(direction)
                if speed > stopped:
                    mode |= ode.ContactMu2
                    contact.setMu2(0.0)
            contact.setMode(mode)
            ode.ContactJoint(world, group, contact).attach(*bodies)

    return meet


def _drake_loop(engine: Any, trial: Recording) -> BareLoop:
    diagram, root, port = engine._diagram, engine._root, engine._port
    forces = np.zeros((len(trial.joint_torque), len(engine._force)))
    forces[:, engine._torque_index], forces[:, engine._force_index] = trial.joint_torque, trial.ball_force

    def loop(part: slice) -> None:
        for number, force in enumerate(forces[part], start=part.start):
            if number in trial.damped:
                engine._shapes.damp_ball(engine._graph.GetMyMutableContextFromRoot(root), trial.damped[number])
            port.GetMutableData().set_value(force)
            root.SetDiscreteState(diagram.EvalUniquePeriodicDiscreteUpdate(root))
        engine._state = root.get_discrete_state_vector().CopyToVector()  # which `step` would have kept

    return loop


def _sapien_loop(engine: Any, trial: Recording) -> BareLoop:
    system, robot, ball, no_torque = engine._system, engine._robot, engine._ball, np.zeros(3)
    forces = np.zeros_like(trial.joint_torque)
    forces[:, engine._joint_index] = trial.joint_torque

    def loop(part: slice) -> None:
        for torques, force in zip(forces[part], trial.ball_force[part], strict=True):
            robot.set_qf(torques)
            ball.add_force_torque(force, no_torque)
            system.step()
        engine._watch.velocity = ball.get_linear_velocity().tolist()  # which `step` would have kept

    return loop


BARE_LOOPS: dict[str, Callable[[Any, Recording], BareLoop]] = {
    "mujoco": _mujoco_loop,
    "pybullet": _pybullet_loop,
    "dart": _dart_loop,
    "ode": _ode_loop,
    "drake": _drake_loop,
    "sapien": _sapien_loop,
}
