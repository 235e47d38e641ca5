"""Bodies, joints and shapes of SAPIEN from a robot's model."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from imolo.contracts.engine import Array
from imolo.contracts.urdf import CollisionShape, Joint
from imolo_backends.engines.adapter import Body
from imolo_backends.engines.engine_checks import turned_inertia

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it warns that the machine has no Vulkan, which only its renderer needs
    import sapien
    from sapien import physx

__all__ = ["make_pose", "make_shape", "physx", "rotation_to", "sapien", "set_body", "set_joint", "told_body"]

UNLIMITED = 1e6  # [m/s, rad/s] PhysX clamps speeds, the spin of a rolling ball among them at 100
CONTINUOUS = (-np.inf, np.inf)


def attach(component: Any, shape: Any, groups: list[int], contact_offset: float) -> None:
    """Give a body a shape that touches those of some groups, from a gap on [m]."""
    shape.contact_offset, shape.rest_offset = contact_offset, 0.0
    shape.set_collision_groups(groups)
    component.attach(shape)


def set_body(component: Any, mass: float, com: Any, moments: Any, push_out: float) -> None:
    """Set mass [kg], pose of COM and principal axes, principal moments [kg m²], and how fast it leaves another [m/s].

    Nothing brakes it.
    """
    component.mass, component.cmass_local_pose, component.inertia = mass, com, moments
    component.linear_damping = component.angular_damping = 0.0  # .05 at first
    component.max_linear_velocity = component.max_angular_velocity = UNLIMITED
    component.max_depenetration_velocity = push_out


def set_joint(born: Any, joint: Joint | None, fixed_base: bool) -> None:
    """Make what a link is born with its joint; None for the base."""
    if joint is None:
        born.type = "fixed" if fixed_base else "undefined"
        return
    turn = rotation_to(joint.axis) if joint.axis.any() else np.eye(3)
    born.name, born.type = joint.name, joint.kind
    if joint.kind in ("revolute", "continuous"):
        born.type = "revolute_unwrapped"  # which counts its turns
    # Both frames have the axis along x.
    born.pose_in_parent, born.pose_in_child = (
        make_pose(joint.position, joint.rotation @ turn),
        make_pose(np.zeros(3), turn),
    )
    if joint.kind != "fixed":
        born.limit = np.array([joint.limits or CONTINUOUS])
        born.friction = 0.0  # .05 at first
        born.set_max_velocity(UNLIMITED)


def make_pose(position: Any, rotation: Array) -> Any:
    """Return a pose from a position [m], shape (3,), and a rotation matrix."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return sapien.Pose(matrix)


def rotation_to(axis: Array) -> Array:
    """Return a rotation matrix, shape (3, 3), that turns the x axis into this axis."""
    aside = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    aside /= np.linalg.norm(aside)
    return np.column_stack([axis, aside, np.cross(axis, aside)])


def told_body(body: Any) -> Body:
    """Return what PhysX says that a body is."""
    com = body.cmass_local_pose
    quaternion = np.roll(com.q.astype(np.float64), -1)  # from w, x, y, z to x, y, z, w
    return body.mass, com.p, turned_inertia(quaternion, body.inertia.astype(np.float64))


def make_shape(collision: CollisionShape, material: Any, folder: Path) -> Any:
    """Return a shape of a link; a mesh is written to this folder."""
    rotation = collision.rotation
    if collision.mesh is not None:
        path = folder / f"{id(collision)}.obj"
        collision.mesh.write_obj(path)
        shape = physx.PhysxCollisionShapeConvexMesh(str(path), np.ones(3), material)
    elif collision.kind == "box":
        shape = physx.PhysxCollisionShapeBox(0.5 * np.array(collision.size), material)
    elif collision.kind == "sphere":
        shape = physx.PhysxCollisionShapeSphere(*collision.size, material)
    else:
        radius, length = collision.size
        shape = physx.PhysxCollisionShapeCylinder(radius, 0.5 * length, material)
        rotation = rotation @ rotation_to(np.array([0.0, 0.0, 1.0]))  # PhysX has it along x
    shape.local_pose = make_pose(collision.position, rotation)
    return shape
