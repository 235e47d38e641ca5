"""Compiled search of the lookup table."""

import numpy as np
from numba import njit
from numba.cpython.unsafe.tuple import tuple_setitem
from numpy.typing import NDArray

from imolo.method.motion import Row


@njit(cache=True, inline="always")
def keeps_executed_part(rows: NDArray[np.float64], row: int, first: int, executed: Row, elapsed: float) -> bool:
    """Return whether new commands equal the executed ones so far (Fig. 4e); says the same as `Commands.matches_until`.

    Two U part where the first of their parameters that differ shows in either of them.

    Args:
        rows: Motions, shape (M, first + 2 n); a row of their own would be counted by numba for each of them.
        row: The new one.
        first: Where it has theta, then from when on each of its parameters shows in U [µs].
        executed: The executed motion.
        elapsed: Executed time since the onset [s], negative before it.
    """
    count = len(executed) // 2
    for i in range(count):
        if rows[row, first + i] != executed[i]:
            shown = min(rows[row, first + count + i], np.rint(executed[count + i] * 1e6))
            if np.rint(elapsed * 1e6) > shown:
                return False
    return True


@njit(cache=True)
def nearest_tuple(
    x: float,
    y: float,
    z: float,
    time: float,
    executed: Row,
    elapsed: float,
    cells: NDArray[np.int32],
    tuples: NDArray[np.float64],
    spacing: float,
    reach: float,
    time_tolerance: float,
) -> tuple[int, float, Row]:
    """Find the motion that brings the hand to a position in time (Sec. IV-A).

    Args:
        x: s_q in the world frame [m].
        y: The same.
        z: The same.
        time: When, since the onset [s].
        executed: As in `keeps_executed_part`; any before the onset.
        elapsed: As in `keeps_executed_part`.
        cells: Lowest grid index of the box of the table along x, y, z, its number of cells along each, how many slots
            of time each cell has, how many Δt a slot has, the number of the first since the onset, then the first tuple
            of each slot of each cell, rows of z, shape (9 + number of slots + 1,).
        tuples: t [s], theta, then from when on each parameter shows in U [µs], sorted by cell, t and theta,
            shape (M, 1 + 2 n).
        spacing: d_grid [m].
        reach: Distance to the nearest grid point that still counts as there, itself excluded [m].
        time_tolerance: Δt [s].

    Returns:
        The tuple nearest in time, of equally near ones the first, its t [s], and its theta followed by n more numbers;
        -1 and something if there is none.
    """
    position, found = (x, y, z), executed
    cell, square = 0, 0.0
    for axis in range(3):
        nearest = np.floor(position[axis] / spacing + 0.5)
        square += (position[axis] - nearest * spacing) ** 2
        index = nearest - cells[axis]
        if not 0.0 <= index < cells[axis + 3]:  # also NaN and infinity
            return -1, 0.0, found
        cell = cell * cells[axis + 3] + int(index)
    # Only the nearest grid point can be nearer than half a cell, so no other cell is searched.
    if not square < reach**2:
        return -1, 0.0, found
    # Only tuples of these slots can be near enough in time; in a large table each look at memory counts.
    first = int(cells[9 + _slot(cells, cell, time - 0.5 * time_tolerance, time_tolerance)])
    end = int(cells[10 + _slot(cells, cell, time + 0.5 * time_tolerance, time_tolerance)])
    later = _not_below(tuples, 0, first, end, time)
    earlier = later  # behind the last of those
    bound = np.rint(elapsed * 1e6) > np.rint(executed[len(executed) // 2] * 1e6)
    while True:
        before = time - tuples[earlier - 1, 0] if earlier > first else np.inf
        after = tuples[later, 0] - time if later < end else np.inf
        if not min(before, after) < 0.5 * time_tolerance:  # also NaN
            return -1, 0.0, found
        if before <= after:
            row, last = _not_below(tuples, 0, first, earlier, tuples[earlier - 1, 0]), earlier
            earlier = row
        else:
            row, last = later, _not_below(tuples, 0, later, end, np.nextafter(tuples[later, 0], np.inf))
            later = last
        # Of one time there may be hundreds; those of one first parameter stand together.
        if bound:
            row = _not_below(tuples, 1, row, last, executed[0])
        while row < last and not (bound and tuples[row, 1] != executed[0]):
            if keeps_executed_part(tuples, row, 1, executed, elapsed):
                for number in range(len(found)):
                    found = tuple_setitem(found, number, tuples[row, 1 + number])
                return row, tuples[row, 0], found
            row += 1


@njit(cache=True, inline="always")
def _slot(cells: NDArray[np.int32], cell: int, time: float, time_tolerance: float) -> int:
    """Return the number of a cell's slot for a time [s], its first or last if it has none; it grows with the time."""
    slots = int(cells[6])
    index = time / (cells[7] * time_tolerance) - cells[8]
    within = slots - 1 if index >= slots else int(index) if index > 0.0 else 0  # also NaN
    return cell * slots + within


@njit(cache=True, inline="always")
def _not_below(rows: NDArray[np.float64], column: int, low: int, high: int, value: float) -> int:
    """Return the first of some rows, sorted by a column, that is not below a value."""
    while low < high:
        middle = (low + high) // 2
        if rows[middle, column] < value:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True)
def first_match(
    positions: NDArray[np.float64],
    times: NDArray[np.float64],
    executed: Row,
    elapsed: float,
    cells: NDArray[np.int32],
    tuples: NDArray[np.float64],
    spacing: float,
    reach: float,
    time_tolerance: float,
) -> tuple[int, int, float, Row]:
    """Find the first point of a path that a motion reaches in time (Sec. IV-A).

    Args:
        positions: In the world frame [m], shape (N, 3).
        times: Time of each since the onset [s], shape (N,).
        executed: As in `nearest_tuple`, like all that follows.
        elapsed: The same.
        cells: The same.
        tuples: The same.
        spacing: The same.
        reach: The same.
        time_tolerance: The same.

    Returns:
        Index of the point, then as `nearest_tuple`.
    """
    for point in range(positions.shape[0]):
        x, y, z = positions[point, 0], positions[point, 1], positions[point, 2]
        row, time, found = nearest_tuple(
            x, y, z, times[point], executed, elapsed, cells, tuples, spacing, reach, time_tolerance
        )
        if row >= 0:
            return point, row, time, found
    return -1, -1, 0.0, executed
