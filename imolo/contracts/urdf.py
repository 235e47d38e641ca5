"""What a URDF says, typed: what every engine must have loaded, and all that an engine without a URDF loader needs.

What belongs to the actuators (damping, friction, effort, speed) is told, transmission is passed over, and so is mimic,
with a warning: no engine acts on them. A mesh stands for its convex hull. A base link named `world` without mass and
shapes is the world itself and left out with its fixed joint: `Scene` says where the base is, and whether it moves.
"""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Literal, TypeVar, get_args
from xml.etree import ElementTree

import numpy as np

from imolo.contracts.engine import Array
from imolo.contracts.mesh import Mesh, find_mesh, read_hull
from imolo.errors import BackendError, did_you_mean

JointType = Literal["revolute", "continuous", "prismatic", "fixed"]
ShapeKind = Literal["box", "sphere", "cylinder", "mesh"]
WORLD = "world"
Part = TypeVar("Part")
THIN = 1e-5  # [-] margin to a plate without thickness, whose largest moment is the sum of the others

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class CollisionShape:
    """A shape in the frame of its link.

    Attributes:
        kind: Which shape.
        size: Side lengths of a box, radius of a sphere, or radius and length (along z) of a cylinder [m]; empty for a
            mesh.
        position: Centre, or origin of a mesh [m], shape (3,).
        rotation: Rotation matrix, shape (3, 3).
        mesh: The convex hull; None for other shapes.
    """

    kind: ShapeKind
    size: tuple[float, ...]
    position: Array
    rotation: Array
    mesh: Mesh | None = None

    def lowest_point(self, position: Array, rotation: Array) -> float:
        """Return the height of the shape's lowest point [m] when the link frame is at this pose in the world."""
        center = position + rotation @ self.position
        down = (rotation @ self.rotation)[2]
        if self.mesh is not None:
            reach = -float((self.mesh.vertices @ down).min())
        elif self.kind == "sphere":
            reach = self.size[0]
        elif self.kind == "box":
            reach = 0.5 * float(np.abs(down) @ np.array(self.size))
        else:
            radius, length = self.size
            reach = 0.5 * length * abs(down[2]) + radius * float(np.hypot(down[0], down[1]))
        return float(center[2]) - reach


@dataclass(frozen=True)
class Link:
    """A rigid link: mass [kg], COM in the link frame [m], inertia about the COM in link axes [kg m²], and shapes.

    A link without `<inertial>` has mass 0. A largest principal moment above the sum of the others, which no body has,
    and which engines refuse, drop or believe, is cut to that sum.
    """

    name: str
    mass: float
    com: Array
    inertia: Array
    collisions: tuple[CollisionShape, ...]

    @property
    def thin(self) -> bool:
        """Return whether the largest principal moment is as large as it may be, as one that was cut."""
        small, middle, large = np.linalg.eigvalsh(self.inertia)
        return bool(large > (small + middle) * (1.0 - 1.5 * THIN))


@dataclass(frozen=True)
class Joint:
    """A joint.

    Attributes:
        name: Its name.
        kind: `prismatic` slides along its axis, by m where others turn by rad.
        parent: Link it hangs on.
        child: Link it moves.
        position: Origin of the joint's frame in the parent link [m], shape (3,).
        rotation: Rotation matrix of that frame, shape (3, 3).
        axis: Unit vector in that frame, shape (3,).
        limits: Lowest and highest angle [rad] or way [m]; None where it has none.
        effort: Largest torque [N·m] or force [N] of its motor, for actuators; engines do not cut.
        speed: Largest speed of its motor [rad/s or m/s], for actuators; engines do not cut.
        damping: Of its drive [N·m·s/rad or N·s/m], for actuators; engines take 0.
        friction: Of its drive [N·m or N], for actuators; engines take 0.
    """

    name: str
    kind: JointType
    parent: str
    child: str
    position: Array
    rotation: Array
    axis: Array
    limits: tuple[float, float] | None
    effort: float = np.inf
    speed: float = np.inf
    damping: float = 0.0
    friction: float = 0.0

    @property
    def unit(self) -> str:
        """Unit of its position: rad, or m where it slides."""
        return "m" if self.kind == "prismatic" else "rad"

    @property
    def effort_unit(self) -> str:
        """Unit of what its motor gives: N·m, or N where it slides."""
        return "N" if self.kind == "prismatic" else "N·m"


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

    @cached_property
    def parts(self) -> dict[str, str]:
        """Return, by link, the first link of the rigid part that fixed joints make of it."""
        welded = {joint.child: joint.parent for joint in self.joints.values() if joint.kind == "fixed"}
        parts = {}
        for name in self.links:
            part = name
            while part in welded:
                part = welded[part]
            parts[name] = part
        return parts

    def part_mass(self, link: str) -> float:
        """Return the mass of the rigid part that a link belongs to [kg]."""
        return sum(self.links[name].mass for name, part in self.parts.items() if part == self.parts[link])

    def link_poses(
        self, joint_angle: Mapping[str, float], base_position: Array, base_rotation: Array
    ) -> dict[str, tuple[Array, Array]]:
        """Compute where the links are.

        Args:
            joint_angle: Joint angles [rad], or ways [m] of prismatic joints; missing joints are at 0.
            base_position: Origin of the base link [m], shape (3,).
            base_rotation: Rotation matrix of the base link, shape (3, 3).

        Returns:
            Position [m], shape (3,), and rotation matrix, shape (3, 3), of each link frame in the world.
        """
        from scipy.spatial.transform import Rotation

        poses = {self.base: (base_position, base_rotation)}
        waiting = list(self.joints.values())
        while waiting:
            placed = [joint for joint in waiting if joint.parent in poses]
            if not placed:
                raise BackendError(f"robot {self.name!r}: joints {[j.name for j in waiting]} hang on no link")
            for joint in placed:
                position, rotation = poses[joint.parent]
                moved = joint_angle.get(joint.name, 0.0) * joint.axis
                way, turned = joint.position, rotation @ joint.rotation
                if joint.kind == "prismatic":
                    way = way + joint.rotation @ moved
                else:
                    turned = turned @ Rotation.from_rotvec(moved).as_matrix()
                poses[joint.child] = (position + rotation @ way, turned)
            waiting = [joint for joint in waiting if joint.child not in poses]
        return poses


def read_urdf(path: Path) -> RobotModel:
    """Read masses, collision shapes and joints of a URDF.

    Raises:
        BackendError: The file cannot be read, is no tree, or holds what no engine can use: a moving link without
            mass, a moment of inertia that is not positive, floating or planar joints, meshes other than STL and OBJ.
    """
    try:
        return _read(path, path.read_bytes())
    except (OSError, ElementTree.ParseError) as error:
        raise BackendError(f"cannot read URDF {path}: {error}") from error


@lru_cache(maxsize=16)  # every trial asks for the same few, which take some milliseconds
def _read(path: Path, content: bytes) -> RobotModel:
    root = ElementTree.fromstring(content)
    try:
        links = _read_each(root, "link", lambda element: _read_link(element, path.parent))
        joints = _read_each(root, "joint", _read_joint)
        _check_names("link", [link.name for link in links])
        _check_names("joint", [joint.name for joint in joints])
        model = RobotModel(root.get("name", path.stem), {x.name: x for x in links}, {x.name: x for x in joints})
        _check_tree(model)
        model = _without_world(model)
        for joint in model.joints.values():
            if joint.kind != "fixed" and model.part_mass(joint.child) == 0.0:
                raise BackendError(f"link {joint.child!r} moves and has mass 0.0 kg; give it an <inertial>")
    except BackendError as error:
        raise BackendError(f"URDF {path.name}: {error}") from None
    return model


def _read_each(root: ElementTree.Element, tag: str, read: Callable[[ElementTree.Element], Part]) -> list[Part]:
    """Read all links or joints; an error in one names it."""
    parts = []
    for element in root.findall(tag):
        try:
            parts.append(read(element))
        except BackendError as error:
            part = f"{tag} {element.get('name')!r}"
            raise BackendError(str(error) if part in str(error) else f"{part}: {error}") from None
    return parts


def _check_names(tag: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise BackendError(f"two of its {tag}s are named {name!r}; rename one")


def _check_tree(model: RobotModel) -> None:
    moved_by: dict[str, str] = {}
    for joint in model.joints.values():
        for link in (joint.parent, joint.child):
            if link not in model.links:
                hint = did_you_mean(link, model.links)
                raise BackendError(f"joint {joint.name!r} is at link {link!r}, which is not there{hint}")
        if joint.child in moved_by:
            raise BackendError(
                f"link {joint.child!r} hangs on the joints {moved_by[joint.child]!r} and {joint.name!r}; leave one, so "
                "that there is exactly one base link"
            )
        moved_by[joint.child] = joint.name
    _ = model.base


def _without_world(model: RobotModel) -> RobotModel:
    world = model.links.get(WORLD)
    if world is None:
        return model
    moves = any(joint.kind != "fixed" for joint in model.joints.values() if joint.parent == WORLD)
    if world.mass > 0.0 or world.collisions or model.base != WORLD or moves:
        raise BackendError(
            f"link {WORLD!r} has a mass, shapes or joints that move, but engines keep its name; rename it"
        )
    links = {name: link for name, link in model.links.items() if name != WORLD}
    joints = {name: joint for name, joint in model.joints.items() if joint.parent != WORLD}
    return RobotModel(model.name, links, joints)


def _child(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    found = element.find(tag)
    if found is None:
        raise BackendError(f"<{element.tag}> has no <{tag}>")
    return found


def _numbers(element: ElementTree.Element | None, key: str, default: str, count: int) -> Array:
    text = default if element is None else element.get(key, default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise BackendError(f"{key}={text!r} of a <{'' if element is None else element.tag}>; expected {count} numbers")
    return values


def _number(element: ElementTree.Element | None, key: str, default: str = "") -> float:
    return float(_numbers(element, key, default, 1)[0])


def _origin(element: ElementTree.Element) -> tuple[Array, Array]:
    from scipy.spatial.transform import Rotation

    origin = element.find("origin")
    # URDF's roll, pitch, yaw turn about the fixed axes x, y, z in this order.
    rotation = Rotation.from_euler("xyz", _numbers(origin, "rpy", "0 0 0", 3)).as_matrix()
    return _numbers(origin, "xyz", "0 0 0", 3), rotation


def _read_link(element: ElementTree.Element, folder: Path) -> Link:
    name, inertial = element.get("name", ""), element.find("inertial")
    shapes = tuple(_read_shape(collision, folder) for collision in element.findall("collision"))
    if inertial is None or _number(_child(inertial, "mass"), "value") == 0.0:
        return Link(name, 0.0, np.zeros(3), np.zeros((3, 3)), shapes)
    mass = _number(_child(inertial, "mass"), "value")
    if mass < 0.0:
        raise BackendError(f"link {name!r} has mass {mass} kg; give it a positive one")
    values = _child(inertial, "inertia")
    xx, yy, zz, xy, xz, yz = (_number(values, f"i{k}", "0") for k in ("xx", "yy", "zz", "xy", "xz", "yz"))
    com, rotation = _origin(inertial)
    inertia = _possible(name, rotation @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ rotation.T)
    return Link(name, mass, com, inertia, shapes)


def _possible(name: str, inertia: Array) -> Array:
    moments, axes = np.linalg.eigh(inertia)
    if not moments[0] > 0.0:
        raise BackendError(f"link {name!r} has principal moments {moments.tolist()} kg m²; all must be positive")
    largest = (moments[0] + moments[1]) * (1.0 - THIN)
    if moments[2] <= largest:
        return inertia
    if moments[2] > largest * (1.0 + 2.0 * THIN):
        _warn_once(f"link {name!r} has principal moments {moments.tolist()} kg m², which no body has; the last is cut")
    possible: Array = axes @ np.diag([moments[0], moments[1], largest]) @ axes.T
    return possible


@cache
def _warn_once(message: str) -> None:
    logger.warning(message)


def _read_shape(element: ElementTree.Element, folder: Path) -> CollisionShape:
    position, rotation = _origin(element)
    geometry = next(iter(_child(element, "geometry")), None)
    match "" if geometry is None else geometry.tag:
        case "box":
            size = tuple(_numbers(geometry, "size", "", 3).tolist())
            return CollisionShape("box", size, position, rotation)
        case "sphere":
            return CollisionShape("sphere", (_number(geometry, "radius"),), position, rotation)
        case "cylinder":
            size = (_number(geometry, "radius"), _number(geometry, "length"))
            return CollisionShape("cylinder", size, position, rotation)
        case "mesh":
            x, y, z = _numbers(geometry, "scale", "1 1 1", 3).tolist()
            file = find_mesh("" if geometry is None else geometry.get("filename", ""), folder)
            return CollisionShape("mesh", (), position, rotation, read_hull(file, (x, y, z)))
        case other:
            raise BackendError(f"collision shape <{other}> is not supported; use box, sphere, cylinder or mesh")


def _read_joint(element: ElementTree.Element) -> Joint:
    name, kind = element.get("name", ""), element.get("type", "")
    if kind not in get_args(JointType):
        raise BackendError(f"joint {name!r} is {kind!r}; use {', '.join(get_args(JointType))}")
    mimic = element.find("mimic")
    if mimic is not None:
        _warn_once(
            f"joint {name!r} is to mimic {mimic.get('joint')!r}, but joints are not coupled here: it moves freely; "
            "command both, or make it fixed"
        )
    position, rotation = _origin(element)
    axis = _numbers(element.find("axis"), "xyz", "1 0 0", 3)
    length = float(np.linalg.norm(axis))
    if length == 0.0 and kind != "fixed":
        raise BackendError(f"joint {name!r} has the axis 0 0 0; give it a direction")
    limit, dynamics = element.find("limit"), element.find("dynamics")
    limits = None
    if kind in ("revolute", "prismatic"):
        limit = _child(element, "limit")
        limits = _number(limit, "lower", "0"), _number(limit, "upper", "0")
        if not limits[0] < limits[1]:
            raise BackendError(f"joint {name!r} has limits {limits}; the lower comes first, and a fixed joint has none")
    return Joint(
        name,
        kind,  # type: ignore[arg-type]  # checked above
        _child(element, "parent").get("link", ""),
        _child(element, "child").get("link", ""),
        position,
        rotation,
        axis / length if length > 0.0 else axis,
        limits,
        effort=np.inf if limit is None or "effort" not in limit.attrib else _number(limit, "effort"),
        speed=np.inf if limit is None or "velocity" not in limit.attrib else _number(limit, "velocity"),
        damping=_number(dynamics, "damping", "0"),
        friction=_number(dynamics, "friction", "0"),
    )
