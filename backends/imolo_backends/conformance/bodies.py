"""The bodies of the scenes: small URDFs, and scenes that hold nothing else."""

import atexit
import shutil
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from imolo.contracts.engine import Ball, Scene
from imolo_robots.liberobot.body import JOINT_LIMITS, foam_ball, ready_scene

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
    scene = replace(
        ready_scene(ball=foam_ball(ASIDE)),
        urdf=_written(name, content),
        link_names=links,
        joint_names=joints,
        joint_angle=(0.0,) * len(joints),
        base_position=(0.0, 0.0, 0.0),
        base_quaternion=(1.0, 0.0, 0.0, 0.0),
        boxes=(),
    )
    return replace(scene, **changes)


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


def tilted_gravity(angle: float) -> tuple[float, float, float]:
    """Return gravity [m/s²] that makes the floor a ramp going down along x at this angle [rad]."""
    return (GRAVITY * float(np.sin(angle)), 0.0, -GRAVITY * float(np.cos(angle)))


def ball_scene(ball: Ball, **changes: Any) -> Scene:
    """Return a ball alone above the floor, the robot a body fixed far up; `changes` replace fields of the scene."""
    return replace(box_scene(collides=False), base_position=HIGH, fixed_base=True, ball=ball, **changes)


def flying_robot(**changes: Any) -> Scene:
    """Return Liberobot high in the air, its joints in the middle of their ranges; `changes` replace fields."""
    middle = tuple(np.mean(JOINT_LIMITS, axis=1).tolist())
    scene = replace(ready_scene(ball=foam_ball(ASIDE)), base_position=HIGH, joint_angle=middle)
    return replace(scene, **changes)
