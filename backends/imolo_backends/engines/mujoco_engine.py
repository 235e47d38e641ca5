"""MuJoCo as an `Engine`."""

from typing import Any, Literal

import mujoco
import numpy as np

from imolo.config.model import Positive
from imolo.conformance import Limitation
from imolo.contracts.engine import Array, BallContact, EngineOptions, EngineState, Scene
from imolo.contracts.urdf import RobotModel, read_urdf
from imolo.errors import BackendError
from imolo_backends.engines.engine_checks import (
    FLOOR,
    base_rotation,
    check_links,
    check_scene,
    check_value,
    merge_touches,
    turned_inertia,
)
from imolo_backends.simulation.simulated import simulated_plugin

BALL = "imolo_ball"
INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
}
CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
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
        ball_frequency: Natural frequency of the ball's contacts [rad/s]; their damping follows from the restitution.
    """

    integrator: Literal["euler", "implicitfast", "rk4"] = "euler"
    cone: Literal["elliptic", "pyramidal"] = "elliptic"
    impratio: Positive = 10.0
    solref: tuple[Positive, Positive] = (0.0005, 1.0)
    solref_limit: tuple[Positive, Positive] = (0.0005, 1.0)
    ball_frequency: Positive = 1000.0

    @property
    def integrator_order(self) -> int:
        """See `EngineOptions.integrator_order`."""
        return 4 if self.integrator == "rk4" else 1


class MujocoEngine:
    """One trial in MuJoCo."""

    def __init__(self, scene: Scene, options: MujocoOptions) -> None:
        robot = read_urdf(scene.urdf)
        check_scene(scene, robot)
        self._scene = scene
        try:
            self._model = _build(scene, options).compile()
        except ValueError as error:
            raise BackendError(f"MuJoCo cannot load {scene.urdf}: {error}") from error
        model, data = self._model, mujoco.MjData(self._model)
        self._data = data
        _check(model, scene, robot)

        joints = [model.joint(name) for name in scene.joint_names]
        angle_index = _slice_if_contiguous([joint.qposadr[0] for joint in joints])
        velocity_index = _slice_if_contiguous([joint.dofadr[0] for joint in joints])
        self._angle_index, self._velocity_index = angle_index, velocity_index
        # With a slice these are views into MuJoCo's memory, and `motion` costs nothing.
        self._ordered = isinstance(velocity_index, slice)
        self._torque_index = velocity_index
        ball_dof = model.body(BALL).dofadr[0]
        ball_angle = model.jnt_qposadr[model.body(BALL).jntadr[0]]
        self._applied = data.qfrc_applied
        self._ball_force = data.qfrc_applied[ball_dof : ball_dof + 3]
        self._ball_position = data.qpos[ball_angle : ball_angle + 3]
        self._ball_velocity = data.qvel[ball_dof : ball_dof + 3]
        self._ball_reaction = memoryview(data.qfrc_constraint)[ball_dof : ball_dof + 3]
        self._motion = (data.qpos[angle_index], data.qvel[velocity_index], self._ball_velocity)
        self._links = _slice_if_contiguous([model.body(name).id for name in scene.link_names])
        self._body_position, self._body_rotation = data.xpos, data.xmat.reshape(-1, 3, 3)
        self._base_quaternion = data.xquat[model.body(scene.link_names[0]).id]
        self._ball_geom = model.geom(BALL).id
        fixed = {FLOOR, *(box.name for box in scene.boxes)}
        self._geom_names = [
            geom.name if geom.name in fixed else model.body(geom.bodyid[0]).name
            for geom in map(model.geom, range(model.ngeom))
        ]
        self._contacts: list[BallContact] = []
        self._steps = 0
        self._start()

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

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        """See `Engine.step`."""
        self._applied[self._torque_index] = joint_torque
        self._ball_force[:] = ball_force
        mujoco.mj_step(self._model, self._data)
        self._steps += 1
        reaction = self._ball_reaction
        # Cheaper than a look at the contact list, which always holds the feet.
        if reaction[0] or reaction[1] or reaction[2]:
            self._collect_contacts()

    def motion(self) -> tuple[Array, Array, Array]:
        """See `Engine.motion`."""
        if self._ordered:
            return self._motion
        return self._data.qpos[self._angle_index], self._data.qvel[self._velocity_index], self._ball_velocity

    def read(self) -> EngineState:
        """See `Engine.read`."""
        model, data = self._model, self._data
        # After mj_step the link poses are one step older than the joint angles.
        mujoco.mj_kinematics(model, data)
        contacts, self._contacts = tuple(self._contacts), []
        angle, velocity, _ = self.motion()
        return EngineState(
            time=self._steps * self._scene.timestep,
            joint_angle=angle.copy(),
            joint_velocity=velocity.copy(),
            link_position=self._body_position[self._links].copy(),
            link_rotation=self._body_rotation[self._links].copy(),
            base_quaternion=self._base_quaternion.copy(),
            ball_position=self._ball_position.copy(),
            ball_velocity=self._ball_velocity.copy(),
            ball_contacts=contacts,
        )

    def close(self) -> None:
        """See `Engine.close`; MuJoCo frees its memory with the object."""

    def _collect_contacts(self) -> None:
        time = self._steps * self._scene.timestep
        wrench = np.zeros(6)
        touches = []
        for index, (first, second) in enumerate(self._data.contact.geom.tolist()):
            if self._ball_geom in (first, second):
                mujoco.mj_contactForce(self._model, self._data, index, wrench)
                other = self._geom_names[first if second == self._ball_geom else second]
                touches.append((other, self._data.contact.pos[index], float(wrench[0])))
        self._contacts += merge_touches(time, touches)


def damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a spring-damper contact that can only push and bounces with this restitution.

    A ratio of sin(a) bounces with exp(-(pi - 2 a) tan(a)); see Schwager and Pöschel, Granular Matter 9, 465 (2007).
    Below .135, which is critical damping, the ratio stays 1.
    """
    angle = np.linspace(0.0, 0.5 * np.pi, 2001)[:-1]
    bounce = np.exp(-(np.pi - 2.0 * angle) * np.tan(angle))
    return float(np.sin(np.interp(-restitution, -bounce, angle, right=0.5 * np.pi)))


def _build(scene: Scene, options: MujocoOptions) -> Any:
    spec = mujoco.MjSpec.from_file(str(scene.urdf))
    # Otherwise the base would become part of the world.
    spec.compiler.fusestatic = False
    spec.option.timestep = scene.timestep
    spec.option.gravity = scene.gravity
    spec.option.integrator = INTEGRATORS[options.integrator]
    spec.option.cone = CONES[options.cone]
    spec.option.impratio = options.impratio
    # A diverged state must be seen, not reset.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    for geom in spec.geoms:
        _set_contact(geom, ROBOT_MASK, scene.friction, options.solref)
    for joint in spec.joints:
        joint.solref_limit = options.solref_limit
    base = spec.body(scene.link_names[0])
    base.pos, base.quat = scene.base_position, scene.base_quaternion
    if not scene.fixed_base:
        base.add_freejoint()

    world = spec.worldbody
    floor = world.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(50.0, 50.0, 1.0))
    _set_contact(floor, FIXED_MASK, scene.friction, options.solref)
    for box in scene.boxes:
        geom = world.add_geom(name=box.name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=box.center, size=box.half_extents)
        _set_contact(geom, FIXED_MASK, scene.friction, options.solref)

    ball = scene.ball
    # Left out, `ipos` would be a copy of `pos` (4.0.1), far from the ball.
    body = world.add_body(
        name=BALL, pos=ball.position, mass=ball.mass, inertia=[ball.inertia] * 3, ipos=(0.0, 0.0, 0.0)
    )
    body.explicitinertial = True
    body.add_freejoint()
    geom = body.add_geom(name=BALL, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(ball.radius, 0.0, 0.0))
    # Ten steps per radian keep the explicit damper stable. Negative numbers are stiffness and damping per mass.
    frequency = min(options.ball_frequency, 0.2 / scene.timestep)
    damping = 2.0 * damping_ratio(scene.restitution) * frequency
    _set_contact(geom, BALL_MASK, scene.friction, (-(frequency**2), -damping))
    geom.priority = 1
    geom.solimp[:2] = 0.95
    return spec


def _set_contact(geom: Any, mask: tuple[int, int], friction: float, solref: tuple[float, float]) -> None:
    geom.contype, geom.conaffinity = mask
    geom.condim = 3
    geom.friction = (friction, 0.0, 0.0)
    geom.solref = solref


def _slice_if_contiguous(indices: list[int]) -> Any:
    start = indices[0] if indices else 0
    if indices == list(range(start, start + len(indices))):
        return slice(start, start + len(indices))
    return np.array(indices)


def _check(model: Any, scene: Scene, robot: RobotModel) -> None:
    bodies = [model.body(index) for index in range(1, model.nbody)]
    links = [body for body in bodies if body.name != BALL]
    inertia = {}
    for body in links:
        w, x, y, z = body.iquat
        inertia[body.name] = turned_inertia(np.array([x, y, z, w]), body.inertia)
    check_links(robot, {body.name: (float(body.mass[0]), body.ipos, inertia[body.name]) for body in links})
    check_value("timestep [s]", model.opt.timestep, scene.timestep)
    check_value("gravity [m/s²]", model.opt.gravity, scene.gravity)
    check_value("friction of the shapes [-]", model.geom_friction[:, 0], np.full(model.ngeom, scene.friction))
    check_value(
        "damping and friction of the joints", [model.dof_damping, model.dof_frictionloss], np.zeros((2, model.nv))
    )
    ball = model.body(BALL)
    check_value(
        "mass and inertia of the ball", [*ball.mass, *ball.inertia], [scene.ball.mass, *[scene.ball.inertia] * 3]
    )
    check_value("COM of the ball [m]", ball.ipos, np.zeros(3))
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_LIMIT:
        raise BackendError("joint limits are disabled in MuJoCo")
    for name in scene.joint_names:
        limits = robot.joints[name].limits
        check_value(f"{name} has a limit", float(model.joint(name).limited[0]), float(limits is not None))
        if limits is not None:
            check_value(f"limits of {name} [rad]", model.joint(name).range, limits)


ALONG = ("distance", "distance at dt = 0", "direction")
OFF_FLOOR = ("height off, at most", "turn, at most")
LIMITATIONS = (
    Limitation(
        "a soft contact, critically damped, gives back e⁻² = 0.14", {"restitution_asked": ("e got for 0 asked",)}
    ),
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
    "MuJoCo: soft contacts, elliptic friction cone",
    LIMITATIONS,
    ingredients={
        "integrator": ({"integrator": "implicitfast"}, {"integrator": "rk4"}),
        "friction cone": ({"cone": "elliptic"}, {"cone": "pyramidal"}),
        "friction stiffness": ({"impratio": 1.0}, {"impratio": 10.0}, {"impratio": 100.0}),
        "contact stiffness": ({"solref": (0.0005, 1.0)}, {"solref": (0.002, 1.0)}, {"solref": (0.02, 1.0)}),
        "joint-limit model": ({"solref_limit": (0.0005, 1.0)}, {"solref_limit": (0.002, 1.0)}),
    },
)
