"""The lookup table of learned dynamics: which motion brings the hand where, and when (Sec. IV)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numba import float64, typeof
from numpy.typing import ArrayLike, NDArray

from imolo.errors import ConfigError, ImoloError, TableFileError
from imolo.method.forward_model import ForwardModel, ForwardModelConfig, TrainingData
from imolo.method.hand_uncertainty import HandUncertainty
from imolo.method.hit_choice import group_by_motion
from imolo.method.hit_kernel import Swings
from imolo.method.motion import MotionTemplate, PhasedMotion, Row, Theta, motion_rows
from imolo.method.prior import fit_forward_model
from imolo.method.table_file import read_table_file, write_table_file
from imolo.method.table_grid import TableGrid
from imolo.method.table_kernel import first_match, nearest_tuple

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_CELLS = 20_000_000  # 160 MB where each starts; the paper's table has some 10^5 cells


class Executed(NamedTuple):
    """The part of a motion that cannot be changed any more (Sec. IV-B3).

    Attributes:
        theta: Parameter of the motion under way.
        elapsed: t_e, time since its onset at which new commands can take effect [s]; negative before the onset.
    """

    theta: Theta
    elapsed: float


@dataclass(slots=True)
class TableHit:
    """A tuple of the table that answers a query.

    Attributes:
        theta: Parameter of the motion.
        time: t, time since the onset at which the hand is there [s].
        path_index: Which point of the queried path it answers.
        tuple_index: Its row in the table.
    """

    theta: Theta
    time: float
    path_index: int
    tuple_index: int


class LookupTable:
    """The unique tuples (i, t, theta), found by grid point.

    Attributes:
        grid: How the table was made.
        template: What theta changes.
        robot: Name of the robot that the table is for.
        origin: What made the training data: engine, config hash, seed, versions.
        forward_model: The regression that predicted the tuples.
        training: What it was fitted to.
        position: Grid points in the world frame [m], shape (M, 3), read-only like the next two.
        time: Time since the onset [s], shape (M,).
        theta: Motion parameters, shape (M, n), n being the number of `template.parameters`.
        hand_std: Standard deviation of the hand about its prediction along each world axis [m], one row per distinct
            theta in ascending order, shape (T, 3).
    """

    def __init__(
        self,
        cell: Indices,
        time: Array,
        theta: Array,
        hand_std: Array,
        *,
        grid: TableGrid,
        template: MotionTemplate,
        forward_model: ForwardModelConfig,
        training: TrainingData,
        robot: str,
        origin: Mapping[str, Any],
    ) -> None:
        """Index tuples by grid point; `build` and `load` call this.

        The arguments are the attributes, but `cell`, shape (M, 3): grid points in multiples of the spacing.
        """
        self.grid, self.template, self.robot, self.origin = grid, template, robot, dict(origin)
        self.forward_model, self.training = forward_model, training
        self._box = _box(cell)
        flat = _flat_index(cell, self._box)
        order = np.lexsort((*theta.T[::-1], time, flat))
        slots, index = _time_slots(time[order], int(np.prod(self._box[3:])), grid.time_tolerance)
        first = np.searchsorted(flat[order] * slots[0] + index, np.arange(slots[0] * np.prod(self._box[3:]) + 1))
        self._cell_start = first[:: slots[0]]
        self._cell = cell[order]
        self.position = self._cell * grid.spacing
        self.hand_std = hand_std
        self._spacing = grid.spacing
        self._reach = 0.5 * grid.spacing if grid.match == "sphere" else math.inf
        # As the compiled search takes them.
        tuples = np.column_stack((time, motion_rows(template, theta)))[order]
        count = self._count = theta.shape[1]
        self.time, self.theta = tuples[:, 0], tuples[:, 1 : 1 + count]
        cells = np.concatenate((self._box, slots, first)).astype(np.int32)
        self._searched = cells, tuples, grid.spacing, self._reach, grid.time_tolerance
        self._row = template.row_maker()
        self._nothing = (0.0,) * (2 * count), -1.0
        for array in (self._cell, self.time, self.theta, self.position, self.hand_std):
            array.flags.writeable = False
        # Now rather than in the middle of a throw, and once for all: it takes a while to find out what arguments are.
        types = tuple(map(typeof, (*self._nothing, *self._searched)))
        self._nearest = nearest_tuple.compile((float64,) * 4 + types)
        self._first = first_match.compile((float64[:, ::1], float64[::1], *types))

    @classmethod
    def build(
        cls,
        model: ForwardModel,
        grid: TableGrid,
        rng: np.random.Generator,
        *,
        robot: str,
        origin: Mapping[str, Any] | None = None,
    ) -> Self:
        """Predict all positions of the grid and keep the unique tuples (Sec. IV-B).

        Args:
            model: Fitted forward model.
            grid: What to predict and to keep.
            rng: Chooses among predictions of the same grid point.
            robot: Name of the robot.
            origin: JSON-able description of what made the training data.

        Raises:
            NotTrainedError: The model has not been fitted.
            ConfigError: A theta of the grid is not allowed, or the predictions need too many cells.
        """
        template = model.template
        theta, time = grid.predictions(template)
        for extreme in theta[[0, -1]]:
            template.commands(extreme.tolist(), onset_utime=0)
        cell = _nearest_grid_point(model.predict(theta, time), grid.spacing)
        kept = _choose(cell, time, grid.unique, rng)
        return cls(
            cell[kept],
            time[kept],
            theta[kept],
            _hand_std(model, theta[kept], time[kept]),
            grid=grid,
            template=template,
            forward_model=model.config,
            training=model.training,
            robot=robot,
            origin=origin or {},
        )

    def __len__(self) -> int:
        """Return the number of tuples M."""
        return len(self.time)

    @property
    def num_grid_points(self) -> int:
        """Number of grid points that the hand reaches."""
        return int(np.count_nonzero(np.diff(self._cell_start)))

    def query(self, position: ArrayLike, time: float, executed: Executed | None = None) -> TableHit | None:
        """Find the motion that brings the hand to a position in time (Sec. IV-A, Fig. 4c-e).

        Args:
            position: s_q in the world frame [m], shape (3,).
            time: When, since the onset [s]: t_q before it, t_q + t_e after it.
            executed: The motion under way, if any; the answer then continues it.

        Returns:
            The tuple whose grid point matches and whose time is within half a time step, the nearest in time; None if
            there is none.

        Raises:
            ValueError: The position has not three coordinates.
        """
        point: Any = position.tolist() if isinstance(position, np.ndarray) else position
        try:
            x, y, z = point
        except (TypeError, ValueError) as error:
            raise ValueError(f"position is {position!r}; give three coordinates") from error
        row, when, motion = self._nearest(x, y, z, time, *self._done(executed), *self._searched)
        return TableHit(motion[: self._count], when, 0, row) if row >= 0 else None

    def query_path(self, positions: ArrayLike, times: ArrayLike, executed: Executed | None = None) -> TableHit | None:
        """Find the first point of a path that a motion reaches in time; each point is a `query`.

        Args:
            positions: s_q in the world frame [m], shape (N, 3).
            times: When, since the onset [s], shape (N,).
            executed: The motion under way, if any; the answer then continues it.

        Raises:
            ValueError: The shapes disagree.
        """
        path = np.ascontiguousarray(positions, dtype=np.float64)
        when = np.ascontiguousarray(times, dtype=np.float64)
        if path.shape != (*when.shape, 3):
            raise ValueError(f"positions have shape {path.shape}, times {when.shape}; give (N, 3) and (N,)")
        point, row, at, motion = self._first(path, when, *self._done(executed), *self._searched)
        return TableHit(motion[: self._count], at, point, row) if row >= 0 else None

    def times_at(self, position: ArrayLike) -> Array:
        """Return when the stored motions bring the hand to a position, since the onset [s], shape (N,).

        Args:
            position: In the world frame [m], shape (3,); it belongs to its nearest grid point if it matches that.
        """
        point = np.asarray(position, dtype=np.float64)
        cell = np.floor(point / self._spacing + 0.5)
        index = cell - self._box[:3]
        if not (np.linalg.norm(point - cell * self._spacing) < self._reach and _inside(index, self._box[3:])):
            return np.empty(0)
        flat = int(_flat_index(cell.astype(np.int64)[None], self._box)[0])
        return self.time[self._cell_start[flat] : self._cell_start[flat + 1]]

    def _done(self, executed: Executed | None) -> tuple[Row, float]:
        """Return the row of the motion under way and its elapsed time [s]; those of none bind nothing."""
        return self._nothing if executed is None else (self._row(executed.theta), executed.elapsed)

    @cached_property
    def swings(self) -> Swings:
        """The tuples by motion, for the choice of the hit by probability; worked out when first asked for."""
        position: Array = self.position.astype(np.float64)
        return group_by_motion(self.template, self.theta, self.time, position, self.hand_std, self.grid.spacing)

    def refit(self) -> ForwardModel:
        """Return the forward model, fitted again to the stored training data.

        Raises:
            TableFileError: It had a prior, whose table cannot be read.
        """
        return fit_forward_model(self.forward_model, self.training, self.robot, self.template)

    def save(self, path: Path) -> None:
        """Write table, training data and configuration to one file.

        Raises:
            TableFileError: The file cannot be written.
        """
        header = {
            "robot": self.robot,
            "origin": self.origin,
            "grid": self.grid.model_dump(),
            "template": self.template.model_dump(),
            "forward_model": self.forward_model.model_dump(),
        }
        arrays: dict[str, NDArray[Any]] = {"cell": self._cell, "time": self.time, "theta": self.theta}
        arrays["hand_std"] = self.hand_std
        for name in ("theta", "time", "position"):
            arrays[f"training_{name}"] = getattr(self.training, name)
        write_table_file(path, header, arrays)

    @classmethod
    def load(cls, path: Path, robot: str | None = None, motion: type[MotionTemplate] = PhasedMotion) -> Self:
        """Read a table.

        Args:
            path: File that `save` wrote.
            robot: The robot it must be for; any if not given.
            motion: Kind of its motion template.

        Raises:
            TableFileError: The file is damaged, foreign, of a newer version or for another robot.
        """
        header, arrays = read_table_file(path)
        try:
            if robot is not None and header["robot"] != robot:
                raise TableFileError(
                    f"table file {path} is for robot {header['robot']!r}, not {robot!r}; train {robot!r} first"
                )
            return cls(
                arrays["cell"],
                arrays["time"],
                arrays["theta"],
                arrays["hand_std"],
                grid=TableGrid.model_validate(header["grid"]),
                template=motion.model_validate(header["template"]),
                forward_model=ForwardModelConfig.model_validate(header["forward_model"]),
                training=TrainingData(*(arrays[f"training_{name}"] for name in ("theta", "time", "position"))),
                robot=header["robot"],
                origin=header["origin"],
            )
        except (LookupError, TypeError, ValueError, OverflowError, ImoloError) as error:
            if isinstance(error, TableFileError):
                raise
            raise TableFileError(f"table file {path} does not fit this imolo ({error}); build it again") from error


def _hand_std(model: ForwardModel, theta: Array, time: Array) -> Array:
    """Return the standard deviation at the middle time of each distinct theta, shape (T, 3)."""
    # Predictions of one motion follow each other, and there are far fewer of these groups to sort.
    fresh = np.append(True, (theta[1:] != theta[:-1]).any(axis=1))
    motion, group = np.unique(theta[fresh], axis=0, return_inverse=True)
    index = group.ravel()[np.cumsum(fresh) - 1]
    middle = np.bincount(index, weights=time) / np.bincount(index)
    return HandUncertainty(model).std(motion, middle)


def _nearest_grid_point(position: Array, spacing: float) -> Indices:
    nearest = np.floor(position / spacing + 0.5)
    lowest, extent = np.split(_box(nearest), 2)
    if not (np.abs((lowest, lowest + extent)).max() < 2**31 and np.prod(extent) <= MAX_CELLS):
        raise ConfigError(
            f"the predicted hand positions span {' x '.join(f'{side * spacing:.3g}' for side in extent)} m; give a "
            f"spacing above {spacing:g} m or a forward model that does not diverge"
        )
    return nearest.astype(np.int64)


def _box(cell: NDArray[Any]) -> NDArray[Any]:
    """Return the lowest grid index along x, y, z, then how many there are, shape (6,)."""
    # Of rows of three NumPy takes forty times as long.
    lowest = np.array([column.min() for column in cell.T])
    return np.concatenate((lowest, [column.max() + 1 for column in cell.T] - lowest))


def _time_slots(time: Array, cells: int, tolerance: float) -> tuple[list[int], Indices]:
    """Return how many slots of time a cell has, how many Δt each, which is the first; then that of each time."""
    lowest, highest = np.floor(np.array((time.min(), time.max())) / tolerance)
    # As few as leave four tuples to a slot: a small table's cells are read at a glance, and each slot takes memory.
    length = max(1, math.ceil((highest - lowest + 1) * 4 * cells / len(time)))
    index = np.floor(time / (length * tolerance)).astype(np.int64)
    start = int(index.min())
    return [int(np.ptp(index)) + 1, length, start], index - start


def _inside(index: Array, size: Indices) -> bool:
    return bool(np.all((index >= 0) & (index < size)))


def _flat_index(cell: Indices, box: Indices) -> Indices:
    x, y, z = (cell - box[:3]).T
    flat: Indices = (x * box[4] + y) * box[5] + z
    return flat


def _choose(cell: Indices, time: Array, unique: str, rng: np.random.Generator) -> NDArray[np.intp]:
    if unique == "all":
        return np.arange(len(time))
    key = _flat_index(cell, _box(cell))
    if unique == "voxel_time":
        utime = np.rint(time * 1e6).astype(np.int64)
        key = key * (np.ptp(utime) + 1) + (utime - utime.min())
    shuffled = rng.permutation(len(key))
    place = np.empty_like(shuffled)
    place[shuffled] = np.arange(len(key))
    # Of each grid point the one that was shuffled to the front.
    order = np.argsort(key)
    key = key[order]
    first = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
    return np.sort(shuffled[np.minimum.reduceat(place[order], first)])
