"""PyBullet as an `Engine`."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import PositiveInt

from imolo.config.model import Fraction, NonNegative, Searched
from imolo.conformance import Limitation
from imolo.contracts.engine import Array, EngineOptions
from imolo.contracts.urdf import RobotModel
from imolo.errors import BackendError
from imolo_backends.compiled import CFunction
from imolo_backends.engines.adapter import FLOOR, EngineAdapter, Loaded, Poses, Touch
from imolo_backends.engines.engine_checks import BallWatch, base_com_velocity, fill, link_rotations, turned_inertia
from imolo_backends.engines.pybullet_step import BASE, compiled, pybullet
from imolo_backends.simulation.simulated import simulated_plugin

BALL = "the ball"
# [-] Bullet multiplies the restitutions of two bodies. With this on everything but the ball, and its inverse times the
# wanted value on the ball, only the ball bounces; where the robot bounces as well, it is the root of its restitution.
BODY_RESTITUTION = 1e-4
# [rad/s, m/s] Bullet clamps every joint velocity at 100, the spin of a rolling ball among them.
VELOCITY_LIMIT = 1e6
TORQUE = pybullet.TORQUE_CONTROL


class PybulletOptions(EngineOptions):
    """Options of the PyBullet engine.

    Attributes:
        solver_iterations: Sweeps of the sequential impulse solver over all constraints.
        erp: Share of a joint's error removed per step [-].
        contact_erp: Share of a penetration removed per step [-]. Bullet adds that speed to a bounce: at its .2 a ball
            that should bounce with .80 bounces with up to 1.
        cone_friction: A pyramid instead of a cone loses 31 % of a slide at 45°.
        restitution_velocity: Slower impacts do not bounce [m/s].
    """

    solver_iterations: PositiveInt = 50
    erp: Fraction = 0.2
    contact_erp: Annotated[Fraction, Searched(0.001, 0.9)] = 0.005
    cone_friction: bool = True
    restitution_velocity: NonNegative = 0.05


class PybulletEngine(EngineAdapter):
    """One trial in PyBullet, in a physics server of its own."""

    _client = -1

    def load(self, urdf: Path, robot: RobotModel, options: PybulletOptions) -> Loaded:
        """See `EngineAdapter.load`."""
        scene, ball = self._scene, self._scene.ball
        self._client = pybullet.connect(pybullet.DIRECT)
        self._at = {"physicsClientId": self._client}
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=scene.timestep,
            numSolverIterations=options.solver_iterations,
            solverResidualThreshold=0.0,
            erp=options.erp,
            contactERP=options.contact_erp,
            contactSlop=0.0,  # its 10 µm would take .1 m/s from a bounce in a step of .1 ms
            enableConeFriction=int(options.cone_friction),
            restitutionVelocityThreshold=options.restitution_velocity,
            deterministicOverlappingPairs=1,
            **self._at,
        )
        pybullet.setGravity(*scene.gravity, **self._at)
        self._load_robot(urdf)
        self._names = {(self._robot, index): name for name, index in self._link_index.items()}
        self._names[self._add_body(pybullet.GEOM_PLANE), BASE] = FLOOR
        for box in scene.boxes:
            self._names[self._add_body(pybullet.GEOM_BOX, box.center, halfExtents=box.half_extents), BASE] = box.name
        self._ball = self._add_body(pybullet.GEOM_SPHERE, ball.position, ball.mass, radius=ball.radius)
        self._set_dynamics()
        self._set_start()
        self._links_without_base = [self._link_index[name] for name in scene.link_names[1:]]
        self._watch = BallWatch(scene)
        return self._loaded(robot)

    def _load_robot(self, urdf: Path) -> None:
        scene = self._scene
        flags = pybullet.URDF_USE_IMPLICIT_CYLINDER | pybullet.URDF_USE_INERTIA_FROM_FILE
        try:
            self._robot = pybullet.loadURDF(str(urdf), useFixedBase=scene.fixed_base, flags=flags, **self._at)
        except pybullet.error as error:
            raise BackendError(f"PyBullet cannot load {scene.urdf}: {error}") from error
        joints = range(pybullet.getNumJoints(self._robot, **self._at))
        infos = [pybullet.getJointInfo(self._robot, index, **self._at) for index in joints]
        self._link_index = {scene.link_names[0]: BASE} | {info[12].decode(): info[0] for info in infos}
        joint_index = {info[1].decode(): info[0] for info in infos}
        self._joints = [joint_index[name] for name in scene.joint_names]

    def _add_body(self, kind: int, position: Any = (0.0, 0.0, 0.0), mass: float = 0.0, **size: Any) -> int:
        shape = pybullet.createCollisionShape(kind, **size, **self._at)
        body: int = pybullet.createMultiBody(mass, shape, basePosition=position, **self._at)
        return body

    def _set_dynamics(self) -> None:
        scene, ball = self._scene, self._ball
        # Bullet multiplies the friction coefficients of two bodies, too.
        friction = float(np.sqrt(scene.friction))
        bounce = max(BODY_RESTITUTION, float(np.sqrt(scene.robot_restitution)))
        for body, link in [*self._names, (ball, BASE)]:
            change = partial(pybullet.changeDynamics, body, link, **self._at)
            restitution = scene.restitution / bounce if body == ball else bounce
            # Apart: PyBullet drops `lateralFriction` from a call that also sets damping or velocity limits.
            change(linearDamping=0.0, angularDamping=0.0, jointDamping=0.0)
            change(maxJointVelocity=VELOCITY_LIMIT)
            change(lateralFriction=friction, spinningFriction=0.0, rollingFriction=0.0, restitution=restitution)
            if body == ball or (body == self._robot and scene.robot_restitution > 0.0):
                # At small steps it would be stopped before it touches, and not bounce.
                change(contactProcessingThreshold=0.0)
        # Without `mass` Bullet would ignore the inertia.
        change(mass=scene.ball.mass, localInertiaDiagonal=[scene.ball.inertia] * 3)

    def _set_start(self) -> None:
        scene, robot = self._scene, self._robot
        # What Bullet calls the base's pose is that of its COM and principal axes.
        info = pybullet.getDynamicsInfo(robot, BASE, **self._at)
        self._base_from_com = pybullet.invertTransform(info[3], info[4])
        w, x, y, z = scene.base_quaternion
        pose = pybullet.multiplyTransforms(scene.base_position, (x, y, z, w), info[3], info[4])
        pybullet.resetBasePositionAndOrientation(robot, *pose, **self._at)
        if not scene.fixed_base:
            pybullet.resetBaseVelocity(robot, *base_com_velocity(scene, np.array(info[3])), **self._at)
        for joint, angle in zip(self._joints, scene.joint_angle, strict=True):
            pybullet.resetJointState(robot, joint, angle, 0.0, **self._at)
        if self._joints:
            # Every joint is born with a motor that holds it.
            joints, no_force = self._joints, [0.0] * len(self._joints)
            pybullet.setJointMotorControlArray(robot, joints, pybullet.VELOCITY_CONTROL, forces=no_force, **self._at)
        pybullet.resetBaseVelocity(self._ball, scene.ball.velocity, (0.0, 0.0, 0.0), **self._at)

    def advance(self, joint_torque: Array, ball_force: Array) -> bool:
        """See `EngineAdapter.advance`."""
        client, ball = self._client, self._ball
        # Bullet forgets torques and forces after every step.
        if self._joints:
            torque = joint_torque.tolist()
            pybullet.setJointMotorControlArray(self._robot, self._joints, TORQUE, forces=torque, physicsClientId=client)
        force = ball_force.tolist()
        if force != [0.0, 0.0, 0.0]:
            center, _ = pybullet.getBasePositionAndOrientation(ball, client)
            pybullet.applyExternalForce(ball, BASE, force, center, pybullet.WORLD_FRAME, client)
        pybullet.stepSimulation(client)
        return self._watch.touched(pybullet.getBaseVelocity(ball, client)[0], force)

    def compiled_advance(self) -> tuple[CFunction, Array, Array, Array] | None:
        """See `EngineAdapter.compiled_step`."""
        return compiled(self._client, self._robot, self._joints, self._ball, self._watch.changes, self._motion)

    def touches(self) -> Iterator[Touch]:
        """See `EngineAdapter.touches`."""
        # bodyA is the ball; 2 and 4 are bodyB and its link, 5 the position on the ball, 9 the normal force.
        for point in pybullet.getContactPoints(self._ball, **self._at):
            yield self._names[point[2], point[4]], point[5], point[9]

    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """See `EngineAdapter.write_motion`."""
        if self._joints:
            angles, velocities, *_ = zip(*pybullet.getJointStates(self._robot, self._joints, self._client), strict=True)
            fill(joint_angle, angles)
            fill(joint_velocity, velocities)
        fill(ball_velocity, self._watch.velocity)

    def poses(self) -> Poses:
        """See `EngineAdapter.poses`."""
        client = self._client
        pose = pybullet.getBasePositionAndOrientation(self._robot, client)
        positions, turns = ([part] for part in pybullet.multiplyTransforms(*pose, *self._base_from_com))
        if self._links_without_base:
            # Without computeForwardKinematics entries 4 and 5, the link frames, would be one step old.
            links = pybullet.getLinkStates(self._robot, self._links_without_base, 0, 1, client)
            positions += [link[4] for link in links]
            turns += [link[5] for link in links]
        x, y, z, w = turns[0]
        ball_position, _ = pybullet.getBasePositionAndOrientation(self._ball, client)
        return np.array(positions), link_rotations(np.array(turns)), np.array((w, x, y, z)), np.array(ball_position)

    def close(self) -> None:
        """See `Engine.close`."""
        if pybullet.isConnected(self._client):
            pybullet.disconnect(self._client)

    def _loaded(self, robot: RobotModel) -> Loaded:
        bodies, friction = {}, []
        for (body, link), name in [*self._names.items(), ((self._ball, BASE), BALL)]:
            info = pybullet.getDynamicsInfo(body, link, **self._at)
            bodies[name] = (info[0], info[3], turned_inertia(np.array(info[4]), np.array(info[2])))
            friction.append((name, info[1] ** 2))
        infos = [pybullet.getJointInfo(self._robot, index, **self._at) for index in self._joints]
        joints = dict(zip(self._scene.joint_names, infos, strict=True))
        engine = pybullet.getPhysicsEngineParameters(**self._at)
        return Loaded(
            links={name: bodies[name] for name in self._link_index},
            ball=bodies[BALL],
            gravity=[engine[f"gravityAcceleration{axis}"] for axis in "XYZ"],
            # Bullet has numbers for joints without limits as well.
            limits={name: info[8:10] for name, info in joints.items() if robot.joints[name].limits is not None},
            timestep=engine["fixedTimeStep"],
            friction=friction,
            resistance={name: info[6:8] for name, info in joints.items()},
        )


ALONG = ("distance", "distance at dt = 0", "direction")
LIMITATIONS = (
    Limitation(
        "Bullet's cone cuts the impulses that would stop the box's corners, which do not point against the slip",
        {"slide_30": ALONG, "slide_45": ALONG, "cone_or_pyramid": ("friction at 45° over friction at 0°",)},
    ),
)

BACKEND = simulated_plugin(
    PybulletEngine,
    PybulletOptions,
    summary="PyBullet: sequential impulses",
    limitations=LIMITATIONS,
    ingredients={
        "friction cone": ({"cone_friction": True}, {"cone_friction": False}),
        "contact stiffness": ({"contact_erp": 0.002}, {"contact_erp": 0.02}, {"contact_erp": 0.2}),
        "joint-limit model": ({"erp": 0.02}, {"erp": 0.2}, {"erp": 0.8}),
        "solver": ({"solver_iterations": 50}, {"solver_iterations": 500}),
    },
)
