"""DART as an `Engine`."""

import math
from typing import Any, Literal

import dartpy
import numpy as np
from pydantic import PositiveInt

from imolo.config.model import Positive
from imolo.contracts.engine import Array, BallContact, EngineOptions, EngineState, Scene
from imolo.contracts.urdf import RobotModel, read_urdf
from imolo.errors import BackendError, DivergenceError
from imolo_backends.engines.engine_checks import (
    FLOOR,
    base_rotation,
    check_links,
    check_scene,
    check_value,
    merge_touches,
)
from imolo_backends.simulation.simulated import simulated_plugin

BALL = "imolo_ball"
DETECTORS = {
    "dart": dartpy.collision.DARTCollisionDetector,
    "fcl": dartpy.collision.FCLCollisionDetector,
    "ode": dartpy.collision.OdeCollisionDetector,
}
FLOOR_SIZE = (100.0, 100.0, 2.0)  # [m] a box, since not every detector has planes


class DartOptions(EngineOptions):
    """Options of the DART engine.

    Attributes:
        friction: `cone` is Coulomb's, by non-smooth Gauss-Seidel; mirrored torques mirror the motion to 1 mm. `pyramid`
            is Dantzig's direct solver, two to three times as fast in contact and exactly symmetric, but at 45° a box
            slides 29 % less far than it should, and the hand is 13 mm from where the cone leads it.
        friction_sweeps: Most sweeps of the cone's solver over all contacts in a step. The hand is then within .5 mm of
            where 100 sweeps lead it.
        friction_tolerance: Residual at which the cone's solver stops earlier [-].
        collision_detector: DART's own is exact for spheres and boxes. FCL's and ODE's agree with it within .2 mm after
            a jump, Bullet's did not (60 mm) and is left out.
    """

    friction: Literal["cone", "pyramid"] = "cone"
    friction_sweeps: PositiveInt = 30
    friction_tolerance: Positive = 1e-6
    collision_detector: Literal["dart", "fcl", "ode"] = "dart"


class DartEngine:
    """One trial in DART."""

    def __init__(self, scene: Scene, options: DartOptions) -> None:
        robot = read_urdf(scene.urdf)
        check_scene(scene, robot)
        self._scene = scene
        world = self._world = dartpy.simulation.World()
        world.setTimeStep(scene.timestep)
        world.setGravity(scene.gravity)
        sleep = world.getDeactivationOptions()
        sleep.mEnabled = False
        world.setDeactivationOptions(sleep)
        constraints = world.getConstraintSolver()
        constraints.setCollisionDetector(DETECTORS[options.collision_detector]())
        if options.friction == "cone":
            direct = constraints.getBoxedLcpSolver()
            constraints.setBoxedLcpSolver(_cone_solver(options))
            # Takes over where the iterations fail; DART's own second choice, PGS, does not carry this robot.
            constraints.setSecondaryBoxedLcpSolver(direct)

        self._robot = _load_robot(scene)
        self._ball, self._ball_body = _make_ball(scene)
        world.addSkeleton(self._robot)
        world.addSkeleton(self._ball)
        # DART multiplies the restitutions of two bodies. The robot must bounce off the ball but not off the box, the
        # ball off both: so the ball has 1, and what is fixed is there twice, once for the robot and once for the ball.
        _set_contact(self._robot, scene.friction, scene.restitution)
        _set_contact(self._ball, scene.friction, 1.0)
        links = self._robot.getBodyNodes()
        self._add_fixed("robot", restitution=0.0, invisible_to=[self._ball_body])
        self._add_fixed("ball", restitution=scene.restitution, invisible_to=links)

        self._dofs = [self._robot.getDof(name).getIndexInSkeleton() for name in scene.joint_names]
        start = self._dofs[0] if self._dofs else 0
        contiguous = self._dofs == list(range(start, start + len(self._dofs)))
        self._joint_index: Any = slice(start, start + len(self._dofs)) if contiguous else np.array(self._dofs)
        self._force = np.zeros(self._robot.getNumDofs())
        # Frames that ride on the links: dartpy takes 0.3 µs to say where such a frame is, 4 µs for the link itself.
        self._link_frames = [
            dartpy.dynamics.SimpleFrame(self._robot.getBodyNode(name), name) for name in scene.link_names
        ]
        self._ball_offset = np.zeros(3)
        self._contacts: list[BallContact] = []
        self._motion: tuple[Array, Array, Array] | None = None
        self._steps = 0
        self._start()
        self._check(robot)

    def _add_fixed(self, partner: str, restitution: float, invisible_to: list[Any]) -> None:
        world, scene = self._world, self._scene
        no_contact = world.getConstraintSolver().getCollisionOption().collisionFilter
        half_floor = [0.5 * side for side in FLOOR_SIZE]
        boxes = [(FLOOR, (0.0, 0.0, -half_floor[2]), half_floor)]
        boxes += [(box.name, box.center, list(box.half_extents)) for box in scene.boxes]
        for name, center, half_extents in boxes:
            skeleton = _make_box(f"{name} for the {partner}", name, center, half_extents)
            _set_contact(skeleton, scene.friction, restitution)
            world.addSkeleton(skeleton)
            for body in invisible_to:
                no_contact.addBodyNodePairToBlackList(skeleton.getBodyNode(0), body)

    def _start(self) -> None:
        scene = self._scene
        root = self._robot.getRootJoint()
        if not scene.fixed_base:
            root.setTransform(_pose(scene.base_position, base_rotation(scene)))
            root.setLinearVelocity(scene.base_velocity)
            root.setAngularVelocity(scene.base_angular_velocity)
        for dof, angle in zip(self._dofs, scene.joint_angle, strict=True):
            self._robot.setPosition(dof, angle)
        self._ball.getRootJoint().setTransform(_pose(scene.ball.position, np.eye(3)))
        self._ball.getRootJoint().setLinearVelocity(scene.ball.velocity)

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        """See `Engine.step`."""
        # DART forgets torques and forces after every step.
        self._force[self._joint_index] = joint_torque
        self._robot.setForces(self._force)
        self._ball_body.addExtForce(ball_force, self._ball_offset, False, True)
        self._world.step()
        self._steps += 1
        self._motion = None
        # Cheaper than a look at the contact list, which always holds the feet.
        reaction = self._ball.getConstraintForces()
        if reaction[3] or reaction[4] or reaction[5]:
            self._collect_contacts()

    def motion(self) -> tuple[Array, Array, Array]:
        """See `Engine.motion`."""
        if self._motion is None:
            robot, index = self._robot, self._joint_index
            # Of the COM, which is the centre; `getLinearVelocity` says the same but costs five times as much.
            ball_velocity = self._ball_body.getCOMLinearVelocity()
            self._motion = robot.getPositions()[index], robot.getVelocities()[index], ball_velocity
        return self._motion

    def read(self) -> EngineState:
        """See `Engine.read`.

        Raises:
            DivergenceError: A torque is not finite, which DART would replace by no acceleration at all.
        """
        if not math.isfinite(sum(self._force.tolist())):
            joints = [
                n
                for n, dof in zip(self._scene.joint_names, self._dofs, strict=True)
                if not np.isfinite(self._force[dof])
            ]
            raise DivergenceError(f"torque of {joints} is not finite at {self._steps * self._scene.timestep:.4f} s")
        transforms = [frame.getWorldTransform() for frame in self._link_frames]
        poses = np.empty((len(transforms), 4, 4))
        for pose, transform in zip(poses, transforms, strict=True):
            pose[:] = transform.matrix()
        angle, velocity, ball_velocity = self.motion()
        contacts, self._contacts = tuple(self._contacts), []
        return EngineState(
            time=self._steps * self._scene.timestep,
            joint_angle=angle.copy(),
            joint_velocity=velocity.copy(),
            link_position=poses[:, :3, 3].copy(),
            link_rotation=poses[:, :3, :3].copy(),
            base_quaternion=transforms[0].quaternion().wxyz(),
            # The first three are the rotation.
            ball_position=self._ball.getPositions()[3:].copy(),
            ball_velocity=ball_velocity.copy(),
            ball_contacts=contacts,
        )

    def close(self) -> None:
        """See `Engine.close`; DART frees its memory with the object."""

    def _collect_contacts(self) -> None:
        touches = []
        for contact in self._world.getLastCollisionResult().getContacts():
            first, second = (
                side.getShapeFrame().getBodyNode().getName()
                for side in (contact.collisionObject1, contact.collisionObject2)
            )
            if BALL in (first, second):
                force = abs(float(contact.force @ contact.normal))
                touches.append((second if first == BALL else first, contact.point, force))
        self._contacts += merge_touches(self._steps * self._scene.timestep, touches)

    def _check(self, robot: RobotModel) -> None:
        scene, world = self._scene, self._world
        loaded = {}
        for node in self._robot.getBodyNodes():
            inertia = node.getInertia()
            loaded[node.getName()] = (inertia.getMass(), inertia.getLocalCOM(), inertia.getMoment())
        check_links(robot, loaded)
        check_value("timestep [s]", world.getTimeStep(), scene.timestep)
        check_value("gravity [m/s²]", world.getGravity(), scene.gravity)
        for number in range(world.getNumSkeletons()):
            for node in world.getSkeleton(number).getBodyNodes():
                for shape in node.getShapeNodes():
                    if shape.hasDynamicsAspect():
                        friction = shape.getDynamicsAspect().getFrictionCoeff()
                        check_value(f"friction of {shape.getName()} [-]", friction, scene.friction)
        ball = self._ball_body.getInertia()
        check_value("mass of the ball [kg]", ball.getMass(), scene.ball.mass)
        check_value("inertia of the ball [kg m²]", ball.getMoment(), scene.ball.inertia * np.eye(3))
        for name in scene.joint_names:
            joint, limits = self._robot.getJoint(name), robot.joints[name].limits
            resistance = (joint.getDampingCoefficient(0), joint.getCoulombFriction(0), joint.getSpringStiffness(0))
            check_value(f"damping, friction and spring of {name}", resistance, (0.0, 0.0, 0.0))
            if limits is not None:
                loaded_limits = (joint.getPositionLowerLimit(0), joint.getPositionUpperLimit(0))
                check_value(f"limits of {name} [rad]", loaded_limits, limits)
                check_value(f"{name} enforces its limits", float(joint.areLimitsEnforced()), 1.0)


def _cone_solver(options: DartOptions) -> Any:
    settings = dartpy.constraint.NsgsFrictionSolver.Options()
    settings.maxSweeps = options.friction_sweeps
    settings.tolerance = options.friction_tolerance
    return dartpy.constraint.NsgsFrictionSolver(settings)


def _pose(position: Any, rotation: Array) -> Any:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return dartpy.math.Isometry3(matrix)


def _load_robot(scene: Scene) -> Any:
    loader = dartpy.utils.DartLoader()
    root_type = dartpy.utils.DartLoaderRootJointType
    loader_options = loader.getOptions()
    loader_options.mDefaultRootJointType = root_type.FIXED if scene.fixed_base else root_type.FLOATING
    loader.setOptions(loader_options)
    robot = loader.parseSkeleton(str(scene.urdf))
    if robot is None:
        raise BackendError(f"DART cannot load {scene.urdf}")
    if scene.fixed_base:
        robot.getRootJoint().setTransformFromParentBodyNode(_pose(scene.base_position, base_rotation(scene)))
    robot.disableSelfCollisionCheck()
    for joint in robot.getJoints():
        joint.setLimitEnforcement(True)
    return robot


def _make_ball(scene: Scene) -> tuple[Any, Any]:
    skeleton = dartpy.dynamics.Skeleton(BALL)
    _, body = skeleton.createFreeJointAndBodyNodePair()
    body.setName(BALL)
    body.setInertia(dartpy.dynamics.Inertia(scene.ball.mass, np.zeros(3), scene.ball.inertia * np.eye(3)))
    _add_shape(body, dartpy.dynamics.SphereShape(scene.ball.radius))
    return skeleton, body


def _make_box(name: str, body_name: str, center: Any, half_extents: Any) -> Any:
    skeleton = dartpy.dynamics.Skeleton(name)
    joint, body = skeleton.createWeldJointAndBodyNodePair()
    body.setName(body_name)
    joint.setTransformFromParentBodyNode(_pose(center, np.eye(3)))
    _add_shape(body, dartpy.dynamics.BoxShape(2.0 * np.array(half_extents)))
    return skeleton


def _add_shape(body: Any, shape: Any) -> None:
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect()


def _set_contact(skeleton: Any, friction: float, restitution: float) -> None:
    for node in skeleton.getBodyNodes():
        for shape in node.getShapeNodes():
            if shape.hasDynamicsAspect():
                # DART takes the smaller friction coefficient of two bodies.
                shape.getDynamicsAspect().setFrictionCoeff(friction)
                shape.getDynamicsAspect().setRestitutionCoeff(restitution)


BACKEND = simulated_plugin(
    DartEngine,
    DartOptions,
    "DART: boxed LCP, exact friction cone",
    ingredients={
        "friction cone": ({"friction": "cone"}, {"friction": "pyramid"}),
        "solver": ({"friction_sweeps": 30}, {"friction_sweeps": 100}),
        "collision detection": ({"collision_detector": "dart"}, {"collision_detector": "fcl"}),
    },
)
