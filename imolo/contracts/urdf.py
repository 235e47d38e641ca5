"""What a URDF says, typed: what every engine must have loaded, and all that an engine without a URDF loader needs."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from imolo.contracts.engine import Array
from imolo.errors import BackendError

JointType = Literal["revolute", "continuous", "fixed"]
ShapeKind = Literal["box", "sphere", "cylinder"]


@dataclass(frozen=True)
class CollisionShape:
    """A shape in the frame of its link.

    Attributes:
        kind: Which shape.
        size: Side lengths of a box, radius of a sphere, or radius and length (along z) of a cylinder [m].
        position: Centre [m], shape (3,).
        rotation: Rotation matrix, shape (3, 3).
    """

    kind: ShapeKind
    size: tuple[float, ...]
    position: Array
    rotation: Array

    def lowest_point(self, position: Array, rotation: Array) -> float:
        """Return the height of the shape's lowest point [m] when the link frame is at this pose in the world."""
        center = position + rotation @ self.position
        down = (rotation @ self.rotation)[2]
        if self.kind == "sphere":
            reach = self.size[0]
        elif self.kind == "box":
            reach = 0.5 * float(np.abs(down) @ np.array(self.size))
        else:
            radius, length = self.size
            reach = 0.5 * length * abs(down[2]) + radius * float(np.hypot(down[0], down[1]))
        return float(center[2]) - reach


@dataclass(frozen=True)
class Link:
    """A rigid link: mass [kg], COM in the link frame [m], inertia about the COM in link axes [kg m²], and shapes."""

    name: str
    mass: float
    com: Array
    inertia: Array
    collisions: tuple[CollisionShape, ...]


@dataclass(frozen=True)
class Joint:
    """A joint: its frame in the parent link [m], axis in that frame, and limits [rad] where it has any."""

    name: str
    kind: JointType
    parent: str
    child: str
    position: Array
    rotation: Array
    axis: Array
    limits: tuple[float, float] | None


@dataclass(frozen=True)
class RobotModel:
    """A tree of links, both dictionaries in the order of the file."""

    name: str
    links: dict[str, Link]
    joints: dict[str, Joint]

    @cached_property
    def base(self) -> str:
        """Return the name of the one link that is no joint's child."""
        roots = set(self.links) - {joint.child for joint in self.joints.values()}
        if len(roots) != 1:
            raise BackendError(f"robot {self.name!r} needs exactly one base link, found {sorted(roots)}")
        return roots.pop()

    @cached_property
    def mass(self) -> float:
        """Return the mass of all links [kg]."""
        return sum(link.mass for link in self.links.values())

    def link_poses(
        self, joint_angle: Mapping[str, float], base_position: Array, base_rotation: Array
    ) -> dict[str, tuple[Array, Array]]:
        """Compute where the links are.

        Args:
            joint_angle: Joint angles [rad]; missing joints are at 0.
            base_position: Origin of the base link [m], shape (3,).
            base_rotation: Rotation matrix of the base link, shape (3, 3).

        Returns:
            Position [m], shape (3,), and rotation matrix, shape (3, 3), of each link frame in the world.
        """
        poses = {self.base: (base_position, base_rotation)}
        waiting = list(self.joints.values())
        while waiting:
            placed = [joint for joint in waiting if joint.parent in poses]
            if not placed:
                raise BackendError(f"robot {self.name!r}: joints {[j.name for j in waiting]} hang on no link")
            for joint in placed:
                position, rotation = poses[joint.parent]
                turn = Rotation.from_rotvec(joint_angle.get(joint.name, 0.0) * joint.axis).as_matrix()
                poses[joint.child] = (position + rotation @ joint.position, rotation @ joint.rotation @ turn)
            waiting = [joint for joint in waiting if joint.child not in poses]
        return poses


def read_urdf(path: Path) -> RobotModel:
    """Read masses, collision shapes and joints of a URDF.

    Raises:
        BackendError: The file cannot be read, or holds what this project does not use (meshes, prismatic joints,
            links without mass).
    """
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise BackendError(f"cannot read URDF {path}: {error}") from error
    links = [_read_link(element) for element in root.findall("link")]
    joints = [_read_joint(element) for element in root.findall("joint")]
    return RobotModel(root.get("name", path.stem), {x.name: x for x in links}, {x.name: x for x in joints})


def _child(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    found = element.find(tag)
    if found is None:
        raise BackendError(f"URDF {element.tag} {element.get('name')!r} has no <{tag}>")
    return found


def _vector(element: ElementTree.Element | None, key: str, default: str) -> Array:
    text = default if element is None else element.get(key, default)
    return np.array(text.split(), dtype=np.float64)


def _origin(element: ElementTree.Element) -> tuple[Array, Array]:
    origin = element.find("origin")
    # URDF's roll, pitch, yaw turn about the fixed axes x, y, z in this order.
    rotation = Rotation.from_euler("xyz", _vector(origin, "rpy", "0 0 0")).as_matrix()
    return _vector(origin, "xyz", "0 0 0"), rotation


def _read_link(element: ElementTree.Element) -> Link:
    inertial = _child(element, "inertial")
    mass = float(_child(inertial, "mass").get("value", "0"))
    if mass <= 0.0:
        # PyBullet and DART silently turn a massless link into 1 kg.
        raise BackendError(f"URDF link {element.get('name')!r} has mass {mass} kg; every link needs a positive mass")
    values = _child(inertial, "inertia")
    xx, yy, zz, xy, xz, yz = (float(values.get(f"i{k}", "0")) for k in ("xx", "yy", "zz", "xy", "xz", "yz"))
    com, rotation = _origin(inertial)
    inertia = rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ rotation.T
    shapes = tuple(_read_shape(collision) for collision in element.findall("collision"))
    return Link(element.get("name", ""), mass, com, inertia, shapes)


def _read_shape(element: ElementTree.Element) -> CollisionShape:
    position, rotation = _origin(element)
    geometry = _child(element, "geometry")[0]
    match geometry.tag:
        case "box":
            size = tuple(_vector(geometry, "size", "").tolist())
            return CollisionShape("box", size, position, rotation)
        case "sphere":
            return CollisionShape("sphere", (float(geometry.get("radius", "nan")),), position, rotation)
        case "cylinder":
            size = (float(geometry.get("radius", "nan")), float(geometry.get("length", "nan")))
            return CollisionShape("cylinder", size, position, rotation)
        case other:
            raise BackendError(f"URDF collision shape <{other}> is not supported; use box, sphere or cylinder")


def _read_joint(element: ElementTree.Element) -> Joint:
    name, kind = element.get("name", ""), element.get("type", "")
    position, rotation = _origin(element)
    axis = _vector(element.find("axis"), "xyz", "1 0 0")
    parent, child = (_child(element, tag).get("link", "") for tag in ("parent", "child"))
    match kind:
        case "revolute":
            limit = _child(element, "limit")
            limits = (float(limit.get("lower", "0")), float(limit.get("upper", "0")))
            return Joint(name, "revolute", parent, child, position, rotation, axis, limits)
        case "continuous" | "fixed":
            return Joint(name, kind, parent, child, position, rotation, axis, None)
        case other:
            raise BackendError(f"URDF joint {name!r} is {other!r}; use revolute, continuous or fixed")
