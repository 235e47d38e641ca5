"""MuJoCo as an `Engine`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import mujoco
import numpy as np

from imolo.config.model import Positive, Searched
from imolo.conformance import Limitation
from imolo.contracts.engine import Array, EngineOptions, Scene
from imolo.contracts.urdf import RobotModel
from imolo.errors import BackendError
from imolo_backends.engines.adapter import FLOOR, EngineAdapter, Loaded, Poses, Touch
from imolo_backends.engines.engine_checks import base_rotation, joint_index, turned_inertia
from imolo_backends.engines.mujoco_bounce import bouncing_solref
from imolo_backends.simulation.simulated import simulated_plugin

BALL = "imolo_ball"
INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
}
CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
# A diverged state must be seen; the others look every step for what no scene has.
DISABLED = ("AUTORESET", "EQUALITY", "SPRING", "DAMPER", "EULERDAMP", "ACTUATION", "SENSOR", "MIDPHASE")
# Contact masks: the robot touches everything but itself, the ball touches everything.
ROBOT_MASK, FIXED_MASK, BALL_MASK = (1, 0), (0, 1), (1, 1)


class MujocoOptions(EngineOptions):
    """Options of the MuJoCo engine.

    Attributes:
        integrator: `euler` is semi-implicit; `rk4` evaluates every step four times.
        cone: `pyramidal` lets a box slide 41 % too far at 45°.
        impratio: Stiffness of friction relative to that of normal forces [-].
        solref: Time constant [s] and damping ratio [-] of the robot's contacts; MuJoCo raises the former to two
            timesteps. At its own .02 a ball at 10 m/s passes through the plate; at .002 the hand is 12 mm from where
            rigid contacts lead it.
        solref_limit: The same for joint limits. Softness here and in the contacts move the hand in opposite directions.
        ball_frequency: Natural frequency of the ball's contacts, and of the robot's where it bounces, in place of
            `solref` [rad/s]; their damping follows from the restitution.
    """

    integrator: Literal["euler", "implicitfast", "rk4"] = "euler"
    cone: Literal["elliptic", "pyramidal"] = "elliptic"
    impratio: Annotated[Positive, Searched(0.1, 1000.0)] = 10.0
    solref: tuple[Annotated[Positive, Searched(0.0005, 0.05)], Annotated[Positive, Searched(0.1, 3.0)]] = (0.0005, 1.0)
    solref_limit: tuple[Positive, Positive] = (0.0005, 1.0)
    ball_frequency: Positive = 1000.0

    @property
    def integrator_order(self) -> int:
        """See `EngineOptions.integrator_order`."""
        return 4 if self.integrator == "rk4" else 1


class MujocoEngine(EngineAdapter):
    """One trial in MuJoCo."""

    def load(self, urdf: Path, robot: RobotModel, options: MujocoOptions) -> Loaded:
        """See `EngineAdapter.load`."""
        scene = self._scene
        try:
            self._model = _build(scene, options, urdf).compile()
        except ValueError as error:
            raise BackendError(f"MuJoCo cannot load {scene.urdf}: {error}") from error
        model = self._model
        data = self._data = mujoco.MjData(model)

        joints = [model.joint(name) for name in scene.joint_names]
        self._angle_index = joint_index([joint.qposadr[0] for joint in joints])
        self._velocity_index = joint_index([joint.dofadr[0] for joint in joints])
        ball_dof = model.body(BALL).dofadr[0]
        ball_angle = model.jnt_qposadr[model.body(BALL).jntadr[0]]
        self._applied = data.qfrc_applied
        self._ball_force = data.qfrc_applied[ball_dof : ball_dof + 3]
        self._ball_position = data.qpos[ball_angle : ball_angle + 3]
        self._ball_velocity = data.qvel[ball_dof : ball_dof + 3]
        self._ball_reaction = memoryview(data.qfrc_constraint)[ball_dof : ball_dof + 3]
        self._views = isinstance(self._velocity_index, slice)
        if self._views:  # MuJoCo's own memory, so that `motion` costs nothing
            self._motion = (data.qpos[self._angle_index], data.qvel[self._velocity_index], self._ball_velocity)
        self._links = joint_index([model.body(name).id for name in scene.link_names])
        self._body_position, self._body_rotation = data.xpos, data.xmat.reshape(-1, 3, 3)
        self._base_quaternion = data.xquat[model.body(scene.link_names[0]).id]
        self._ball_geom = model.geom(BALL).id
        # What is fixed is a shape of the world, and shapes of links have no names.
        geoms = map(model.geom, range(model.ngeom))
        self._geom_names = [model.body(geom.bodyid[0]).name if geom.bodyid[0] else geom.name for geom in geoms]
        self._start()
        return _loaded(model, scene)

    def _start(self) -> None:
        scene, data = self._scene, self._data
        data.qpos[self._angle_index] = scene.joint_angle
        if not scene.fixed_base:
            base = self._model.body(scene.link_names[0])
            position, velocity = self._model.jnt_qposadr[base.jntadr[0]], base.dofadr[0]
            data.qpos[position : position + 3] = scene.base_position
            data.qpos[position + 3 : position + 7] = scene.base_quaternion
            data.qvel[velocity : velocity + 3] = scene.base_velocity
            # A free joint's angular velocity is in body axes, its linear velocity in world axes.
            data.qvel[velocity + 3 : velocity + 6] = base_rotation(scene).T @ np.array(scene.base_angular_velocity)
        self._ball_position[:] = scene.ball.position
        self._ball_velocity[:] = scene.ball.velocity

    def advance(self, joint_torque: Array, ball_force: Array) -> object:
        """See `EngineAdapter.advance`."""
        self._applied[self._velocity_index] = joint_torque
        self._ball_force[:] = ball_force
        mujoco.mj_step(self._model, self._data)
        return any(self._ball_reaction)  # cheaper than a look at the contact list, which always holds the feet

    def touches(self) -> Iterator[Touch]:
        """See `EngineAdapter.touches`."""
        wrench = np.zeros(6)
        for index, (first, second) in enumerate(self._data.contact.geom.tolist()):
            if self._ball_geom in (first, second):
                mujoco.mj_contactForce(self._model, self._data, index, wrench)
                other = self._geom_names[first if second == self._ball_geom else second]
                yield other, self._data.contact.pos[index], float(wrench[0])

    def motion(self) -> tuple[Array, Array, Array]:
        """See `Engine.motion`."""
        return self._motion if self._views else super().motion()

    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """See `EngineAdapter.write_motion`."""
        joint_angle[:], joint_velocity[:] = self._data.qpos[self._angle_index], self._data.qvel[self._velocity_index]
        ball_velocity[:] = self._ball_velocity

    def poses(self) -> Poses:
        """See `EngineAdapter.poses`."""
        # After mj_step the link poses are one step older than the joint angles.
        mujoco.mj_kinematics(self._model, self._data)
        links = self._links
        return self._body_position[links], self._body_rotation[links], self._base_quaternion, self._ball_position


def _build(scene: Scene, options: MujocoOptions, urdf: Path) -> Any:
    spec = mujoco.MjSpec.from_file(str(urdf))
    # Otherwise the base would become part of the world.
    spec.compiler.fusestatic = False
    spec.option.timestep = scene.timestep
    spec.option.gravity = scene.gravity
    spec.option.integrator = INTEGRATORS[options.integrator]
    spec.option.cone = CONES[options.cone]
    spec.option.impratio = options.impratio
    for name in DISABLED:
        spec.option.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")
    solref = options.solref
    if scene.robot_restitution > 0.0:
        solref = bouncing_solref(options.ball_frequency, scene.robot_restitution, scene.timestep)
    for geom in spec.geoms:
        _set_contact(geom, ROBOT_MASK, scene.friction, solref)
    for joint in spec.joints:
        joint.solref_limit = options.solref_limit
    base = spec.body(scene.link_names[0])
    base.pos, base.quat = scene.base_position, scene.base_quaternion
    if not scene.fixed_base:
        base.add_freejoint()

    world = spec.worldbody
    fixed = [world.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(50.0, 50.0, 1.0))]
    kind = mujoco.mjtGeom.mjGEOM_BOX
    fixed += [world.add_geom(name=box.name, type=kind, pos=box.center, size=box.half_extents) for box in scene.boxes]
    for geom in fixed:
        _set_contact(geom, FIXED_MASK, scene.friction, solref)
    ball = scene.ball
    # Left out, `ipos` would be a copy of `pos` (4.0.1), far from the ball.
    body = world.add_body(name=BALL, pos=ball.position, mass=ball.mass, inertia=[ball.inertia] * 3, ipos=[0.0] * 3)
    body.explicitinertial = True
    body.add_freejoint()
    geom = body.add_geom(name=BALL, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(ball.radius, 0.0, 0.0))
    _set_contact(
        geom, BALL_MASK, scene.friction, bouncing_solref(options.ball_frequency, scene.restitution, scene.timestep)
    )
    geom.priority = 1
    geom.solimp[:2] = 0.95
    return spec


def _set_contact(geom: Any, mask: tuple[int, int], friction: float, solref: tuple[float, float]) -> None:
    geom.contype, geom.conaffinity = mask
    geom.condim = 3
    geom.friction = (friction, 0.0, 0.0)
    geom.solref = solref


def _loaded(model: Any, scene: Scene) -> Loaded:
    bodies = {}
    for body in map(model.body, range(1, model.nbody)):
        inertia = turned_inertia(np.roll(body.iquat, -1), body.inertia)
        bodies[body.name] = (float(body.mass[0]), body.ipos, inertia)
    limited = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_LIMIT
    joints = map(model.joint, scene.joint_names)
    return Loaded(
        ball=bodies.pop(BALL),
        links=bodies,
        gravity=model.opt.gravity,
        limits={joint.name: joint.range for joint in joints if limited and joint.limited[0]},
        timestep=model.opt.timestep,
        friction=[(f"shape {number}", value) for number, value in enumerate(model.geom_friction[:, 0])],
        resistance={"the joints": [model.dof_damping, model.dof_frictionloss]},
    )


ALONG = ("distance", "distance at dt = 0", "direction")
OFF_FLOOR = ("height off, at most", "turn, at most")
LIMITATIONS = (
    Limitation("a soft contact, critically damped, gives back 0.14", {"restitution_asked": ("e got for 0 asked",)}),
    Limitation(
        "soft friction gives way a little beside the slip, for the contact's impedance is 0.9 to 0.95, not 1",
        {"slide_30": ALONG, "slide_45": ALONG, "cone_or_pyramid": ("friction at 45° over friction at 0°",)},
    ),
    Limitation(
        "slip lifts what slides off its soft contact: it hops",
        {
            "slide_0": OFF_FLOOR,
            "slide_30": OFF_FLOOR,
            "slide_45": OFF_FLOOR,
            "friction_asked": ("mu got for 0.2 asked", "mu got for 1.2 asked"),
            "slide_to_roll": ("speed while the solid ball slides", "speed while the hollow ball slides"),
        },
    ),
)

BACKEND = simulated_plugin(
    MujocoEngine,
    MujocoOptions,
    summary="MuJoCo: soft contacts, elliptic friction cone",
    limitations=LIMITATIONS,
    ingredients={
        "integrator": ({"integrator": "implicitfast"}, {"integrator": "rk4"}),
        "friction cone": ({"cone": "elliptic"}, {"cone": "pyramidal"}),
        "friction stiffness": ({"impratio": 1.0}, {"impratio": 10.0}, {"impratio": 100.0}),
        "contact stiffness": ({"solref": (0.0005, 1.0)}, {"solref": (0.002, 1.0)}, {"solref": (0.02, 1.0)}),
        "joint-limit model": ({"solref_limit": (0.0005, 1.0)}, {"solref_limit": (0.002, 1.0)}),
    },
)
