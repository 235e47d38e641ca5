"""What can touch what in a Drake plant, and of what material it is."""

from collections.abc import Sequence
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Role,
    RoleAssign,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context

from imolo.contracts.engine import Array, Scene
from imolo.contracts.urdf import RobotModel
from imolo_backends.engines.adapter import FLOOR

CORNER = 0.001  # [m] radius of the spheres that a box stands on
RIGID = 1e12  # [N/m] of two bodies that touch, the softer one counts
SLOWEST = 0.001  # [m/s] slower meetings of the ball are damped as if they were as fast
MOST_DAMPED = 100.0  # dissipation times speed of meeting, which leaves .01 of the speed

Shapes = list[Any]


class DrakeShapes:
    """The shapes of a scene.

    Two shapes touch at one point in Drake, so that a box of the robot stands on spheres in its corners, and meets those
    of other boxes; edges that cross are not seen. Softness is where nothing else is: what is fixed is there twice, soft
    for the robot, which is hard, and hard for the ball, which is soft.

    Attributes:
        ball: Shape of the ball.
        names: Of all shapes that the ball can touch: link's name, box's name or `FLOOR`.
    """

    def __init__(self, scene: Scene, plant: MultibodyPlant, graph: SceneGraph) -> None:
        self._scene, self._plant, self._graph = scene, plant, graph
        self.names: dict[Any, str] = {}

    def add(self, robot: RobotModel, ball: RigidBody, contact: tuple[float, float], ball_frequency: float) -> None:
        """Add all shapes, before the plant is finalised.

        Args:
            robot: Its shapes are those that the parser has added.
            ball: The ball's body.
            contact: Stiffness [N/m] and dissipation [s/m] of the robot's contacts.
            ball_frequency: Natural frequency of the ball's contacts [rad/s].
        """
        world, soft, hard = self._plant.world_body(), self._material(*contact), self._material(RIGID)
        for_robot, for_ball = self._add_fixed(soft), self._add_fixed(hard)
        corners: Shapes = []
        for box in self._scene.boxes:
            corners += self._add_corners(world, RigidTransform(box.center), box.half_extents, soft)
        boxes, others, feet = self._take_robot(robot, hard)
        self._add_ball(ball, ball_frequency)
        robots = boxes + others + feet
        no_contact = CollisionFilterDeclaration()
        no_contact.ExcludeWithin(GeometrySet(robots))
        for one, other in (
            (robots, for_ball),
            ([self.ball], for_robot + corners + feet),
            (boxes, for_robot),
            (others + feet, corners),
        ):
            no_contact.ExcludeBetween(GeometrySet(one), GeometrySet(other))
        self._graph.collision_filter_manager().Apply(no_contact)

    def damp_ball(self, context: Context, speed: float) -> None:
        """Give the ball the dissipation with which it bounces as it should at this speed of meeting [m/s].

        A Hunt-Crossley contact bounces as its dissipation times the speed says, whatever the masses are.
        """
        material = self._material(self._ball_stiffness, self._ball_damping / max(speed, SLOWEST))
        self._graph.AssignRole(context, self._plant.get_source_id(), self.ball, material, RoleAssign.kReplace)

    def frictions(self) -> list[tuple[str, float]]:
        """Return the name and the coefficient of friction of every shape."""
        inspector = self._graph.model_inspector()
        found = []
        for shape in inspector.GetAllGeometryIds(Role.kProximity):
            friction = inspector.GetProximityProperties(shape).GetProperty("material", "coulomb_friction")
            found.append((inspector.GetName(shape), friction.dynamic_friction()))
        return found

    def _take_robot(self, robot: RobotModel, material: ProximityProperties) -> tuple[Shapes, Shapes, Shapes]:
        """Return boxes, other shapes and corners of boxes of the robot."""
        inspector, source = self._graph.model_inspector(), self._plant.get_source_id()
        boxes, others, corners = [], [], []
        for name, link in robot.links.items():
            body = self._plant.GetBodyByName(name)
            # The plant's own list is a view, which the next shape moves.
            shapes = inspector.GetGeometries(self._plant.GetBodyFrameIdOrThrow(body.index()), Role.kProximity)
            for shape, collision in zip(shapes, link.collisions, strict=True):
                self._graph.AssignRole(source, shape, material, RoleAssign.kReplace)
                self.names[shape] = name
                if collision.kind == "box":
                    boxes.append(shape)
                    pose = RigidTransform(RotationMatrix(collision.rotation), collision.position)
                    corners += self._add_corners(body, pose, 0.5 * np.array(collision.size), material)
                else:
                    others.append(shape)
        return boxes, others, corners

    def _add_fixed(self, material: ProximityProperties) -> Shapes:
        shapes: Shapes = [(FLOOR, RigidTransform(), HalfSpace())]
        shapes += [(b.name, RigidTransform(b.center), Box(2.0 * np.array(b.half_extents))) for b in self._scene.boxes]
        world = self._plant.world_body()
        added = {self._add(world, pose, shape, material): name for name, pose, shape in shapes}
        self.names |= added
        return list(added)

    def _add_corners(
        self, body: RigidBody, pose: RigidTransform, half_extents: Sequence[float] | Array, material: Any
    ) -> Shapes:
        radius = min(CORNER, *half_extents)
        corners = np.array(list(product((-1.0, 1.0), repeat=3))) * (np.array(half_extents) - radius)
        return [self._add(body, pose.multiply(RigidTransform(at)), Sphere(radius), material) for at in corners]

    def _add_ball(self, body: RigidBody, frequency: float) -> None:
        ball, timestep, restitution = self._scene.ball, self._scene.timestep, self._scene.restitution
        # Implicit steps alone take 1.6 w dt of a bounce.
        turn = min(frequency * timestep, 0.1, max(0.5 * (1.0 - restitution), 0.005))
        self._ball_stiffness = ball.mass * (turn / timestep) ** 2
        self._ball_damping = damping_of_bounce(restitution, turn)
        self.ball = self._add(body, RigidTransform(), Sphere(ball.radius), self._material(self._ball_stiffness))

    def _add(self, body: RigidBody, pose: RigidTransform, shape: Any, material: ProximityProperties) -> Any:
        name = f"shape {self._plant.num_collision_geometries()}"
        return self._plant.RegisterCollisionGeometry(body, pose, shape, name, material)

    def _material(self, stiffness: float, dissipation: float = 0.0) -> ProximityProperties:
        material, friction = ProximityProperties(), self._scene.friction
        AddContactMaterial(dissipation, stiffness, CoulombFriction(friction, friction), material)
        # What `sap` has in place of the dissipation, and which adds up over the two bodies.
        relaxation = 0.0 if stiffness == RIGID else self._scene.timestep
        material.AddProperty("material", "relaxation_time", relaxation)
        return material


@cache
def damping_of_bounce(restitution: float, turn: float) -> float:
    """Return dissipation times speed of meeting with which a Hunt-Crossley contact bounces with this restitution.

    Drake's implicit steps damp as well, so that the bounce is played step by step: F = k x (1 + dissipation dx/dt).

    Args:
        restitution: [-]
        turn: Natural frequency of the contact times the timestep [rad].
    """

    def bounce(damping: float) -> float:
        depth, speed = 0.5 * turn, -1.0  # in speeds of meeting over frequency, and in speeds of meeting
        while depth > 0.0:
            # The new speed w is speed + turn (depth - turn w) (1 - damping w).
            slope, rest = 1.0 + turn * (turn + damping * depth), speed + turn * depth
            speed = 2.0 * rest / (slope + float(np.sqrt(slope**2 - 4.0 * turn**2 * damping * rest)))
            depth -= turn * speed
        return speed

    if bounce(0.0) <= restitution:
        return 0.0
    if bounce(MOST_DAMPED) >= restitution:
        return MOST_DAMPED
    from scipy.optimize import brentq  # late, so that the backends are listed at once

    return float(brentq(lambda damping: bounce(damping) - restitution, 0.0, MOST_DAMPED))
