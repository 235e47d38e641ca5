"""Bodies and shapes of DART, and the robot that its loader makes of a URDF."""

from pathlib import Path
from typing import Any

import dartpy
import numpy as np

from imolo.contracts.engine import Array, Scene
from imolo.errors import BackendError
from imolo_backends.engines.engine_checks import Body, base_rotation


def shapes(skeleton: Any) -> list[Any]:
    """Return the shapes of a skeleton that touch something."""
    found = (shape for node in skeleton.getBodyNodes() for shape in node.getShapeNodes())
    return [shape for shape in found if shape.hasDynamicsAspect()]


def held(node: Any) -> Body:
    """Return what DART holds of a link."""
    inertia = node.getInertia()
    return inertia.getMass(), inertia.getLocalCOM(), inertia.getMoment()


def pose(position: Any, rotation: Array) -> Any:
    """Return a pose at [m], shape (3,), turned by a matrix of shape (3, 3)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return dartpy.math.Isometry3(matrix)


def load_robot(scene: Scene, urdf: Path) -> Any:
    """Return the robot of a URDF, its links without contact among themselves.

    Raises:
        BackendError: DART cannot load it.
    """
    loader, root = dartpy.utils.DartLoader(), dartpy.utils.DartLoaderRootJointType
    options = loader.getOptions()
    options.mDefaultRootJointType = root.FIXED if scene.fixed_base else root.FLOATING
    loader.setOptions(options)
    robot = loader.parseSkeleton(str(urdf))
    if robot is None:
        raise BackendError(f"DART cannot load {scene.urdf}")
    if scene.fixed_base:
        robot.getRootJoint().setTransformFromParentBodyNode(pose(scene.base_position, base_rotation(scene)))
    robot.disableSelfCollisionCheck()
    for joint in robot.getJoints():
        joint.setLimitEnforcement(True)
    return robot


def add_body(world: Any, name: str, body_name: str, kind: str, shape: Any) -> tuple[Any, Any]:
    """Add a skeleton of one body on a joint of a kind, "Free" or "Weld"; return both."""
    skeleton = dartpy.dynamics.Skeleton(name)
    _, body = getattr(skeleton, f"create{kind}JointAndBodyNodePair")()
    body.setName(body_name)
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect()
    world.addSkeleton(skeleton)
    return skeleton, body


def set_contact(skeleton: Any, friction: float, restitution: float) -> None:
    """Set friction and restitution of all its shapes [-]."""
    for shape in shapes(skeleton):
        # DART takes the smaller friction coefficient of two bodies.
        shape.getDynamicsAspect().setFrictionCoeff(friction)
        shape.getDynamicsAspect().setRestitutionCoeff(restitution)
