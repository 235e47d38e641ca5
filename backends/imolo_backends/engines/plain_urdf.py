"""The copy of a URDF that engines load: nothing in it that they would read in different ways."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import numpy as np

from imolo.contracts.engine import Array
from imolo.contracts.urdf import Joint, Link, RobotModel

KEPT = {"link": ("inertial", "collision"), "joint": ("origin", "parent", "child", "axis", "limit")}
# Engines clip at the limits of a motor; ours are the actuators' affair.
NO_LIMIT = "1e9"
# [kg, kg m²] of a link that has none: PyBullet and DART would take 1 kg for it.
NO_MASS, NO_INERTIA = 1e-9, 1e-12


def fill_masses(model: RobotModel) -> RobotModel:
    """Return the robot with a mass too small to matter for each link that has none, which never moves on its own."""
    filled = {
        name: link if link.mass > 0.0 else replace(link, mass=NO_MASS, inertia=NO_INERTIA * np.eye(3))
        for name, link in model.links.items()
    }
    return replace(model, links=filled)


@contextmanager
def plain_urdf(path: Path, robot: RobotModel) -> Iterator[Path]:
    """Write a copy of a URDF with only what a rigid body is, and remove it at the end.

    Left out are what is seen, damping and friction of joints, mimic and all extensions; effort and speed have no limit.
    Axes have length 1. Each mesh is its convex hull, in a file beside the copy.

    Args:
        path: The robot's own URDF.
        robot: What it says, with `fill_masses`.

    Yields:
        Path of the copy.
    """
    root = ElementTree.parse(path).getroot()
    hulls = (f"hull_{number}.obj" for number in count())
    with TemporaryDirectory(prefix="imolo-") as folder:
        for element in list(root):
            name = element.get("name", "")
            if name not in (robot.links if element.tag == "link" else robot.joints) or element.tag not in KEPT:
                root.remove(element)
                continue
            for part in list(element):
                if part.tag not in KEPT[element.tag]:
                    element.remove(part)
            if element.tag == "joint":
                _free(element, robot.joints[name])
            else:
                _fill(element, robot.links[name], Path(folder), hulls)
        copy = Path(folder) / path.name
        ElementTree.ElementTree(root).write(copy, encoding="utf-8", xml_declaration=True)
        yield copy


def _fill(element: ElementTree.Element, link: Link, folder: Path, hulls: Iterator[str]) -> None:
    if link.mass == NO_MASS or link.thin:
        _replace_inertial(element, link)
    for collision, shape in zip(element.findall("collision"), link.collisions, strict=True):
        if shape.mesh is not None:
            name = next(hulls)
            shape.mesh.write_obj(folder / name)
            next(collision.iter("mesh")).attrib = {"filename": name}


def _replace_inertial(element: ElementTree.Element, link: Link) -> None:
    for old in element.findall("inertial"):
        element.remove(old)
    new = ElementTree.SubElement(element, "inertial")
    ElementTree.SubElement(new, "origin", xyz=_text(link.com))
    ElementTree.SubElement(new, "mass", value=repr(link.mass))
    moments = map(repr, link.inertia[np.triu_indices(3)].tolist())
    ElementTree.SubElement(new, "inertia", dict(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), moments, strict=True)))


def _text(vector: Array) -> str:
    return " ".join(map(repr, vector.tolist()))


def _free(element: ElementTree.Element, joint: Joint) -> None:
    for limit in element.findall("limit"):
        limit.set("effort", NO_LIMIT)
        limit.set("velocity", NO_LIMIT)
    for axis in element.findall("axis"):
        element.remove(axis)
    if joint.axis.any():
        ElementTree.SubElement(element, "axis", xyz=_text(joint.axis))
