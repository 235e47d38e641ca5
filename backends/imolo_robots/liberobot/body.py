"""Liberobot (Sec. V-A): its names, its ready pose on the box, and the scene a trial starts from."""

import atexit
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from imolo.config.simulation import BallConfig, ContactConfig
from imolo.contracts.backend import RobotDescription
from imolo.contracts.engine import Array, Ball, BoxShape, Scene
from imolo.contracts.urdf import RobotModel, read_urdf
from imolo.errors import BackendError

ROBOT_NAME = "liberobot"
URDF = Path(__file__).with_name("liberobot.urdf")

JOINT_NAMES = (
    "right_hip",
    "right_knee",
    "right_ankle",
    "left_hip",
    "left_knee",
    "left_ankle",
    "right_shoulder",
    "left_shoulder",
)
LINK_NAMES = (
    "trunk",
    "right_thigh",
    "right_shank",
    "right_foot",
    "left_thigh",
    "left_shank",
    "left_foot",
    "right_arm",
    "left_arm",
)
FOOT_LINKS = ("right_foot", "left_foot")
ARM_LINKS = ("right_arm", "left_arm")
LEG_JOINTS = (("right_hip", "right_knee", "right_ankle"), ("left_hip", "left_knee", "left_ankle"))

# The legs rest at the ends of their range (Sec. VII-A); arms down is assumed, since valve 8 lowers them.
READY_JOINT_ANGLE = tuple(np.radians([150.0, 150.0, 45.0, 150.0, 150.0, 45.0, 0.0, 0.0]).tolist())  # [rad]
HAND_OFFSET = (0.0, 0.0, -0.35)  # [m] centre of the plate in the arm frame, derived from Sec. V-A
TOE_OFFSET = (0.150, 0.0, 0.0)  # [m] front end of the 211 mm foot in the foot frame, assumed
SOLE_RADIUS = 0.048  # [m] Sec. V-A; the foot frame is this high above the ground
FLAT_SOLE_WIDTH = 2.0 * SOLE_RADIUS  # [m] as wide as the half cylinder
FLAT_SOLE_TOP = -0.020  # [m] in the foot frame, assumed: below the ankle

BOX_NAME = "box"
BOX_HEIGHT = 0.400  # [m] Sec. VII-A
BOX_DEPTH = 0.800  # [m] along x, assumed: more than the foot
BOX_WIDTH = 0.800  # [m] along y, assumed: more than the robot
TOE_TO_EDGE = 0.020  # [m] assumed: the feet are marked on the box (Sec. VII-A), where is not said
BALL_START = (5.0, 0.0, 1.1)  # [m] thrown from about 5 m away by a machine 1.1 m high (Sec. VII-A)


def _joint_limits() -> Array:
    joints = read_urdf(URDF).joints
    limits = np.array([joints[name].limits for name in JOINT_NAMES], dtype=np.float64)
    limits.flags.writeable = False
    return limits


JOINT_LIMITS = _joint_limits()  # [rad] lowest and highest angle, shape (8, 2)


@dataclass(frozen=True)
class Marker:
    """A mocap marker: its label, name, the link it is glued to, and its offset in that link's frame [m]."""

    marker_id: int
    name: str
    link: str
    offset: tuple[float, float, float]


# On the joint axes, hands and feet (Sec. VII-A); in the middle of each link sideways is assumed. Hip and shoulder
# markers are on the limb, whose frame has its origin on the joint axis.
MARKERS = (
    Marker(0, "right_hip", "right_thigh", (0.0, 0.0, 0.0)),
    Marker(1, "right_knee", "right_shank", (0.0, 0.0, 0.0)),
    Marker(2, "right_ankle", "right_foot", (0.0, 0.0, 0.0)),
    Marker(3, "left_hip", "left_thigh", (0.0, 0.0, 0.0)),
    Marker(4, "left_knee", "left_shank", (0.0, 0.0, 0.0)),
    Marker(5, "left_ankle", "left_foot", (0.0, 0.0, 0.0)),
    Marker(6, "right_hand", "right_arm", HAND_OFFSET),
    Marker(7, "left_hand", "left_arm", HAND_OFFSET),
    Marker(8, "right_shoulder", "right_arm", (0.0, 0.0, 0.0)),
    Marker(9, "left_shoulder", "left_arm", (0.0, 0.0, 0.0)),
    Marker(10, "right_toe", "right_foot", TOE_OFFSET),
    Marker(11, "left_toe", "left_foot", TOE_OFFSET),
)


def foam_ball(
    position: tuple[float, float, float] = BALL_START, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Ball:
    """Return the ball of the experiments (Sec. VII-A) at a position [m] with a velocity [m/s]."""
    ball = BallConfig()
    # A solid sphere of even density.
    return Ball(ball.radius, ball.mass, 0.4 * ball.mass * ball.radius**2, position, velocity)


def standing_box() -> BoxShape:
    """Return the box under the robot; its front edge is x = 0, its middle y = 0."""
    return BoxShape(
        BOX_NAME, (-0.5 * BOX_DEPTH, 0.0, 0.5 * BOX_HEIGHT), (0.5 * BOX_DEPTH, 0.5 * BOX_WIDTH, 0.5 * BOX_HEIGHT)
    )


def robot_description() -> RobotDescription:
    """Return what a viewer needs to draw the robot on its box."""
    box = standing_box()
    x, y, z = box.half_extents
    return RobotDescription(ROBOT_NAME, URDF, JOINT_NAMES, ((box.center, (2.0 * x, 2.0 * y, 2.0 * z)),))


def ready_scene(
    *,
    ball: Ball | None = None,
    timestep: float = 1e-4,
    friction: float = ContactConfig().friction,
    restitution: float = ContactConfig().restitution,
    sole: Literal["semicircular", "flat"] = "semicircular",
    joint_offset: Array | Sequence[float] | None = None,
    urdf: Path = URDF,
) -> Scene:
    """Place the crouching robot on its box.

    The lowest point of the feet touches the box, and the toe lies `TOE_TO_EDGE` behind the box's front edge, which is
    x = 0. The trunk leans so that the feet are level (on average, if the offsets differ between the legs).

    Args:
        ball: The ball; by default the foam ball where the machine throws it.
        timestep: Length of one step [s].
        friction: Coulomb friction coefficient of every contact [-].
        restitution: Coefficient of restitution of the ball's contacts [-].
        sole: Shape of the soles (Sec. V-A).
        joint_offset: Added to the ready joint angles [rad], shape (8,).
        urdf: Robot model with Liberobot's links and joints.

    Raises:
        BackendError: An offset pushes a joint out of its range.
    """
    if sole == "flat":
        urdf = _flat_sole_copy(urdf)
    model = read_urdf(urdf)
    offset = np.zeros(len(JOINT_NAMES)) if joint_offset is None else np.asarray(joint_offset, dtype=np.float64)
    if offset.shape != (len(JOINT_NAMES),):
        raise BackendError(f"joint_offset has shape {offset.shape}; expected ({len(JOINT_NAMES)},)")
    joint_angle = dict(zip(JOINT_NAMES, (np.array(READY_JOINT_ANGLE) + offset).tolist(), strict=True))
    _check_range(model, joint_angle)
    base_position, pitch = _place(model, joint_angle)
    return Scene(
        urdf=urdf,
        joint_names=JOINT_NAMES,
        link_names=LINK_NAMES,
        base_position=base_position,
        base_quaternion=(float(np.cos(0.5 * pitch)), 0.0, float(np.sin(0.5 * pitch)), 0.0),
        joint_angle=tuple(joint_angle.values()),
        ball=ball if ball is not None else foam_ball(),
        boxes=(standing_box(),),
        timestep=timestep,
        friction=friction,
        restitution=restitution,
    )


def ready_markers() -> dict[str, tuple[float, float, float]]:
    """Return where the markers are in the ready pose, by name, in the world [m]; the robot needs no air for it.

    Those of the hands are left out: arms without air swing.
    """
    scene = ready_scene()
    w, x, y, z = scene.base_quaternion
    poses = read_urdf(scene.urdf).link_poses(
        dict(zip(scene.joint_names, scene.joint_angle, strict=True)),
        np.array(scene.base_position),
        Rotation.from_quat([x, y, z, w]).as_matrix(),
    )
    places = {}
    for marker in MARKERS:
        if marker.offset != HAND_OFFSET:
            position, rotation = poses[marker.link]
            places[marker.name] = tuple((position + rotation @ np.array(marker.offset)).tolist())
    return places


def _check_range(model: RobotModel, joint_angle: dict[str, float]) -> None:
    for name, angle in joint_angle.items():
        limits = model.joints[name].limits
        if limits is not None and not limits[0] - 1e-9 <= angle <= limits[1] + 1e-9:
            low, high = np.degrees(limits)
            raise BackendError(
                f"{name} cannot start at {np.degrees(angle):.3f}°; its range is {low:.0f}..{high:.0f}°. In the ready "
                "pose it is at the end of its range, so offset it inwards"
            )


def _place(model: RobotModel, joint_angle: dict[str, float]) -> tuple[tuple[float, float, float], float]:
    """Return position [m] and forward lean [rad] of the trunk that put level feet on the box."""
    pitch = float(np.mean([joint_angle[h] - joint_angle[k] + joint_angle[a] for h, k, a in LEG_JOINTS]))
    rotation = Rotation.from_euler("y", pitch).as_matrix()
    poses = model.link_poses(joint_angle, np.zeros(3), rotation)
    feet = [(model.links[foot], *poses[foot]) for foot in FOOT_LINKS]
    lowest = min(shape.lowest_point(p, R) for foot, p, R in feet for shape in foot.collisions)
    toe = float(np.mean([(p + R @ np.array(TOE_OFFSET))[0] for _, p, R in feet]))
    return (-TOE_TO_EDGE - toe, 0.0, BOX_HEIGHT - lowest), pitch


@cache
def _flat_sole_copy(urdf: Path) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="imolo-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return with_flat_sole(urdf, folder / f"{urdf.stem}_flat_sole.urdf")


def with_flat_sole(urdf_path: Path, out_path: Path) -> Path:
    """Write a copy of the robot with flat soles, which Sec. V-A says cannot reach sideways.

    The box spans the round sole's heel to toe and reaches as far down; mass and inertia stay, so that the shape is the
    only difference.

    Returns:
        The path written.
    """
    tree = ElementTree.parse(urdf_path)
    model = read_urdf(urdf_path)
    for foot in FOOT_LINKS:
        spheres = [shape for shape in model.links[foot].collisions if shape.kind == "sphere"]
        if not spheres:
            raise BackendError(f"{foot} of {urdf_path} has no round sole to replace")
        heel, toe = (f(shape.position[0] for shape in spheres) for f in (min, max))
        bottom = -max(shape.size[0] for shape in spheres)
        size = f"{toe - heel:.6g} {FLAT_SOLE_WIDTH} {FLAT_SOLE_TOP - bottom:.6g}"
        center = f"{0.5 * (heel + toe):.6g} 0 {0.5 * (FLAT_SOLE_TOP + bottom):.6g}"
        element = next(link for link in tree.getroot().iter("link") if link.get("name") == foot)
        for tag in ("collision", "visual"):
            for old in element.findall(tag):
                element.remove(old)
            new = ElementTree.SubElement(element, tag)
            ElementTree.SubElement(new, "origin", xyz=center)
            ElementTree.SubElement(ElementTree.SubElement(new, "geometry"), "box", size=size)
    tree.write(out_path, encoding="unicode", xml_declaration=True)
    return out_path
