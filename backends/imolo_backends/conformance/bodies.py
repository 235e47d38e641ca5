"""The bodies of the scenes: the kit's own robot and ball, small URDFs, and scenes that hold nothing else."""

import atexit
import shutil
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from imolo.contracts.engine import Array, Ball, BoxShape, Scene
from imolo.contracts.urdf import read_urdf

WEIGHTLESS = (0.0, 0.0, 0.0)
GRAVITY = 9.81  # [m/s²]
ASIDE = (40.0, 0.0, 30.0)  # [m] where a ball is that takes no part in a scene
HIGH = (0.0, 0.0, 50.0)  # [m] where a robot is that takes no part, or that may fall for a while

CONTACT_TIMESTEP = 1e-4  # [s] of scenes with contacts
CONTACT_TIME = 20 * CONTACT_TIMESTEP  # [s] in which the softest contact settles that still counts as rigid
CONTACT_SINK = GRAVITY * CONTACT_TIME**2  # [m] of a body that rests on such a contact

BOX_MASS = 2.0  # [kg]
BOX_SIDES = (0.3, 0.2, 0.1)  # [m]
BOX_INERTIA = tuple(BOX_MASS / 12.0 * (sum(s * s for s in BOX_SIDES) - side * side) for side in BOX_SIDES)  # [kg m²]
ROD_LENGTH = 1.0  # [m]
ROD_MASS = 2.0  # [kg]
ROD_INERTIA = ROD_MASS * ROD_LENGTH**2 / 12.0  # [kg m²] about its middle
ROD_SPIN_INERTIA = 0.001  # [kg m²] about its own axis

TRUNK_MASS = 2.0  # [kg] of the body that straddles
LEG_LENGTH = 0.5  # [m] from its hinge to the middle of the sole
LEG_MASS = 0.5  # [kg]
LEG_COM = 0.2  # [m] below the hinge
LEG_INERTIA = 0.01  # [kg m²] about the COM
SOLE_RADIUS = 0.03  # [m]

FRICTION = 0.8  # [-] where a scene does not say
RESTITUTION = 0.3  # [-] where a scene does not say
BALL_RADIUS = 0.05  # [m]
BALL_MASS = 0.02  # [kg]
BLOCK = BoxShape("block", (-0.3, 0.0, 0.2), (0.5, 0.4, 0.2))
BLOCK_TOP = 0.4  # [m]

ROBOT = Path(__file__).with_name("robot.urdf")
LINK_NAMES = tuple(read_urdf(ROBOT).links)
JOINT_NAMES = tuple(read_urdf(ROBOT).joints)
FOOT_BELOW_HIP = 2.0 * 0.25 * float(np.cos(0.9)) + 0.05  # [m] sole below the trunk's frame, standing in its stops
PLATE_CENTER = (0.0, 0.0, -0.33)  # [m] in the frame of an arm


def _joint_limits() -> Array:
    joints = read_urdf(ROBOT).joints
    return np.array([joints[name].limits for name in JOINT_NAMES], dtype=np.float64)


JOINT_LIMITS = _joint_limits()  # [rad] lowest and highest angle, shape (8, 2)


@cache
def _folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="imolo-bodies-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@cache
def _written(name: str, content: str) -> Path:
    path = _folder() / f"{name}_{abs(hash(content)):x}.urdf"
    path.write_text(f'<robot name="{name}">{content}</robot>', encoding="utf-8")
    return path


def _link(name: str, mass: float, inertia: tuple[float, float, float], com: str = "0 0 0", collision: str = "") -> str:
    ixx, iyy, izz = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{ixx!r}" iyy="{iyy!r}" izz="{izz!r}" ixy="0" ixz="0" iyz="0"/></inertial>{collision}</link>'
    )


def _box_shape(sides: tuple[float, float, float], center: str = "0 0 0") -> str:
    size = " ".join(map(repr, sides))
    return f'<collision><origin xyz="{center}"/><geometry><box size="{size}"/></geometry></collision>'


def body_scene(name: str, content: str, links: tuple[str, ...], joints: tuple[str, ...] = (), **changes: Any) -> Scene:
    """Return a scene of a body given by the inside of its URDF's <robot>, with the ball out of the way.

    The base is at the origin, upright, and there are no boxes; `changes` replace fields of the scene.
    """
    return _scene(_written(name, content), links, joints, **changes)


def _scene(urdf: Path, links: tuple[str, ...], joints: tuple[str, ...], **changes: Any) -> Scene:
    scene = Scene(
        urdf=urdf,
        joint_names=joints,
        link_names=links,
        base_position=(0.0, 0.0, 0.0),
        base_quaternion=(1.0, 0.0, 0.0, 0.0),
        joint_angle=(0.0,) * len(joints),
        ball=solid_ball(ASIDE),
        boxes=(),
        timestep=CONTACT_TIMESTEP,
        friction=FRICTION,
        restitution=RESTITUTION,
    )
    return replace(scene, **changes)


def solid_ball(
    position: tuple[float, float, float] = ASIDE,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    mass: float = BALL_MASS,
) -> Ball:
    """Return the ball of the scenes, of even density, at a position [m] with a velocity [m/s] and of a mass [kg]."""
    return Ball(BALL_RADIUS, mass, 0.4 * mass * BALL_RADIUS**2, position, velocity)


def box_scene(
    sides: tuple[float, float, float] = BOX_SIDES, mass: float = BOX_MASS, collides: bool = True, **changes: Any
) -> Scene:
    """Return a free solid box with these sides [m] and mass [kg]; `changes` replace fields of the scene."""
    squares = [side * side for side in sides]
    ixx, iyy, izz = (mass / 12.0 * (sum(squares) - square) for square in squares)
    link = _link("body", mass, (ixx, iyy, izz), collision=_box_shape(sides) if collides else "")
    return body_scene("box", link, ("body",), **changes)


def lopsided_scene(**changes: Any) -> Scene:
    """Return a free body whose COM and principal axes are off its link frame; `changes` replace fields of the scene."""
    link = (
        '<link name="body"><inertial><origin xyz="0.02 0.01 -0.03" rpy="0.3 0.2 0.1"/><mass value="0.5"/>'
        '<inertia ixx="0.003" iyy="0.002" izz="0.0015" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    return body_scene("lopsided", link, ("body",), **changes)


def overlapping_scene(**changes: Any) -> Scene:
    """Return a stand with two hanging boxes that overlap below their pivots; `changes` replace fields of the scene."""
    links = [_link("stand", 1.0, (0.01, 0.01, 0.01))]
    joints = []
    for name, where in (("one", "0 0 0"), ("two", "0.06 0.03 0")):
        links.append(_link(name, 1.0, (0.01, 0.01, 0.01), collision=_box_shape((0.1, 0.1, 0.4), "0 0 -0.2")))
        joints.append(
            f'<joint name="turn_{name}" type="continuous"><parent link="stand"/><child link="{name}"/>'
            f'<origin xyz="{where}"/><axis xyz="0 1 0"/></joint>'
        )
    names = ("turn_one", "turn_two")
    return body_scene("overlapping", "".join(links + joints), ("stand", "one", "two"), names, **changes)


def pendulum_scene(rods: int = 1, **changes: Any) -> Scene:
    """Return a chain of rods on a fixed stand, hanging down, that turn about y; `changes` replace fields."""
    links = [_link("stand", 1.0, (0.01, 0.01, 0.01))]
    joints = []
    parent, where = "stand", "0 0 0"
    inertia = (ROD_INERTIA, ROD_INERTIA, ROD_SPIN_INERTIA)
    for number in range(1, rods + 1):
        links.append(_link(f"rod_{number}", ROD_MASS, inertia, com=f"0 0 {-0.5 * ROD_LENGTH!r}"))
        joints.append(
            f'<joint name="pivot_{number}" type="continuous"><parent link="{parent}"/><child link="rod_{number}"/>'
            f'<origin xyz="{where}"/><axis xyz="0 1 0"/></joint>'
        )
        parent, where = f"rod_{number}", f"0 0 {-ROD_LENGTH!r}"
    names = tuple(f"rod_{number}" for number in range(1, rods + 1))
    scene = body_scene(
        "pendulum", "".join(links + joints), ("stand", *names), tuple(n.replace("rod", "pivot") for n in names)
    )
    return replace(scene, base_position=HIGH, fixed_base=True, **changes)


def straddling_scene(splay: float, **changes: Any) -> Scene:
    """Return a body on two legs without joint limits, splayed [rad] to front and back; `changes` replace fields.

    Each leg stands on a pair of spheres. There is no friction: the soles slide as the legs close.
    """
    links = [_link("trunk", TRUNK_MASS, (0.01, 0.01, 0.01))]
    joints = []
    feet = "".join(
        f'<collision><origin xyz="0 {y} {-LEG_LENGTH!r}"/><geometry><sphere radius="{SOLE_RADIUS!r}"/></geometry>'
        "</collision>"
        for y in (-0.2, 0.2)
    )
    for name, axis in (("front", -1), ("back", 1)):
        inertia = (LEG_INERTIA, LEG_INERTIA, ROD_SPIN_INERTIA)
        links.append(_link(name, LEG_MASS, inertia, com=f"0 0 {-LEG_COM!r}", collision=feet))
        joints.append(
            f'<joint name="{name}_hip" type="continuous"><parent link="trunk"/><child link="{name}"/>'
            f'<axis xyz="0 {axis} 0"/></joint>'
        )
    height = SOLE_RADIUS + LEG_LENGTH * float(np.cos(splay))
    scene = body_scene(
        "straddler", "".join(links + joints), ("trunk", "front", "back"), ("front_hip", "back_hip"), friction=0.0
    )
    return replace(scene, base_position=(0.0, 0.0, height), joint_angle=(splay, splay), **changes)


def tilted_gravity(angle: float) -> tuple[float, float, float]:
    """Return gravity [m/s²] that makes the floor a ramp going down along x at this angle [rad]."""
    return (GRAVITY * float(np.sin(angle)), 0.0, -GRAVITY * float(np.cos(angle)))


def ball_scene(ball: Ball, **changes: Any) -> Scene:
    """Return a ball alone above the floor, the robot a body fixed far up; `changes` replace fields of the scene."""
    return replace(box_scene(collides=False), base_position=HIGH, fixed_base=True, ball=ball, **changes)


def flying_robot(**changes: Any) -> Scene:
    """Return the robot high in the air, its joints in the middle of their ranges; `changes` replace fields."""
    middle = tuple(np.mean(JOINT_LIMITS, axis=1).tolist())
    return replace(_scene(ROBOT, LINK_NAMES, JOINT_NAMES), **{"base_position": HIGH, "joint_angle": middle, **changes})


def standing_robot(**changes: Any) -> Scene:
    """Return the robot on the block, bent into its stops, arms hanging at theirs; `changes` replace fields."""
    bent = (*JOINT_LIMITS[:6, 1].tolist(), *JOINT_LIMITS[6:, 0].tolist())
    place = {"base_position": (0.0, 0.0, BLOCK_TOP + FOOT_BELOW_HIP), "joint_angle": bent, "boxes": (BLOCK,)}
    return replace(_scene(ROBOT, LINK_NAMES, JOINT_NAMES), **{**place, **changes})


def hanging_robot(**changes: Any) -> Scene:
    """Return the robot fixed and upright, weightless, legs straight and arms hanging at their stops."""
    return flying_robot(fixed_base=True, gravity=WEIGHTLESS, joint_angle=(0.0,) * len(JOINT_NAMES), **changes)


def hanging_links() -> dict[str, tuple[Array, Array]]:
    """Return where the links of `hanging_robot` are: position [m] and rotation matrix of each frame."""
    return read_urdf(ROBOT).link_poses({}, np.array(hanging_robot().base_position), np.eye(3))


def moved(place: Array, *offset: float) -> tuple[float, float, float]:
    """Return a place [m] plus an offset [m]."""
    x, y, z = (place + np.array(offset)).tolist()
    return x, y, z
