"""The bodies of the scenes: small URDFs, and scenes that hold nothing else."""

import atexit
import shutil
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from imolo_backends.engine import Ball, Scene
from imolo_backends.liberobot import JOINT_LIMITS, foam_ball, ready_scene

WEIGHTLESS = (0.0, 0.0, 0.0)
GRAVITY = 9.81  # [m/s²]
ASIDE = (40.0, 0.0, 30.0)  # [m] where a ball is that takes no part in a scene
HIGH = (0.0, 0.0, 50.0)  # [m] where a robot is that takes no part, or that may fall for a while

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


def _box_shape(sides: tuple[float, float, float]) -> str:
    size = " ".join(map(repr, sides))
    return f'<collision><geometry><box size="{size}"/></geometry></collision>'


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


def ball_scene(ball: Ball, **changes: Any) -> Scene:
    """Return a ball alone above the floor, the robot a body fixed far up; `changes` replace fields of the scene."""
    return replace(box_scene(collides=False), base_position=HIGH, fixed_base=True, ball=ball, **changes)


def flying_robot(**changes: Any) -> Scene:
    """Return Liberobot high in the air, its joints in the middle of their ranges; `changes` replace fields."""
    middle = tuple(np.mean(JOINT_LIMITS, axis=1).tolist())
    scene = replace(ready_scene(ball=foam_ball(ASIDE)), base_position=HIGH, joint_angle=middle)
    return replace(scene, **changes)
