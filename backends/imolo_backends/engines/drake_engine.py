"""Drake as an `Engine`."""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import RigidBody, SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder

from imolo.config.model import NonNegative, Positive
from imolo.conformance import Limitation
from imolo.contracts.engine import Array, EngineOptions
from imolo.contracts.urdf import RobotModel
from imolo.errors import BackendError, DivergenceError
from imolo_backends.engines.adapter import Body, EngineAdapter, Loaded, Poses, Touch
from imolo_backends.engines.drake_shapes import DrakeShapes
from imolo_backends.engines.engine_checks import BallWatch, base_rotation, joint_index
from imolo_backends.simulation.simulated import simulated_plugin

BALL = "imolo_ball"

logging.getLogger("drake").setLevel(logging.ERROR)  # it warns that half spaces do not touch what is deformable


class DrakeOptions(EngineOptions):
    """Options of the Drake engine.

    Attributes:
        friction: `lagged` bounds the friction of a step by the normal force at its beginning, so that a contact begins
            with a step without friction. `similar` and `sap` have none of that, but throw up by mu v what starts to
            slide with v: a box at 1 m/s hops 12 mm.
        contact_time: Time constant of the robot's contacts [s], at least ten timesteps. At five the lag of the friction
            costs the hand another 6 mm.
        dissipation: Of the robot's contacts (Hunt and Crossley) [s/m]; they part with its inverse at most.
        stiction: Slip of what sticks [m/s].
        ball_frequency: Natural frequency of the ball's contacts [rad/s]; they are slower at large timesteps.
    """

    friction: Literal["lagged", "similar", "sap"] = "lagged"
    contact_time: Positive = 0.001
    dissipation: NonNegative = 20.0
    stiction: Positive = 1e-5
    ball_frequency: Positive = 1000.0


class DrakeEngine(EngineAdapter):
    """One trial in Drake."""

    def load(self, urdf: Path, robot: RobotModel, options: DrakeOptions) -> Loaded:
        """See `EngineAdapter.load`."""
        scene, ball = self._scene, self._scene.ball
        if scene.robot_restitution > 0.0:
            raise BackendError("in Drake the robot's own contacts do not bounce here; leave robot_restitution at 0")
        config = MultibodyPlantConfig(
            time_step=scene.timestep,
            contact_model="point",
            discrete_contact_approximation=options.friction,
            stiction_tolerance=options.stiction,
            use_sampled_output_ports=False,  # contacts are asked for before the state moves on
        )
        builder = DiagramBuilder()
        plant, self._graph = AddMultibodyPlant(config, builder)
        self._plant = plant
        self._shapes = DrakeShapes(scene, plant, self._graph)
        plant.mutable_gravity_field().set_gravity_vector(scene.gravity)
        try:
            (model,) = Parser(plant).AddModels(str(urdf))
        except RuntimeError as error:
            raise BackendError(f"Drake cannot load {scene.urdf}: {error}") from error
        self._links = [plant.GetBodyByName(name, model) for name in scene.link_names]
        base = RigidTransform(RotationMatrix(base_rotation(scene)), scene.base_position)
        if scene.fixed_base:
            plant.WeldFrames(plant.world_frame(), self._links[0].body_frame(), base)
        inertia = SpatialInertia(ball.mass, np.zeros(3), UnitInertia(*[ball.inertia / ball.mass] * 3))
        self._ball = plant.AddRigidBody(BALL, plant.AddModelInstance(BALL), inertia)
        contact_time = max(options.contact_time, 10.0 * scene.timestep)
        contact = robot.mass / contact_time**2, options.dissipation
        self._shapes.add(robot, self._ball, contact, options.ball_frequency)
        plant.Finalize()

        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        context = self._context = plant.GetMyMutableContextFromRoot(self._root)
        joints = [plant.GetJointByName(name, model) for name in scene.joint_names]
        angles = plant.GetPositions(context)
        angles[[joint.position_start() for joint in joints]] = scene.joint_angle
        plant.SetPositions(context, angles)
        if not scene.fixed_base:
            velocity = SpatialVelocity(scene.base_angular_velocity, scene.base_velocity)
            plant.SetFreeBodyPose(context, self._links[0], base)
            plant.SetFreeBodySpatialVelocity(context, self._links[0], velocity)
        plant.SetFreeBodyPose(context, self._ball, RigidTransform(ball.position))
        plant.SetFreeBodySpatialVelocity(context, self._ball, SpatialVelocity(np.zeros(3), ball.velocity))

        # The state is positions and velocities; of a free body these begin with a quaternion and a rotation.
        speeds = [joint.velocity_start() for joint in joints]
        at, first = self._ball.floating_velocities_start_in_v() + 3, plant.num_positions()
        self._torque_index, self._force_index = joint_index(speeds), slice(at, at + 3)
        self._angle_index = joint_index([joint.position_start() for joint in joints])
        self._velocity_index = joint_index([first + speed for speed in speeds])
        self._ball_velocity = slice(first + at, first + at + 3)
        self._force = np.zeros(plant.num_velocities())
        self._port = plant.get_applied_generalized_force_input_port().FixValue(context, self._force)
        self._contact_results = plant.get_contact_results_output_port()
        self._state = self._root.get_discrete_state_vector().CopyToVector()
        self._watch = BallWatch(scene)
        self._touched = False
        return self._loaded(robot, joints)

    def advance(self, joint_torque: Array, ball_force: Array) -> bool:
        """See `EngineAdapter.advance`.

        Raises:
            DivergenceError: Drake's solver fails, as it does with what is not finite.
        """
        self._force[self._torque_index], self._force[self._force_index] = joint_torque, ball_force
        self._port.GetMutableData().set_value(self._force)
        try:
            updated = self._diagram.EvalUniquePeriodicDiscreteUpdate(self._root)
            velocity = updated.value()[self._ball_velocity].tolist()
            touched = self._watch.touched(velocity, ball_force.tolist())
            if touched and not self._touched:
                fastest = max((speed for *_, speed in self._ball_contacts()), default=0.0)
                self._shapes.damp_ball(self._graph.GetMyMutableContextFromRoot(self._root), fastest)
                updated = self._diagram.EvalUniquePeriodicDiscreteUpdate(self._root)
            if touched:
                self._told = [(name, point, force) for name, point, force, _ in self._ball_contacts()]
        except RuntimeError as error:
            raise DivergenceError(f"Drake cannot go on at {self.time:.4f} s: {error}") from error
        self._touched = touched
        self._state = updated.value().copy()
        self._watch.velocity = self._state[self._ball_velocity].tolist()
        self._root.SetDiscreteState(updated)
        return touched

    def _ball_contacts(self) -> Iterator[tuple[str, Array, float, float]]:
        """Yield with what the ball is in contact, where [m], the normal force [N] and the speed of meeting [m/s]."""
        ball, names = self._shapes.ball, self._shapes.names
        results = self._contact_results.Eval(self._context)
        for contact in map(results.point_pair_contact_info, range(results.num_point_pair_contacts())):
            pair = contact.point_pair()
            if ball in (pair.id_A, pair.id_B):
                other = names[pair.id_A if pair.id_B == ball else pair.id_B]
                point, normal = contact.contact_point(), pair.nhat_BA_W
                one, two = (self._velocity(index, point) for index in (contact.bodyA_index(), contact.bodyB_index()))
                yield other, point, abs(float(contact.contact_force() @ normal)), float((two - one) @ normal)

    def _velocity(self, index: Any, point: Array) -> Array:
        body = self._plant.get_body(index)
        velocity = body.EvalSpatialVelocityInWorld(self._context)
        arm = point - body.EvalPoseInWorld(self._context).translation()
        moving: Array = velocity.translational() + np.cross(velocity.rotational(), arm)
        return moving

    def touches(self) -> Sequence[Touch]:
        """See `EngineAdapter.touches`."""
        return self._told

    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """See `EngineAdapter.write_motion`."""
        joint_angle[:], joint_velocity[:] = self._state[self._angle_index], self._state[self._velocity_index]
        ball_velocity[:] = self._state[self._ball_velocity]

    def poses(self) -> Poses:
        """See `EngineAdapter.poses`."""
        poses = [body.EvalPoseInWorld(self._context) for body in self._links]
        matrices = np.array([pose.GetAsMatrix34() for pose in poses])
        ball = self._ball.EvalPoseInWorld(self._context).translation()
        return matrices[:, :, 3], matrices[:, :, :3], poses[0].rotation().ToQuaternion().wxyz(), ball

    def _loaded(self, robot: RobotModel, joints: list[Any]) -> Loaded:
        limits = {j.name(): (j.position_lower_limits()[0], j.position_upper_limits()[0]) for j in joints}
        return Loaded(
            links={name: _held(self._plant.GetBodyByName(name)) for name in robot.links},
            ball=_held(self._ball),
            gravity=self._plant.gravity_field().gravity_vector(),
            limits={name: both for name, both in limits.items() if np.isfinite(both).any()},
            timestep=self._plant.time_step(),
            friction=self._shapes.frictions(),
            resistance={joint.name(): joint.default_damping_vector() for joint in joints},
        )


def _held(body: RigidBody) -> Body:
    inertia = body.default_spatial_inertia()
    about_com = inertia.Shift(inertia.get_com()).CalcRotationalInertia()
    return inertia.get_mass(), inertia.get_com(), about_com.CopyToFullMatrix3()


LIMITATIONS = (
    Limitation(
        "friction is bounded by the normal force of the step before, which what begins or hits lacks",
        {
            "friction_begins": ("steps of friction that the box loses", "steps of friction that the ball loses"),
            "friction_of_impacts": ("friction beyond mu times the normal impulse",),
            "slide_to_roll": ("speed while the solid ball slides", "speed while the hollow ball slides"),
        },
    ),
)

BACKEND = simulated_plugin(
    DrakeEngine,
    DrakeOptions,
    summary="Drake: convex solver, lagged Coulomb friction",
    limitations=LIMITATIONS,
    ingredients={
        "friction cone": ({"friction": "lagged"}, {"friction": "similar"}, {"friction": "sap"}),
        "contact stiffness": ({"contact_time": 0.001}, {"contact_time": 0.002}),
        "friction stiffness": ({"stiction": 1e-5}, {"stiction": 1e-3}),
    },
)
