"""The shapes of a robot, from the visuals of its URDF, in the form in which the page draws them."""

from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

from scipy.spatial.transform import Rotation

from imolo.contracts.robot import Body
from imolo.errors import ResultsError

DEFAULT_COLOR = (0.7, 0.7, 0.7, 1.0)
MOVING = ("revolute", "continuous", "prismatic")


def robot_shapes(body: Body) -> dict[str, Any]:
    """Return what the page needs to draw a robot at any pose.

    Boxes, cylinders (along z) and spheres are drawn; meshes are left out, since the page holds no files.

    Returns:
        `links`, parents before children, each with its parent's number (-1: the world), its joint (`at` [m], `turn` as
        quaternion w, x, y, z, `axis`, `angle`: which of TRUTH_ROBOT's angles moves it, -1 none, whether it `slides`)
        and its `shapes` (kind, size [m], place, color); and the fixed `boxes` around the robot.

    Raises:
        ResultsError: The URDF cannot be read.
    """
    try:
        robot = ElementTree.parse(body.urdf).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise ResultsError(f"cannot read the robot's URDF {body.urdf}: {error}; reinstall the backend") from error
    materials = {
        material.get("name"): _numbers(color.get("rgba"))
        for material in robot.findall("material")
        if (color := material.find("color")) is not None
    }
    links = {link.get("name"): _shapes(link, materials) for link in robot.findall("link")}
    joints = robot.findall("joint")
    children = {_end(joint, "child") for joint in joints}
    order = [name for name in links if name not in children]
    placed = [{"parent": -1, "shapes": links[name]} for name in order]
    # Breadth first, so that a parent is posed before its children.
    for parent in order:
        for joint in joints:
            if _end(joint, "parent") == parent:
                child = _end(joint, "child")
                placed.append({**_joint(joint, body.joint_names, order.index(parent)), "shapes": links[child]})
                order.append(child)
    boxes = [{"at": list(box.center), "size": [2.0 * half for half in box.half_extents]} for box in body.boxes]
    return {"name": body.name, "links": placed, "boxes": boxes}


def _end(joint: ElementTree.Element, tag: str) -> str | None:
    element = joint.find(tag)
    return None if element is None else element.get("link")


def _joint(joint: ElementTree.Element, angles: Sequence[str], parent: int) -> dict[str, Any]:
    name, kind = joint.get("name", ""), joint.get("type", "")
    axis = joint.find("axis")
    return {
        "parent": parent,
        **_place(joint.find("origin")),
        "axis": [1.0, 0.0, 0.0] if axis is None else _numbers(axis.get("xyz")),
        "angle": angles.index(name) if kind in MOVING and name in angles else -1,
        "slides": kind == "prismatic",
    }


def _shapes(link: ElementTree.Element, materials: dict[str | None, list[float]]) -> list[dict[str, Any]]:
    shapes = []
    for visual in link.findall("visual"):
        geometry = visual.find("geometry")
        material = visual.find("material")
        own = None if material is None else material.find("color")
        color = _numbers(own.get("rgba")) if own is not None else None
        if color is None and material is not None:
            color = materials.get(material.get("name"))
        for element in () if geometry is None else geometry:
            size = _size(element)
            if size:
                shapes.append(
                    {
                        "kind": element.tag,
                        "size": size,
                        **_place(visual.find("origin")),
                        "color": color or list(DEFAULT_COLOR),
                    }
                )
    return shapes


def _size(element: ElementTree.Element) -> list[float]:
    """Return the side lengths of what surrounds a shape [m]; empty for one that is not drawn."""
    if element.tag == "box":
        return _numbers(element.get("size"))
    width = 2.0 * float(element.get("radius", 0.0))
    if element.tag == "cylinder":
        return [width, width, float(element.get("length", 0.0))]
    return [width] * 3 if element.tag == "sphere" else []


def _place(origin: ElementTree.Element | None) -> dict[str, list[float]]:
    position = [0.0] * 3 if origin is None else _numbers(origin.get("xyz", "0 0 0"))
    angles = [0.0] * 3 if origin is None else _numbers(origin.get("rpy", "0 0 0"))
    # URDF: roll, pitch, yaw about the fixed axes.
    x, y, z, w = Rotation.from_euler("xyz", angles).as_quat().tolist()
    return {"at": position, "turn": [round(part, 7) for part in (w, x, y, z)]}


def _numbers(text: str | None) -> list[float]:
    return [float(part) for part in (text or "").split()]
