"""What every engine checks and collects in the same way: the model it loaded and the ball's contacts."""

from collections.abc import Iterable, Sequence

import numpy as np

from imolo.contracts.engine import Array, BallContact, Scene
from imolo.contracts.urdf import RobotModel
from imolo.errors import BackendError, did_you_mean

FLOOR = "floor"
RELATIVE_TOLERANCE = 1e-6  # Loading a model copies numbers; PyBullet diagonalises inertias on the way.

Touch = tuple[str, Sequence[float] | Array, float]
"""What the ball touched, where [m], and with which normal force [N]."""


def check_scene(scene: Scene, model: RobotModel) -> None:
    """Check that the scene asks for what the URDF has.

    Raises:
        BackendError: A joint or link is not in the URDF, or arrays do not fit together.
    """
    for what, names, known in (("joint", scene.joint_names, model.joints), ("link", scene.link_names, model.links)):
        for name in names:
            if name not in known:
                raise BackendError(f"{what} {name!r} is not in {scene.urdf.name}{did_you_mean(name, known)}")
    movable = {joint.name for joint in model.joints.values() if joint.kind != "fixed"}
    if movable != set(scene.joint_names):
        raise BackendError(f"{scene.urdf.name} moves {sorted(movable)}; the scene names {sorted(scene.joint_names)}")
    if scene.link_names[0] != model.base:
        raise BackendError(f"first link is {scene.link_names[0]!r}; expected the base {model.base!r}")
    if len(scene.joint_angle) != len(scene.joint_names):
        raise BackendError(f"{len(scene.joint_angle)} joint angles for {len(scene.joint_names)} joints")
    reserved = [FLOOR, *model.links]
    for box in scene.boxes:
        if box.name in reserved:
            raise BackendError(f"box name {box.name!r} is taken by the floor, a link or another box")
        reserved.append(box.name)


def check_value(what: str, loaded: float | Sequence[float] | Array, expected: float | Sequence[float] | Array) -> None:
    """Raise `BackendError` naming the value unless the engine holds what it was given."""
    got, want = np.asarray(loaded, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    scale = float(np.abs(want).max(initial=0.0))
    if got.shape != want.shape or not np.allclose(got, want, rtol=0.0, atol=RELATIVE_TOLERANCE * scale + 1e-12):
        raise BackendError(f"{what} is {got.tolist()} in the engine; expected {want.tolist()}")


def check_links(model: RobotModel, loaded: dict[str, tuple[float, Array, Array]]) -> None:
    """Compare the links with the URDF.

    Args:
        model: What the URDF says.
        loaded: By link: mass [kg], COM in the link frame [m], and inertia about the COM in link axes [kg m²].

    Raises:
        BackendError: A link is missing, or a value differs.
    """
    for name, link in model.links.items():
        if name not in loaded:
            raise BackendError(f"link {name!r} is missing in the engine; it has {sorted(loaded)}")
        mass, com, inertia = loaded[name]
        check_value(f"mass of {name} [kg]", mass, link.mass)
        check_value(f"COM of {name} [m]", com, link.com)
        check_value(f"inertia of {name} [kg m²]", inertia, link.inertia)
    check_value("total mass of the robot [kg]", sum(mass for mass, _, _ in loaded.values()), model.mass)


def merge_touches(time: float, touches: Iterable[Touch]) -> list[BallContact]:
    """Merge the contact points of one step into one contact per touched body, at the force-weighted middle."""
    points: dict[str, list[tuple[Array, float]]] = {}
    for other, position, force in touches:
        if force > 0.0:
            points.setdefault(other, []).append((np.array(position, dtype=np.float64), force))
    contacts = []
    for other, parts in points.items():
        total = sum(force for _, force in parts)
        middle = np.sum([force * position for position, force in parts], axis=0) / total
        contacts.append(BallContact(time, other, middle, total))
    return contacts


def rotation_matrices(quaternions: Array) -> Array:
    """Convert unit quaternions x, y, z, w, shape (N, 4), to rotation matrices, shape (N, 3, 3)."""
    x, y, z, w = quaternions.T
    matrices = np.empty((len(quaternions), 3, 3))
    matrices[:, 0, 0] = 1.0 - 2.0 * (y * y + z * z)
    matrices[:, 0, 1] = 2.0 * (x * y - w * z)
    matrices[:, 0, 2] = 2.0 * (x * z + w * y)
    matrices[:, 1, 0] = 2.0 * (x * y + w * z)
    matrices[:, 1, 1] = 1.0 - 2.0 * (x * x + z * z)
    matrices[:, 1, 2] = 2.0 * (y * z - w * x)
    matrices[:, 2, 0] = 2.0 * (x * z - w * y)
    matrices[:, 2, 1] = 2.0 * (y * z + w * x)
    matrices[:, 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return matrices


def base_rotation(scene: Scene) -> Array:
    """Return the rotation matrix of the base link at the start, shape (3, 3)."""
    w, x, y, z = scene.base_quaternion
    matrix: Array = rotation_matrices(np.array([[x, y, z, w]]))[0]
    return matrix


def turned_inertia(quaternion: Array, moments: Array) -> Array:
    """Return the inertia in link axes, shape (3, 3), from its principal moments and axes (x, y, z, w)."""
    axes = rotation_matrices(quaternion[None, :])[0]
    inertia: Array = axes @ np.diag(moments) @ axes.T
    return inertia
