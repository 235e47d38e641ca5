"""PyBullet as an `Engine`."""

import numpy as np
from numba import njit
from pydantic import PositiveInt

from imolo.config.model import Fraction, NonNegative
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
    rotation_matrices,
    turned_inertia,
)
from imolo_backends.engines.quiet_import import import_quietly
from imolo_backends.simulation.simulated import simulated_plugin

pybullet = import_quietly("pybullet")  # it prints its build time

BASE = -1
# [-] Bullet multiplies the restitutions of two bodies. With this on everything but the ball, and its inverse times the
# wanted value on the ball, only the ball bounces.
BODY_RESTITUTION = 1e-4
# [rad/s, m/s] Bullet clamps every joint velocity at 100, the spin of a rolling ball among them.
VELOCITY_LIMIT = 1e6
UNTOUCHED = 1e-9  # [m/s] rounding of the ball's velocity in a step, with a wide margin; 1e-7 N would do more
# Compiled, since NumPy would take 20 µs at every `read`.
ROTATION_MATRICES = njit(cache=True)(rotation_matrices)


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
    contact_erp: Fraction = 0.005
    cone_friction: bool = True
    restitution_velocity: NonNegative = 0.05


class PybulletEngine:
    """One trial in PyBullet, in a physics server of its own."""

    def __init__(self, scene: Scene, options: PybulletOptions) -> None:
        robot = read_urdf(scene.urdf)
        check_scene(scene, robot)
        self._scene = scene
        self._client = pybullet.connect(pybullet.DIRECT)
        try:
            self._load(options)
            self._check(robot)
        except BaseException:
            self.close()
            raise
        self._links_without_base = [self._link_index[name] for name in scene.link_names[1:]]
        self._contacts: list[BallContact] = []
        joints = len(scene.joint_names)
        self._motion = np.zeros(joints), np.zeros(joints), np.zeros(3)
        self._motion_is_old = True
        self._ball_velocity: tuple[float, float, float] = scene.ball.velocity
        self._gain = scene.timestep / scene.ball.mass  # [s/kg]
        self._fall = [g * scene.timestep for g in scene.gravity]  # [m/s] in a step
        self._steps = 0

    def _load(self, options: PybulletOptions) -> None:
        scene, client = self._scene, self._client
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=scene.timestep,
            numSubSteps=0,
            numSolverIterations=options.solver_iterations,
            solverResidualThreshold=0.0,
            erp=options.erp,
            contactERP=options.contact_erp,
            contactSlop=0.0,  # its 10 µm would take .1 m/s from a bounce in a step of .1 ms
            enableConeFriction=int(options.cone_friction),
            restitutionVelocityThreshold=options.restitution_velocity,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        pybullet.setGravity(*scene.gravity, physicsClientId=client)
        flags = pybullet.URDF_USE_IMPLICIT_CYLINDER | pybullet.URDF_USE_INERTIA_FROM_FILE
        try:
            self._robot = pybullet.loadURDF(
                str(scene.urdf), useFixedBase=scene.fixed_base, flags=flags, physicsClientId=client
            )
        except pybullet.error as error:
            raise BackendError(f"PyBullet cannot load {scene.urdf}: {error}") from error
        self._link_index = {scene.link_names[0]: BASE}
        joint_index = {}
        for index in range(pybullet.getNumJoints(self._robot, physicsClientId=client)):
            info = pybullet.getJointInfo(self._robot, index, physicsClientId=client)
            joint_index[info[1].decode()] = index
            self._link_index[info[12].decode()] = index
        missing = [name for name in scene.joint_names if name not in joint_index]
        if missing:
            raise BackendError(f"joints {missing} are missing in PyBullet; it has {sorted(joint_index)}")
        self._joints = [joint_index[name] for name in scene.joint_names]

        self._names = {(self._robot, index): name for name, index in self._link_index.items()}
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        floor = pybullet.createMultiBody(0.0, plane, physicsClientId=client)
        self._names[floor, BASE] = FLOOR
        for box in scene.boxes:
            shape = pybullet.createCollisionShape(
                pybullet.GEOM_BOX, halfExtents=box.half_extents, physicsClientId=client
            )
            self._names[pybullet.createMultiBody(0.0, shape, basePosition=box.center, physicsClientId=client), BASE] = (
                box.name
            )
        ball = scene.ball
        sphere = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=ball.radius, physicsClientId=client)
        self._ball = pybullet.createMultiBody(ball.mass, sphere, basePosition=ball.position, physicsClientId=client)
        self._set_dynamics()
        self._set_start()

    def _set_dynamics(self) -> None:
        scene, client, ball = self._scene, self._client, self._ball
        # Apart from friction: PyBullet drops `lateralFriction` from a call that also sets damping or velocity limits.
        for body, link in [*self._names, (ball, BASE)]:
            pybullet.changeDynamics(
                body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=client
            )
            pybullet.changeDynamics(body, link, maxJointVelocity=VELOCITY_LIMIT, physicsClientId=client)
        # Without `mass` Bullet would ignore the inertia.
        pybullet.changeDynamics(
            ball, BASE, mass=scene.ball.mass, localInertiaDiagonal=[scene.ball.inertia] * 3, physicsClientId=client
        )
        # At small steps a ball would be stopped before it touches, and not bounce.
        pybullet.changeDynamics(ball, BASE, contactProcessingThreshold=0.0, physicsClientId=client)
        # Bullet multiplies the friction coefficients of two bodies, too.
        friction = float(np.sqrt(scene.friction))
        for body, link in [*self._names, (ball, BASE)]:
            restitution = scene.restitution / BODY_RESTITUTION if body == ball else BODY_RESTITUTION
            pybullet.changeDynamics(
                body,
                link,
                lateralFriction=friction,
                spinningFriction=0.0,
                rollingFriction=0.0,
                restitution=restitution,
                physicsClientId=client,
            )

    def _set_start(self) -> None:
        scene, client = self._scene, self._client
        # What Bullet calls the base's pose is that of its COM and principal axes.
        info = pybullet.getDynamicsInfo(self._robot, BASE, physicsClientId=client)
        self._base_from_com = pybullet.invertTransform(info[3], info[4])
        w, x, y, z = scene.base_quaternion
        pose = pybullet.multiplyTransforms(scene.base_position, (x, y, z, w), info[3], info[4])
        pybullet.resetBasePositionAndOrientation(self._robot, *pose, physicsClientId=client)
        spin = np.array(scene.base_angular_velocity)
        velocity = np.array(scene.base_velocity) + np.cross(spin, base_rotation(scene) @ np.array(info[3]))
        if not scene.fixed_base:
            pybullet.resetBaseVelocity(self._robot, velocity.tolist(), spin.tolist(), physicsClientId=client)
        for joint, angle in zip(self._joints, scene.joint_angle, strict=True):
            pybullet.resetJointState(self._robot, joint, angle, 0.0, physicsClientId=client)
        if self._joints:
            # Every joint is born with a motor that holds it.
            pybullet.setJointMotorControlArray(
                self._robot,
                self._joints,
                pybullet.VELOCITY_CONTROL,
                forces=[0.0] * len(self._joints),
                physicsClientId=client,
            )
        pybullet.resetBaseVelocity(self._ball, scene.ball.velocity, (0.0, 0.0, 0.0), physicsClientId=client)

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        """See `Engine.step`."""
        client, ball = self._client, self._ball
        # Bullet forgets torques and forces after every step.
        if self._joints:
            pybullet.setJointMotorControlArray(
                self._robot, self._joints, pybullet.TORQUE_CONTROL, forces=joint_torque.tolist(), physicsClientId=client
            )
        force = ball_force.tolist()
        if force != [0.0, 0.0, 0.0]:
            center, _ = pybullet.getBasePositionAndOrientation(ball, client)
            pybullet.applyExternalForce(ball, BASE, force, center, pybullet.WORLD_FRAME, client)
        pybullet.stepSimulation(client)
        self._steps += 1
        self._motion_is_old = True
        before = self._ball_velocity
        self._ball_velocity = after = pybullet.getBaseVelocity(ball, client)[0]
        # What touches the ball adds to what force and gravity do; looking for contacts at every step would cost more.
        gain, fall = self._gain, self._fall
        touched = (
            abs(after[0] - before[0] - force[0] * gain - fall[0])
            + abs(after[1] - before[1] - force[1] * gain - fall[1])
            + abs(after[2] - before[2] - force[2] * gain - fall[2])
        )
        if touched > UNTOUCHED:
            self._collect_contacts()

    def _collect_contacts(self) -> None:
        # bodyA is the ball; 2 and 4 are bodyB and its link, 5 the position on the ball, 9 the normal force.
        points = pybullet.getContactPoints(self._ball, physicsClientId=self._client)
        touches = [(self._names[p[2], p[4]], p[5], p[9]) for p in points]
        self._contacts += merge_touches(self._steps * self._scene.timestep, touches)

    def motion(self) -> tuple[Array, Array, Array]:
        """See `Engine.motion`."""
        angle, velocity, ball_velocity = self._motion
        if self._motion_is_old:
            client = self._client
            if self._joints:
                angle[:], velocity[:], _, _ = zip(
                    *pybullet.getJointStates(self._robot, self._joints, client), strict=True
                )
            ball_velocity[:] = self._ball_velocity
            self._motion_is_old = False
        return self._motion

    def read(self) -> EngineState:
        """See `Engine.read`."""
        client = self._client
        pose = pybullet.getBasePositionAndOrientation(self._robot, client)
        positions, turns = ([part] for part in pybullet.multiplyTransforms(*pose, *self._base_from_com))
        if self._links_without_base:
            # Without computeForwardKinematics entries 4 and 5, the link frames, would be one step old.
            for link in pybullet.getLinkStates(
                self._robot, self._links_without_base, computeForwardKinematics=1, physicsClientId=client
            ):
                positions.append(link[4])
                turns.append(link[5])
        x, y, z, w = turns[0]
        angle, velocity, ball_velocity = self.motion()
        contacts, self._contacts = tuple(self._contacts), []
        return EngineState(
            time=self._steps * self._scene.timestep,
            joint_angle=angle.copy(),
            joint_velocity=velocity.copy(),
            link_position=np.array(positions),
            link_rotation=ROTATION_MATRICES(np.array(turns)),
            base_quaternion=np.array((w, x, y, z)),
            ball_position=np.array(pybullet.getBasePositionAndOrientation(self._ball, client)[0]),
            ball_velocity=ball_velocity.copy(),
            ball_contacts=contacts,
        )

    def close(self) -> None:
        """See `Engine.close`."""
        if self._client >= 0:
            pybullet.disconnect(self._client)
            self._client = -1

    def _check(self, robot: RobotModel) -> None:
        scene, client = self._scene, self._client
        loaded = {}
        for name, index in self._link_index.items():
            info = pybullet.getDynamicsInfo(self._robot, index, physicsClientId=client)
            loaded[name] = (info[0], np.array(info[3]), turned_inertia(np.array(info[4]), np.array(info[2])))
        if scene.fixed_base:
            # Welded to the world, the base has no mass in Bullet.
            base = robot.links[robot.base]
            loaded[robot.base] = (base.mass, base.com, base.inertia)
        check_links(robot, loaded)
        for (body, link), name in [*self._names.items(), ((self._ball, BASE), "ball")]:
            info = pybullet.getDynamicsInfo(body, link, physicsClientId=client)
            check_value(f"friction of {name} [-]", info[1] ** 2, scene.friction)
        check_value("mass of the ball [kg]", info[0], scene.ball.mass)
        check_value("inertia of the ball [kg m²]", info[2], [scene.ball.inertia] * 3)
        engine = pybullet.getPhysicsEngineParameters(physicsClientId=client)
        check_value("timestep [s]", engine["fixedTimeStep"], scene.timestep)
        gravity = [engine[f"gravityAcceleration{axis}"] for axis in "XYZ"]
        check_value("gravity [m/s²]", gravity, scene.gravity)
        for name, index in zip(scene.joint_names, self._joints, strict=True):
            info = pybullet.getJointInfo(self._robot, index, physicsClientId=client)
            check_value(f"damping and friction of {name}", info[6:8], (0.0, 0.0))
            limits = robot.joints[name].limits
            if limits is not None:
                check_value(f"limits of {name} [rad]", info[8:10], limits)


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
    "PyBullet: sequential impulses",
    LIMITATIONS,
    ingredients={
        "friction cone": ({"cone_friction": True}, {"cone_friction": False}),
        "contact stiffness": ({"contact_erp": 0.002}, {"contact_erp": 0.02}, {"contact_erp": 0.2}),
        "joint-limit model": ({"erp": 0.02}, {"erp": 0.2}, {"erp": 0.8}),
        "solver": ({"solver_iterations": 50}, {"solver_iterations": 500}),
    },
)
