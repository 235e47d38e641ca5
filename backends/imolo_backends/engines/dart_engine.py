"""DART as an `Engine`."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import dartpy
import numpy as np
from pydantic import PositiveInt

from imolo.config.model import Positive
from imolo.contracts.engine import Array, BoxShape, EngineOptions
from imolo.contracts.urdf import RobotModel
from imolo.errors import BackendError, DivergenceError
from imolo_backends.compiled import CFunction, c_function
from imolo_backends.engines import dart_step
from imolo_backends.engines.adapter import FLOOR, EngineAdapter, Loaded, Poses, Touch
from imolo_backends.engines.dart_model import add_body, held, load_robot, pose, set_contact, shapes
from imolo_backends.engines.engine_checks import base_rotation, joint_index
from imolo_backends.simulation.simulated import simulated_plugin

BALL = "imolo_ball"
DETECTORS = {"dart": "DART", "fcl": "FCL", "ode": "Ode"}  # as dartpy writes them
FLOOR_BOX = BoxShape(FLOOR, (0.0, 0.0, -1.0), (50.0, 50.0, 1.0))  # since not every detector has planes


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


class DartEngine(EngineAdapter):
    """One trial in DART."""

    def load(self, urdf: Path, robot: RobotModel, options: DartOptions) -> Loaded:
        """See `EngineAdapter.load`."""
        scene = self._scene
        meshes = [name for name, link in robot.links.items() if any(shape.mesh for shape in link.collisions)]
        if meshes and options.collision_detector == "fcl":
            raise BackendError(f"DART's FCL lets bodies through meshes, which {meshes} are; use the detector 'dart'")
        world = self._world = dartpy.simulation.World()
        world.setTimeStep(scene.timestep)
        world.setGravity(scene.gravity)
        sleep = world.getDeactivationOptions()
        sleep.mEnabled = False
        world.setDeactivationOptions(sleep)
        constraints = world.getConstraintSolver()
        detector = f"{DETECTORS[options.collision_detector]}CollisionDetector"
        constraints.setCollisionDetector(getattr(dartpy.collision, detector)())
        if options.friction == "cone":
            settings = dartpy.constraint.NsgsFrictionSolver.Options()
            settings.maxSweeps, settings.tolerance = options.friction_sweeps, options.friction_tolerance
            direct = constraints.getBoxedLcpSolver()
            constraints.setBoxedLcpSolver(dartpy.constraint.NsgsFrictionSolver(settings))
            # Takes over where the iterations fail; DART's own second choice, PGS, does not carry this robot.
            constraints.setSecondaryBoxedLcpSolver(direct)

        self._robot = load_robot(scene, urdf)
        world.addSkeleton(self._robot)
        ball = dartpy.dynamics.SphereShape(scene.ball.radius)
        self._ball, self._ball_body = add_body(world, BALL, BALL, "Free", ball)
        inertia = scene.ball.inertia * np.eye(3)
        self._ball_body.setInertia(dartpy.dynamics.Inertia(scene.ball.mass, np.zeros(3), inertia))
        # DART multiplies the restitutions of two bodies, none of which may exceed 1. Robot and ball bounce off the box
        # in their own ways: so what is fixed is there twice, once for the robot and once for the ball.
        most = max(scene.restitution, scene.robot_restitution) or 1.0
        set_contact(self._robot, scene.friction, most)
        set_contact(self._ball, scene.friction, scene.restitution / most)
        links = self._robot.getBodyNodes()
        self._add_fixed("robot", restitution=scene.robot_restitution / most, invisible_to=[self._ball_body])
        self._add_fixed("ball", restitution=most, invisible_to=links)

        self._dofs = [self._robot.getDof(name).getIndexInSkeleton() for name in scene.joint_names]
        self._joint_index: Any = joint_index(self._dofs)
        self._force = np.zeros(self._robot.getNumDofs())
        self._torque = np.zeros(len(self._dofs))  # of the last step
        # Frames that ride on the links: dartpy takes 0.3 µs to say where such a frame is, 4 µs for the link itself.
        self._link_frames = [dartpy.dynamics.SimpleFrame(self._robot.getBodyNode(n), n) for n in scene.link_names]
        self._ball_offset = np.zeros(3)
        self._start()
        return self._loaded()

    def _add_fixed(self, partner: str, restitution: float, invisible_to: list[Any]) -> None:
        world, scene = self._world, self._scene
        no_contact = world.getConstraintSolver().getCollisionOption().collisionFilter
        for box in (FLOOR_BOX, *scene.boxes):
            shape = dartpy.dynamics.BoxShape(2.0 * np.array(box.half_extents))
            skeleton, body = add_body(world, f"{box.name} for the {partner}", box.name, "Weld", shape)
            skeleton.getRootJoint().setTransformFromParentBodyNode(pose(box.center, np.eye(3)))
            set_contact(skeleton, scene.friction, restitution)
            for other in invisible_to:
                no_contact.addBodyNodePairToBlackList(body, other)

    def _start(self) -> None:
        scene = self._scene
        root = self._robot.getRootJoint()
        if not scene.fixed_base:
            root.setTransform(pose(scene.base_position, base_rotation(scene)))
            root.setLinearVelocity(scene.base_velocity)
            root.setAngularVelocity(scene.base_angular_velocity)
        for dof, angle in zip(self._dofs, scene.joint_angle, strict=True):
            self._robot.setPosition(dof, angle)
        self._ball.getRootJoint().setTransform(pose(scene.ball.position, np.eye(3)))
        self._ball.getRootJoint().setLinearVelocity(scene.ball.velocity)

    def advance(self, joint_torque: Array, ball_force: Array) -> object:
        """See `EngineAdapter.advance`."""
        # DART forgets torques and forces after every step.
        self._torque = self._force[self._joint_index] = joint_torque
        self._robot.setForces(self._force)
        self._ball_body.addExtForce(ball_force, self._ball_offset, False, True)
        self._world.step()
        # Cheaper than a look at the contact list, which always holds the feet.
        reaction = self._ball.getConstraintForces()
        return reaction[3] or reaction[4] or reaction[5]

    def compiled_advance(self) -> tuple[CFunction, Array, Array, Array] | None:
        """See `EngineAdapter.compiled_step`."""
        found = dart_step.addresses(self._world, self._robot, self._dofs, self._ball_body)
        if found is None:
            return None
        acting = self._torque, np.zeros(3)
        function = c_function(dart_step.step, found.ids, *self._motion, *acting, self._ball_offset)
        return function, *acting, found.ball_impulse

    def touches(self) -> Iterator[Touch]:
        """See `EngineAdapter.touches`."""
        for contact in self._world.getLastCollisionResult().getContacts():
            sides = (contact.collisionObject1, contact.collisionObject2)
            first, second = (side.getShapeFrame().getBodyNode().getName() for side in sides)
            if BALL in (first, second):
                force = abs(float(contact.force @ contact.normal))
                yield second if first == BALL else first, contact.point, force

    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """See `EngineAdapter.write_motion`."""
        joint_angle[:] = self._robot.getPositions()[self._joint_index]
        joint_velocity[:] = self._robot.getVelocities()[self._joint_index]
        # Of the COM, which is the centre; `getLinearVelocity` says the same but costs five times as much.
        ball_velocity[:] = self._ball_body.getCOMLinearVelocity()

    def poses(self) -> Poses:
        """See `EngineAdapter.poses`.

        Raises:
            DivergenceError: A torque is not finite, which DART would replace by no acceleration at all.
        """
        if not math.isfinite(sum(self._torque.tolist())):
            torques = zip(self._scene.joint_names, self._torque, strict=True)
            joints = [name for name, torque in torques if not np.isfinite(torque)]
            raise DivergenceError(f"torque of {joints} is not finite at {self.time:.4f} s")
        transforms = [frame.getWorldTransform() for frame in self._link_frames]
        poses = np.array([transform.matrix() for transform in transforms])
        # Of the ball, the first three are the rotation.
        ball_position = self._ball.getPositions()[3:]
        return poses[:, :3, 3], poses[:, :3, :3], transforms[0].quaternion().wxyz(), ball_position

    def _loaded(self) -> Loaded:
        world, joints = self._world, {name: self._robot.getJoint(name) for name in self._scene.joint_names}
        parts = [shape for number in range(world.getNumSkeletons()) for shape in shapes(world.getSkeleton(number))]
        limits = {n: (j.getPositionLowerLimit(0), j.getPositionUpperLimit(0)) for n, j in joints.items()}
        return Loaded(
            links={node.getName(): held(node) for node in self._robot.getBodyNodes()},
            ball=held(self._ball_body),
            gravity=world.getGravity(),
            limits={n: limits[n] for n, j in joints.items() if np.isfinite(limits[n][0]) and j.areLimitsEnforced()},
            timestep=world.getTimeStep(),
            friction=[(s.getName(), s.getDynamicsAspect().getFrictionCoeff()) for s in parts],
            resistance={
                name: (joint.getDampingCoefficient(0), joint.getCoulombFriction(0), joint.getSpringStiffness(0))
                for name, joint in joints.items()
            },
        )


BACKEND = simulated_plugin(
    DartEngine,
    DartOptions,
    summary="DART: boxed LCP, exact friction cone",
    ingredients={
        "friction cone": ({"friction": "cone"}, {"friction": "pyramid"}),
        "solver": ({"friction_sweeps": 30}, {"friction_sweeps": 100}),
        "collision detection": ({"collision_detector": "dart"}, {"collision_detector": "fcl"}),
    },
)
