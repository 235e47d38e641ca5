"""Masses and centres of mass of a robot's links as settings: any robot's model, changed in a copy."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from imolo.config.model import Model, Positive, Vector
from imolo.contracts.mesh import find_mesh
from imolo.contracts.urdf import read_urdf
from imolo.errors import BackendError, ConfigError, did_you_mean
from imolo.machine.files import process_folder

MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


class LinkConfig(Model):
    """What is different of one link; what is not given stays as the model says.

    Attributes:
        mass: Its own [kg]; the inertia about its centre of mass grows with it.
        center_of_mass: In the frame of the link [m].
    """

    mass: Positive | None = None
    center_of_mass: Vector | None = None


def link_as_it_is(urdf: Path, name: str) -> LinkConfig:
    """Return what a model says of a link.

    Raises:
        ConfigError: There is no such link, or it has no mass.
    """
    links = {key: link for key, link in read_urdf(urdf).links.items() if link.mass > 0.0}
    if name not in links:
        raise ConfigError(
            f"robot.links: {urdf.name} has no link {name!r} with a mass{did_you_mean(name, list(links))}; "
            f"known: {', '.join(links)}"
        )
    x, y, z = links[name].com.tolist()
    return LinkConfig(mass=links[name].mass, center_of_mass=(x, y, z))


def with_links(urdf: Path, links: Mapping[str, LinkConfig]) -> Path:
    """Return a copy of a model whose links are changed; it lives as long as the process.

    Raises:
        ConfigError: There is no such link, or it has no mass.
    """
    original = {name: link_as_it_is(urdf, name) for name in links}
    root = ElementTree.parse(urdf).getroot()
    for element in root.findall("link"):
        if (name := element.get("name", "")) in links:
            _change(element, original[name], links[name])
    for mesh in root.iter("mesh"):
        try:
            mesh.set("filename", str(find_mesh(mesh.get("filename", ""), urdf.parent).resolve()))
        except BackendError:  # of what is seen alone; what collides was found by `read_urdf`
            continue
    text = ElementTree.tostring(root)
    copy = process_folder() / f"{urdf.stem}_{hashlib.sha256(text).hexdigest()[:12]}.urdf"
    copy.write_bytes(text)
    return copy


def _change(element: ElementTree.Element, original: LinkConfig, changed: LinkConfig) -> None:
    inertial = element.find("inertial")
    assert inertial is not None and original.mass is not None  # noqa: PT018 - `link_as_it_is`
    if changed.mass is not None:
        for mass in inertial.iter("mass"):
            mass.set("value", repr(changed.mass))
        for inertia in inertial.iter("inertia"):
            for key in MOMENTS:
                inertia.set(key, repr(float(inertia.get(key, "0")) * (changed.mass / original.mass)))
    if changed.center_of_mass is not None:
        origin = inertial.find("origin")
        if origin is None:
            origin = ElementTree.SubElement(inertial, "origin")
        origin.set("xyz", " ".join(map(repr, changed.center_of_mass)))
