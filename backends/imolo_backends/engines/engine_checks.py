"""What is checked and collected in the same way for every engine: the model it loaded and the ball's contacts."""

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numba import njit

from imolo.contracts.engine import Array, BallContact, Scene
from imolo.contracts.urdf import RobotModel
from imolo.errors import BackendError, did_you_mean
from imolo_backends.engines.rigid_parts import merge_fixed

FLOOR = "floor"
NEGLIGIBLE = 1e-6  # [kg] less than any real link; `plain_urdf` gives less to a link without mass
RELATIVE_TOLERANCE = 1e-6  # Loading a model copies numbers; PyBullet diagonalises inertias on the way.

UNTOUCHED = 1e-9  # [m/s] rounding of the ball's velocity in a step, with a wide margin; 1e-7 N would do more

Touch = tuple[str, Sequence[float] | Array, float]
"""What the ball touched, where [m], and with which normal force [N]."""

Numbers = float | Sequence[float] | Array
Body = tuple[float, Numbers, Array]
"""Mass [kg], COM in the body's frame [m], shape (3,), and inertia about the COM in the frame's axes [kg m²], (3, 3)."""


@dataclass(frozen=True)
class Loaded:
    """What an engine says that it holds, read back from it.

    Attributes:
        links: The links; of a fixed base, any mass will do.
        ball: The ball.
        gravity: Acceleration of free fall [m/s²], shape (3,).
        limits: By joint: lowest and highest angle [rad] or way [m]; joints without limits are left out.
        timestep: Length of a step [s]; None where it is an argument of every step.
        friction: Of each shape or body its name and coefficient of friction, in the scene's terms [-]; empty where it
            is set at every contact.
        welded: Whether what fixed joints hold together is one body, under the name of its first link.
        resistance: By joint: damping, friction and whatever else resists it, which must all be 0.
    """

    links: Mapping[str, Body]
    ball: Body
    gravity: Numbers
    limits: Mapping[str, Sequence[float]]
    timestep: float | None
    friction: Sequence[tuple[str, float]] = ()
    welded: bool = False
    resistance: Mapping[str, Numbers] = field(default_factory=dict)


def check_loaded(scene: Scene, model: RobotModel, loaded: Loaded) -> None:
    """Compare what an engine holds with what the scene and the URDF ask for.

    Raises:
        BackendError: Something is missing, or a value differs.
    """
    parts = merge_fixed(model) if loaded.welded else model
    if set(loaded.links) != set(parts.links):
        raise BackendError(f"links are {sorted(loaded.links)} in the engine; expected {sorted(parts.links)}")
    for name, link in parts.links.items():
        if not (scene.fixed_base and name == parts.base):
            _check_body(name, loaded.links[name], (link.mass, link.com, link.inertia))
    _check_body("the ball", loaded.ball, (scene.ball.mass, np.zeros(3), scene.ball.inertia * np.eye(3)))
    check_value("gravity [m/s²]", loaded.gravity, scene.gravity)
    if loaded.timestep is not None:
        check_value("timestep [s]", loaded.timestep, scene.timestep)
    for name, friction in loaded.friction:
        check_value(f"friction of {name} [-]", friction, scene.friction)
    for name, resistance in loaded.resistance.items():
        check_value(f"damping and friction of {name}", resistance, np.zeros(np.shape(resistance)))
    for name in scene.joint_names:
        limits = model.joints[name].limits
        if (limits is not None) != (name in loaded.limits):
            raise BackendError(f"limits of {name} are {loaded.limits.get(name)} in the engine; expected {limits}")
        if limits is not None:
            check_value(f"limits of {name} [rad or m]", loaded.limits[name], limits)


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
    if model.links[model.base].mass < NEGLIGIBLE and not scene.fixed_base:
        raise BackendError(f"base {model.base!r} has no mass and is to move; give it an <inertial>, or set fixed_base")
    if len(scene.joint_angle) != len(scene.joint_names):
        raise BackendError(f"{len(scene.joint_angle)} joint angles for {len(scene.joint_names)} joints")
    reserved = [FLOOR, *model.links]
    for box in scene.boxes:
        if box.name in reserved:
            raise BackendError(f"box name {box.name!r} is taken by the floor, a link or another box")
        reserved.append(box.name)


def check_value(what: str, loaded: Numbers, expected: Numbers) -> None:
    """Raise `BackendError` naming the value unless the engine holds what it was given."""
    got, want = np.asarray(loaded, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    scale = float(np.abs(want).max(initial=0.0))
    if got.shape != want.shape or not np.allclose(got, want, rtol=0.0, atol=RELATIVE_TOLERANCE * scale + 1e-12):
        raise BackendError(f"{what} is {got.tolist()} in the engine; expected {want.tolist()}")


def _check_body(name: str, loaded: Body, expected: Body) -> None:
    for what, held, wanted in zip(("mass [kg]", "COM [m]", "inertia [kg m²]"), loaded, expected, strict=True):
        quantity, unit = what.split(" ", 1)
        check_value(f"{quantity} of {name} {unit}", held, wanted)


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


class BallWatch:
    """Tells from its velocity whether something touched the ball; looking for contacts at every step would cost more.

    Plain numbers, of which NumPy would take six times as long.

    Attributes:
        velocity: After the last step [m/s].
        changes: What changes it in a step without a touch: a force, by [s/kg]; gravity, by [m/s]; shape (4,).
    """

    def __init__(self, scene: Scene) -> None:
        self.velocity: Sequence[float] = scene.ball.velocity
        self._gain = scene.timestep / scene.ball.mass  # [s/kg]
        self._fall = [g * scene.timestep for g in scene.gravity]  # [m/s] in a step
        self.changes = np.array([self._gain, *self._fall])

    def touched(self, after: Sequence[float], force: Sequence[float], rounding: float = UNTOUCHED) -> bool:
        """Take the velocity after a step, and return whether more than gravity and a force [N] changed it.

        Args:
            after: The velocity [m/s].
            force: On the ball in this step [N].
            rounding: Change that is none [m/s].
        """
        before, gain, fall = self.velocity, self._gain, self._fall
        self.velocity = after
        change = (
            abs(after[0] - before[0] - force[0] * gain - fall[0])
            + abs(after[1] - before[1] - force[1] * gain - fall[1])
            + abs(after[2] - before[2] - force[2] * gain - fall[2])
        )
        return change > rounding


def fill(out: Array, numbers: Iterable[float]) -> None:
    """Write as many of Python's numbers as there is room for, shape (N,); NumPy would take three times as long."""
    _packer(len(out))(out, 0, *numbers)


@cache
def _packer(count: int) -> Callable[..., None]:
    return struct.Struct(f"{count}d").pack_into


def joint_index(numbers: Sequence[int]) -> Any:
    """Return what picks these numbers out of an array: a slice, which copies nothing, where they follow each other."""
    start = numbers[0] if numbers else 0
    if list(numbers) == list(range(start, start + len(numbers))):
        return slice(start, start + len(numbers))
    return np.array(numbers)


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


link_rotations = njit(cache=True)(rotation_matrices)  # NumPy would take 20 µs at every `read`


def base_rotation(scene: Scene) -> Array:
    """Return the rotation matrix of the base link at the start, shape (3, 3)."""
    w, x, y, z = scene.base_quaternion
    matrix: Array = rotation_matrices(np.array([[x, y, z, w]]))[0]
    return matrix


def base_com_velocity(scene: Scene, com: Array) -> tuple[Array, Array]:
    """Return velocity [m/s] and angular velocity [rad/s] of the base at the start, of its COM in the link's frame."""
    spin = np.array(scene.base_angular_velocity)
    return np.array(scene.base_velocity) + np.cross(spin, base_rotation(scene) @ com), spin


def turned_inertia(quaternion: Array, moments: Array) -> Array:
    """Return the inertia in link axes, shape (3, 3), from its principal moments and axes (x, y, z, w)."""
    axes = rotation_matrices(quaternion[None, :])[0]
    inertia: Array = axes @ np.diag(moments) @ axes.T
    return inertia
