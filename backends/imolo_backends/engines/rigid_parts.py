"""A robot without its fixed joints: what they hold together is one rigid part, for engines whose joints can give."""

from dataclasses import dataclass, replace

import numpy as np

from imolo.contracts.engine import Array
from imolo.contracts.urdf import Link, RobotModel


@dataclass(frozen=True)
class Place:
    """Where a link is: the part it belongs to, named as its first link, and its pose in that link's frame.

    Attributes:
        part: Name of the part.
        position: Origin of the link frame [m], shape (3,).
        rotation: Rotation matrix, shape (3, 3).
    """

    part: str
    position: Array
    rotation: Array


def find_places(robot: RobotModel) -> dict[str, Place]:
    """Return the place of every link."""
    poses = robot.link_poses({}, np.zeros(3), np.eye(3))
    places = {}
    for name, (position, rotation) in poses.items():
        part = robot.parts[name]
        part_position, part_rotation = poses[part]
        places[name] = Place(part, part_rotation.T @ (position - part_position), part_rotation.T @ rotation)
    return places


def merge_fixed(robot: RobotModel) -> RobotModel:
    """Return the robot with one link per rigid part and without fixed joints; a part's collision shapes are left out.

    A part has the name and the frame of its first link, the masses, the common COM and, by Steiner's theorem, the
    inertias of all its links.
    """
    places = find_places(robot)
    links = {part: _merge(robot, part, places) for part in dict.fromkeys(place.part for place in places.values())}
    joints = {}
    for joint in robot.joints.values():
        if joint.kind != "fixed":
            place = places[joint.parent]
            joints[joint.name] = replace(
                joint,
                parent=place.part,
                position=place.position + place.rotation @ joint.position,
                rotation=place.rotation @ joint.rotation,
            )
    return RobotModel(robot.name, links, joints)


def _merge(robot: RobotModel, part: str, places: dict[str, Place]) -> Link:
    members = [(robot.links[name], place) for name, place in places.items() if place.part == part]
    mass = sum(link.mass for link, _ in members)
    coms = [place.position + place.rotation @ link.com for link, place in members]
    com = sum((link.mass * at for (link, _), at in zip(members, coms, strict=True)), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for (link, place), at in zip(members, coms, strict=True):
        arm = at - com
        inertia += place.rotation @ link.inertia @ place.rotation.T
        inertia += link.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Link(part, mass, com, inertia, ())
