"""Liberobot's body (Sec. V-A): its names, its ready pose on the box, its soles."""

from functools import cache, partial
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation

from imolo.config.experiment import RobotConfig
from imolo.contracts.engine import BoxShape
from imolo.contracts.robot import Body, Effector, Foot, Marker, Pose
from imolo.contracts.urdf import read_urdf
from imolo.errors import BackendError
from imolo.machine.files import process_folder

Array = NDArray[np.float64]

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
LEG_JOINTS = (("right_hip", "right_knee", "right_ankle"), ("left_hip", "left_knee", "left_ankle"))

# The legs rest at the ends of their range (Sec. VII-A); arms down is assumed, since valve 8 lowers them.
READY_JOINT_ANGLE = tuple(np.radians([150.0, 150.0, 45.0, 150.0, 150.0, 45.0, 0.0, 0.0]).tolist())  # [rad]
PLATE_WIDTH = 0.080  # [m] short side, which points sideways, Sec. V-A
ARM_LENGTH = 0.50  # [m] shoulder to the end of the plate, Sec. V-A
HAND_OFFSET = (0.0, 0.0, -0.35)  # [m] centre of the plate in the arm frame, derived from Sec. V-A
TOE_OFFSET = (0.150, 0.0, 0.0)  # [m] front end of the 211 mm foot in the foot frame, assumed
SOLE_RADIUS = 0.048  # [m] Sec. V-A; the foot frame is this high above the ground
FLAT_SOLE_WIDTH = 2.0 * SOLE_RADIUS  # [m] as wide as the half cylinder
FLAT_SOLE_TOP = -0.020  # [m] in the foot frame, assumed: below the ankle

BOX_HEIGHT = 0.400  # [m] Sec. VII-A
BOX_DEPTH = 0.800  # [m] along x, assumed: more than the foot
BOX_WIDTH = 0.800  # [m] along y, assumed: more than the robot
TOE_TO_EDGE = 0.020  # [m] assumed: the feet are marked on the box (Sec. VII-A), where is not said

# On the joint axes, hands and feet (Sec. VII-A); in the middle of each link sideways is assumed. Hip and shoulder
# markers are on the limb, whose frame has its origin on the joint axis.
MARKERS = (
    Marker(0, "right_hip", "right_thigh"),
    Marker(1, "right_knee", "right_shank"),
    Marker(2, "right_ankle", "right_foot"),
    Marker(3, "left_hip", "left_thigh"),
    Marker(4, "left_knee", "left_shank"),
    Marker(5, "left_ankle", "left_foot"),
    Marker(6, "right_hand", "right_arm", HAND_OFFSET),
    Marker(7, "left_hand", "left_arm", HAND_OFFSET),
    Marker(8, "right_shoulder", "right_arm"),
    Marker(9, "left_shoulder", "left_arm"),
    Marker(10, "right_toe", "right_foot", TOE_OFFSET),
    Marker(11, "left_toe", "left_foot", TOE_OFFSET),
)
EFFECTORS = tuple(
    Effector(f"{side}_hand", f"{side}_arm", PLATE_WIDTH, f"{side}_shoulder", ARM_LENGTH) for side in ("right", "left")
)
# The front edge of the box under the robot is x = 0, its middle y = 0.
STANDING_BOX = BoxShape(
    "box", (-0.5 * BOX_DEPTH, 0.0, 0.5 * BOX_HEIGHT), (0.5 * BOX_DEPTH, 0.5 * BOX_WIDTH, 0.5 * BOX_HEIGHT)
)


class LiberobotOptions(RobotConfig):
    """What can be chosen of the body."""

    sole: Literal["semicircular", "flat"] = Field("semicircular", description="Sec. V-A")


@cache
def liberobot(options: RobotConfig) -> Body:
    """Return the body of Liberobot."""
    flat = isinstance(options, LiberobotOptions) and options.sole == "flat"
    urdf = _flat_sole_copy(URDF) if flat else URDF
    return Body(
        name=options.name,
        urdf=urdf,
        markers=MARKERS,
        effectors=EFFECTORS,
        base=partial(stand_on_box, urdf),
        joint_names=JOINT_NAMES,
        link_names=LINK_NAMES,
        ready=READY_JOINT_ANGLE,
        feet=tuple(Foot(link, SOLE_RADIUS) for link in FOOT_LINKS),
        boxes=(STANDING_BOX,),
        mirrored_joints={name: _other_side(name) for name in JOINT_NAMES},
    )


def _other_side(name: str) -> str:
    side, part = name.split("_", 1)
    return f"{'left' if side == 'right' else 'right'}_{part}"


def stand_on_box(urdf: Path, angles: Array) -> Pose:
    """Return the pose of the trunk that puts the feet on the box.

    The lowest point of the feet touches the box, and the toe lies `TOE_TO_EDGE` behind the box's front edge. The trunk
    leans so that the feet are level (on average, if the angles differ between the legs).

    Args:
        urdf: Model with Liberobot's links and joints.
        angles: Of the joints [rad], shape (8,).
    """
    model = read_urdf(urdf)
    joint_angle = dict(zip(JOINT_NAMES, angles.tolist(), strict=True))
    pitch = float(np.mean([joint_angle[h] - joint_angle[k] + joint_angle[a] for h, k, a in LEG_JOINTS]))
    rotation = Rotation.from_euler("y", pitch).as_matrix()
    poses = model.link_poses(joint_angle, np.zeros(3), rotation)
    feet = [(model.links[foot], *poses[foot]) for foot in FOOT_LINKS]
    lowest = min(shape.lowest_point(p, R) for foot, p, R in feet for shape in foot.collisions)
    toe = float(np.mean([(p + R @ np.array(TOE_OFFSET))[0] for _, p, R in feet]))
    quaternion = (float(np.cos(0.5 * pitch)), 0.0, float(np.sin(0.5 * pitch)), 0.0)
    return (-TOE_TO_EDGE - toe, 0.0, BOX_HEIGHT - lowest), quaternion


@cache
def _flat_sole_copy(urdf: Path) -> Path:
    return with_flat_sole(urdf, process_folder() / f"{urdf.stem}_flat_sole.urdf")


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
