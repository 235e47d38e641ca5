"""SAPIEN, which is PhysX 5 on the CPU, as an `Engine`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import PositiveInt

from imolo.config.model import Positive
from imolo.conformance import Limitation
from imolo.contracts.engine import Array, EngineOptions
from imolo.contracts.urdf import RobotModel
from imolo_backends.engines.adapter import FLOOR, EngineAdapter, Loaded, Poses, Touch
from imolo_backends.engines.engine_checks import (
    BallWatch,
    base_com_velocity,
    base_rotation,
    fill,
    joint_index,
    link_rotations,
)
from imolo_backends.engines.sapien_bodies import (
    attach,
    make_pose,
    make_shape,
    physx,
    rotation_to,
    sapien,
    set_body,
    set_joint,
    told_body,
)
from imolo_backends.simulation.simulated import simulated_plugin

TOUCHING = 1e-6  # [m] gap at which the ball's contacts begin; ahead of a contact PhysX takes a part of a bounce
UNTOUCHED = 2.0**-21  # rounding of the ball's velocity in a step, relative, with a margin
# Every shape is there twice, since PhysX takes the mean of two restitutions: for the robot, which does not bounce, and
# for the ball. A group of the one touches the same bit of the other's second number.
ROBOT, FIXED, BALL = (([1, 0, 0, 0], [0, 2, 0, 0]), ([0, 1, 0, 0], [0, 2, 0, 0]), [2, 0, 0, 0])


class SapienOptions(EngineOptions):
    """Options of the SAPIEN engine.

    Attributes:
        solver: `pgs` bounds friction along two axes, to 1.41 mu where impacts turn the slip. `tgs` (4, 1 iterations)
            keeps the cone, but cuts up the step in single precision: what rests drifts .1 mm/s, joints .03 rad/s.
        position_iterations: Sweeps of the solver with what takes penetrations away.
        velocity_iterations: Sweeps without. At one, a box that is pushed at 30° slides at 33°.
        contact_offset: Gap at which the robot's contacts begin [m].
        push_out: Largest speed at which bodies that overlap are pushed apart [m/s].
        restitution_velocity: Slower impacts do not bounce [m/s].
    """

    solver: Literal["pgs", "tgs"] = "pgs"
    position_iterations: PositiveInt = 50
    velocity_iterations: PositiveInt = 50
    contact_offset: Positive = 0.001
    push_out: Positive = 1.0
    restitution_velocity: Positive = 0.05

    @property
    def precision(self) -> float:
        """See `EngineOptions.precision`."""
        return 2.0**-24


class SapienEngine(EngineAdapter):
    """One trial in SAPIEN, in a PhysX scene of its own."""

    def load(self, urdf: Path, robot: RobotModel, options: SapienOptions) -> Loaded:
        """See `EngineAdapter.load`."""
        scene, ball = self._scene, self._scene.ball
        self._options, self._folder = options, urdf.parent
        physx.set_scene_config(
            gravity=scene.gravity,
            bounce_threshold=options.restitution_velocity,
            enable_tgs=options.solver == "tgs",
            enable_enhanced_determinism=True,
        )
        physx.set_body_config(options.position_iterations, options.velocity_iterations, sleep_threshold=0.0)
        self._system = physx.PhysxCpuSystem()
        self._system.timestep = scene.timestep
        self._world = sapien.Scene([self._system])
        restitutions = (scene.robot_restitution, scene.restitution)
        self._materials = [physx.PhysxMaterial(scene.friction, scene.friction, e) for e in restitutions]
        self._offsets = (options.contact_offset, TOUCHING)
        self._names: dict[Any, str] = {}
        # PhysX has planes that face along x.
        self._add_fixed(FLOOR, make_pose(np.zeros(3), rotation_to(np.array([0.0, 0.0, 1.0]))))
        for box in scene.boxes:
            self._add_fixed(box.name, sapien.Pose(box.center), box.half_extents)
        self._add_robot(robot)
        self._ball = physx.PhysxRigidDynamicComponent()
        attach(self._ball, physx.PhysxCollisionShapeSphere(ball.radius, self._materials[1]), BALL, TOUCHING)
        set_body(self._ball, ball.mass, sapien.Pose(), [ball.inertia] * 3, options.push_out)
        self._add(self._ball, sapien.Pose(ball.position))
        self._ball.set_linear_velocity(ball.velocity)
        self._watch = BallWatch(scene)
        self._no_torque = np.zeros(3)
        return self._loaded()

    def _add(self, component: Any, pose: Any) -> None:
        entity = sapien.Entity()
        entity.add_component(component)
        entity.pose = pose
        self._world.add_entity(entity)

    def _add_fixed(self, name: str, pose: Any, half_extents: Any = None) -> None:
        component = physx.PhysxRigidStaticComponent()
        for material, groups, offset in zip(self._materials, FIXED, self._offsets, strict=True):
            if half_extents is None:
                shape = physx.PhysxCollisionShapePlane(material)
            else:
                shape = physx.PhysxCollisionShapeBox(half_extents, material)
            attach(component, shape, groups, offset)
        self._add(component, pose)
        self._names[component] = name

    def _add_robot(self, robot: RobotModel) -> None:
        scene = self._scene
        links: dict[str, Any] = {}
        joints = {joint.child: joint for joint in robot.joints.values()}
        waiting = [robot.base]
        for name in waiting:
            waiting += [joint.child for joint in robot.joints.values() if joint.parent == name]
            link, joint = robot.links[name], joints.get(name)
            component = physx.PhysxArticulationLinkComponent(links[joint.parent] if joint else None)
            for collision in link.collisions:
                for material, groups, offset in zip(self._materials, ROBOT, self._offsets, strict=True):
                    attach(component, make_shape(collision, material, self._folder), groups, offset)
            moments, axes = np.linalg.eigh(link.inertia)
            axes[:, 0] *= np.linalg.det(axes)  # right-handed
            set_body(component, link.mass, make_pose(link.com, axes), moments, self._options.push_out)
            set_joint(component.joint, joint, scene.fixed_base)
            component.name = self._names[component] = name
            links[name] = component
        start = make_pose(scene.base_position, base_rotation(scene))
        for name, component in links.items():
            self._add(component, start if name == robot.base else sapien.Pose())
        self._links = [links[name] for name in scene.link_names]
        self._robot = self._links[0].articulation
        names = [joint.name for joint in self._robot.active_joints]
        order = [names.index(name) for name in scene.joint_names]
        self._joints = [self._robot.active_joints[number] for number in order]
        self._joint_index, self._torque = joint_index(order), np.zeros(len(order))
        angles = np.zeros(len(order))
        angles[self._joint_index] = scene.joint_angle
        self._robot.set_root_pose(start)
        if names:
            self._robot.set_qpos(angles)
        if not scene.fixed_base:
            velocity, spin = base_com_velocity(scene, robot.links[robot.base].com)
            self._robot.set_root_linear_velocity(velocity)
            self._robot.set_root_angular_velocity(spin)

    def advance(self, joint_torque: Array, ball_force: Array) -> bool:
        """See `EngineAdapter.advance`."""
        if self._joints:
            self._torque[self._joint_index] = joint_torque
            self._robot.set_qf(self._torque)
        self._ball.add_force_torque(ball_force, self._no_torque)
        self._system.step()
        after = self._ball.get_linear_velocity().tolist()
        rounding = UNTOUCHED * (1.0 + abs(after[0]) + abs(after[1]) + abs(after[2]))
        return self._watch.touched(after, ball_force.tolist(), rounding)

    def touches(self) -> Iterator[Touch]:
        """See `EngineAdapter.touches`."""
        for contact in self._system.get_contacts():
            if self._ball in contact.bodies:
                other = contact.bodies[contact.bodies[0] == self._ball]
                for point in contact.points:
                    impulse = abs(float(np.dot(point.impulse, point.normal)))
                    yield self._names[other], point.position, impulse / self._scene.timestep

    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """See `EngineAdapter.write_motion`."""
        if self._joints:
            joint_angle[:] = self._robot.get_qpos()[self._joint_index]
            joint_velocity[:] = self._robot.get_qvel()[self._joint_index]
        fill(ball_velocity, self._watch.velocity)

    def poses(self) -> Poses:
        """See `EngineAdapter.poses`."""
        poses = [link.entity_pose for link in self._links]
        quaternions = np.array([pose.q for pose in poses], dtype=np.float64)
        positions = np.array([pose.p for pose in poses], dtype=np.float64)
        ball = self._ball.entity_pose.p.astype(np.float64)
        return positions, link_rotations(np.roll(quaternions, -1, axis=1)), quaternions[0], ball

    def _loaded(self) -> Loaded:
        limits = {joint.name: joint.limit[0] for joint in self._joints}
        bodies = [*self._names, self._ball]
        return Loaded(
            links={link.name: told_body(link) for link in self._links},
            ball=told_body(self._ball),
            gravity=self._system.config.gravity,
            limits={name: both for name, both in limits.items() if np.isfinite(both).any()},
            timestep=self._system.timestep,
            friction=[(b.name, s.physical_material.dynamic_friction) for b in bodies for s in b.collision_shapes],
            resistance={joint.name: (joint.friction, joint.damping, joint.stiffness) for joint in self._joints},
        )


LIMITATIONS = (
    Limitation(
        "friction is bounded along the slip before the step and across it, and an impact turns the slip: up to 1.41 mu",
        {"friction_of_impacts": ("friction beyond mu times the normal impulse",)},
    ),
    Limitation(
        "in single precision friction turns what slides by 3e-7 rad in each step",
        {"slide_0": ("turn, at most",), "slide_30": ("turn, at most",)},
    ),
)

BACKEND = simulated_plugin(
    SapienEngine,
    SapienOptions,
    summary="SAPIEN: PhysX 5 on the CPU, single precision",
    limitations=LIMITATIONS,
    ingredients={
        "solver": (
            {"position_iterations": 50, "velocity_iterations": 50},
            {"solver": "tgs", "position_iterations": 4, "velocity_iterations": 1},
        ),
        "contact stiffness": ({"push_out": 1.0}, {"push_out": 0.1}),
    },
)
