"""Recordings of one rigid body that flies, hits the floor and comes to rest, as a motion-capture system sees it."""

import atexit
import csv
import hashlib
import io
import math
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, SerializeAsAny, model_validator
from scipy.spatial.transform import Rotation

from imolo.config.experiment import PluginConfig
from imolo.config.loading import backend_options, backend_plugin
from imolo.config.model import Model, Positive, Vector
from imolo.config.simulation import ContactConfig
from imolo.contracts.engine import NO_BALL, Scene
from imolo.contracts.urdf import read_urdf
from imolo.errors import BackendError, DivergenceError, TrainingDataError, did_you_mean
from imolo.identification.experiment import Errors
from imolo.machine.files import open_bounded

Array = NDArray[np.float64]

POSE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
TWIST = ("vx_m_s", "vy_m_s", "vz_m_s", "wx_body_rad_s", "wy_body_rad_s", "wz_body_rad_s")
MOST_BYTES = 500_000_000
FEWEST_FRAMES = 10


class BodyConfig(Model):
    """The body: a box of even density, or what a URDF of one link says.

    Attributes:
        sides: Of the box [m].
        mass: Of the box [kg].
        inertia: Moments about the box's axes [kg m²]; of even density if not given.
        urdf: Of any other body.
    """

    sides: tuple[Positive, Positive, Positive] | None = None
    mass: Positive | None = None
    inertia: tuple[Positive, Positive, Positive] | None = None
    urdf: Path | None = None

    @model_validator(mode="after")
    def _is_one_body(self) -> Self:
        box = self.sides is not None and self.mass is not None
        said = (self.sides, self.mass, self.inertia)
        if (not box and self.urdf is None) or (self.urdf is not None and any(one is not None for one in said)):
            raise ValueError("give sides and mass of a box, or the urdf of another body")
        return self


class FreeBodySimulation(Model):
    """What surrounds the body; the names are those of an experiment's config.

    Attributes:
        timestep: Of the engine [s].
        contact: What the contacts are asked to be.
        gravity: Free fall [m/s²].
    """

    timestep: Annotated[float, Field(gt=0, le=5e-3)] = 5e-4
    contact: ContactConfig = ContactConfig()
    gravity: Positive = 9.81


class FreeBodyConfig(Model):
    """One engine, the body and the floor."""

    backend: PluginConfig
    simulation: SerializeAsAny[FreeBodySimulation] = FreeBodySimulation()
    body: BodyConfig


@dataclass(frozen=True, eq=False)
class Toss:
    """One recorded motion; a `Recording`.

    Attributes:
        name: For people.
        time: Since the first frame [s], shape (N,).
        position: Of the body's frame in the world, z up, floor at z = 0 [m], shape (N, 3).
        rotation: Of the body's frame, quaternions w, x, y, z, shape (N, 4).
        velocity: At the first frame [m/s], shape (3,).
        angular_velocity: At the first frame, world axes [rad/s], shape (3,).
    """

    name: str
    time: Array
    position: Array
    rotation: Array
    velocity: Array
    angular_velocity: Array

    def play(self, config: FreeBodyConfig) -> Errors:
        """Let the body fly from the first frame on, and return position [m] and rotation [rad] off at each frame."""
        position, rotation = simulate(config, self)
        turn = rotation.inv() * rotations(self.rotation)
        return {"position": position - self.position, "rotation": turn.as_rotvec()}


def rotations(quaternion: Array) -> Rotation:
    """Return rotations of quaternions w, x, y, z, shape (N, 4)."""
    return Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])


def simulate(config: FreeBodyConfig, toss: Toss) -> tuple[Array, Rotation]:
    """Return position [m], shape (N, 3), and rotation of the body at the frames of a toss.

    Raises:
        BackendError: The engine refuses the scene, or the backend has no engine.
        DivergenceError: The state is no longer finite.
    """
    engine_class = backend_plugin(config).engine  # type: ignore[arg-type]
    if engine_class is None:
        raise BackendError(f"backend {config.backend.name!r} is no physics engine; a free body needs one")
    urdf = config.body.urdf or _box_urdf(config.body)
    simulation = config.simulation
    w, x, y, z = toss.rotation[0].tolist()
    scene = Scene(
        urdf=urdf,
        joint_names=(),
        link_names=tuple(read_urdf(urdf).links),
        base_position=_vector(toss.position[0]),
        base_quaternion=(w, x, y, z),
        joint_angle=(),
        ball=NO_BALL,
        boxes=(),
        timestep=simulation.timestep,
        friction=simulation.contact.friction,
        restitution=simulation.contact.restitution,
        robot_restitution=simulation.contact.robot_restitution,
        gravity=(0.0, 0.0, -simulation.gravity),
        base_velocity=_vector(toss.velocity),
        base_angular_velocity=_vector(toss.angular_velocity),
    )
    engine = engine_class(scene, backend_options(config))  # type: ignore[arg-type]
    no_torque, no_force = np.zeros(0), np.zeros(3)
    positions, turns = [], []
    steps = 0
    try:
        for until in np.rint(toss.time / simulation.timestep).astype(int).tolist():
            for _ in range(until - steps):
                engine.step(no_torque, no_force)
            steps = max(steps, until)
            state = engine.read()
            if not math.isfinite(state.link_position[0].sum()):
                raise DivergenceError(f"{config.backend.name} is no longer finite at {state.time:.4f} s")
            positions.append(state.link_position[0])
            turns.append(state.link_rotation[0])
    finally:
        engine.close()
    return np.array(positions), Rotation.from_matrix(np.array(turns))


def _vector(array: Array) -> Vector:
    x, y, z = array.tolist()
    return x, y, z


@cache
def _box_urdf(body: BodyConfig) -> Path:
    assert body.sides is not None and body.mass is not None  # noqa: PT018 - `_is_one_body`
    squares = [side**2 for side in body.sides]
    even = [body.mass / 12.0 * (sum(squares) - square) for square in squares]
    ixx, iyy, izz = body.inertia or even
    x, y, z = body.sides
    folder = Path(tempfile.mkdtemp(prefix="imolo-body-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = folder / "box.urdf"
    path.write_text(
        f'<robot name="box"><link name="box"><inertial><mass value="{body.mass!r}"/>'
        f'<inertia ixx="{ixx!r}" iyy="{iyy!r}" izz="{izz!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f'<collision><geometry><box size="{x!r} {y!r} {z!r}"/></geometry></collision></link></robot>',
        encoding="utf-8",
    )
    return path


def read_tosses(path: Path, names: Sequence[str] = ()) -> list[Toss]:
    """Read recorded motions of a free body.

    Args:
        path: CSV whose header names toss, time_s, x_m, y_m, z_m, qw, qx, qy, qz in any order, and, where they were
            measured, vx_m_s, vy_m_s, vz_m_s (world) and wx_body_rad_s, wy_body_rad_s, wz_body_rad_s; other columns are
            passed over.
        names: Which tosses; all if empty.

    Raises:
        TrainingDataError: The file cannot be read, a column or toss is missing, or a value cannot be used; line and
            value are named.
    """
    rows = _read_rows(path)
    tosses = []
    for name in names or rows:
        if name not in rows:
            raise TrainingDataError(f"{path} holds no toss {name!r}{did_you_mean(name, list(rows))}")
        tosses.append(_toss(path, name, np.array(rows[name])))
    return tosses


def digest(tosses: Sequence[Toss], urdf: Path | None = None) -> str:
    """Return a hash of all that was recorded, and of the body's file."""
    total = hashlib.sha256(urdf.read_bytes() if urdf else b"")
    for toss in tosses:
        for array in (toss.time, toss.position, toss.rotation, toss.velocity, toss.angular_velocity):
            total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()[:16]


def _read_rows(path: Path) -> dict[str, list[list[float]]]:
    rows: dict[str, list[list[float]]] = {}
    try:
        with open_bounded(path, MOST_BYTES) as binary, io.TextIOWrapper(binary, "utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            header = [name.strip() for name in next(reader, [])]
            with_twist = any(name in header for name in TWIST)
            for wanted in ("toss", "time_s", *POSE, *(TWIST if with_twist else ())):
                if header.count(wanted) != 1:
                    hint = did_you_mean(wanted, header)
                    raise TrainingDataError(f"{path}: the column {wanted!r} is not there once{hint}; name it so, in SI")
            numbers = [header.index(name) for name in ("time_s", *POSE, *(TWIST if with_twist else ()))]
            key = header.index("toss")
            for row in reader:
                if not row:
                    continue
                try:
                    values = [float(row[number]) for number in numbers]
                    name = row[key].strip()
                except (ValueError, IndexError) as error:
                    raise TrainingDataError(
                        f"{path}, line {reader.line_num}: {error}; mend or delete the line"
                    ) from error
                if not all(map(math.isfinite, values)):
                    raise TrainingDataError(
                        f"{path}, line {reader.line_num}: a value is not finite; leave frames out in which the "
                        "body was not seen"
                    )
                there = rows.setdefault(name, [])
                if there and values[0] <= there[-1][0]:
                    raise TrainingDataError(
                        f"{path}, line {reader.line_num}: time_s {values[0]:g} of toss {name!r} does not come after "
                        f"{there[-1][0]:g}; sort its rows, or give the next toss another name"
                    )
                there.append(values)
    except OSError as error:
        raise TrainingDataError(f"cannot read the recordings {path}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TrainingDataError(f"{path} is no CSV text: {error}; save it as UTF-8 with commas") from error
    if not rows:
        raise TrainingDataError(f"{path} holds no frames, only a header")
    return rows


def _toss(path: Path, name: str, table: Array) -> Toss:
    if len(table) < FEWEST_FRAMES:
        raise TrainingDataError(f"{path}: toss {name!r} has {len(table)} frames; needed are {FEWEST_FRAMES}")
    time, position, quaternion = table[:, 0] - table[0, 0], table[:, 1:4], table[:, 4:8]
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    if np.abs(length - 1.0).max() > 1e-3:
        raise TrainingDataError(
            f"{path}: a quaternion of toss {name!r} has the length {length.flat[np.abs(length - 1.0).argmax()]:.4g}; "
            "qw qx qy qz must have the length 1"
        )
    quaternion = quaternion / length
    turn = rotations(quaternion)
    if table.shape[1] > 8:
        velocity, angular_velocity = table[0, 8:11], turn[0].apply(table[0, 11:14])
    else:
        span = time[1] - time[0]
        velocity = (position[1] - position[0]) / span
        angular_velocity = (turn[1] * turn[0].inv()).as_rotvec() / span
    return Toss(name, time, position, quaternion, velocity, np.asarray(angular_velocity))


def as_metres(toss: Toss, factor: float) -> Toss:
    """Return a toss whose lengths are multiplied by a factor."""
    changes: dict[str, Any] = {"position": toss.position * factor, "velocity": toss.velocity * factor}
    return Toss(**{**toss.__dict__, **changes})
