"""Compiled search of the lookup table."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, inline="always")
def keeps_executed_part(
    rows: NDArray[np.float64], row: int, first: int, executed: NDArray[np.float64], elapsed_us: float
) -> bool:
    """Return whether new commands equal the executed ones so far (Fig. 4e); says the same as `Commands.matches_until`.

    Two U part where the first of their parameters that differ shows in either of them.

    Args:
        rows: Motions, shape (M, first + 2 n); a row of their own would be counted by numba for each of them.
        row: The new one.
        first: Where it has theta, then from when on each of its parameters shows in U [µs].
        executed: The same of the executed motion, shape (2 n,).
        elapsed_us: Executed time since the onset [µs], negative before it.
    """
    count = len(executed) // 2
    for i in range(count):
        shown = min(rows[row, first + count + i], executed[count + i])
        if rows[row, first + i] != executed[i] and elapsed_us > shown:
            return False
    return True


@njit(cache=True)
def nearest_tuple(
    x: float,
    y: float,
    z: float,
    time: float,
    cells: NDArray[np.int64],
    tuples: NDArray[np.float64],
    executed: NDArray[np.float64],
    elapsed_us: float,
    spacing: float,
    reach: float,
    time_tolerance: float,
) -> int:
    """Find the motion that brings the hand to a position in time (Sec. IV-A).

    Args:
        x: s_q in the world frame [m].
        y: The same.
        z: The same.
        time: When, since the onset [s].
        cells: Lowest grid index of the box of the table along x, y, z, its number of cells along each, then the first
            tuple of each cell, rows of z, shape (6 + number of cells + 1,).
        tuples: t [s], theta, then from when on each parameter shows in U [µs], sorted by cell, then by t,
            shape (M, 1 + 2 n).
        executed: As in `keeps_executed_part`; any before the onset.
        elapsed_us: As in `keeps_executed_part`.
        spacing: d_grid [m].
        reach: Distance to the nearest grid point that still counts as there, itself excluded [m].
        time_tolerance: Δt [s].

    Returns:
        The tuple nearest in time, of equally near ones the first; -1 if there is none.
    """
    position = (x, y, z)
    cell, square = 0, 0.0
    for axis in range(3):
        nearest = np.floor(position[axis] / spacing + 0.5)
        square += (position[axis] - nearest * spacing) ** 2
        index = nearest - cells[axis]
        if not 0.0 <= index < cells[axis + 3]:  # also NaN and infinity
            return -1
        cell = cell * cells[axis + 3] + int(index)
    # Only the nearest grid point can be nearer than half a cell, so no other cell is searched.
    if not square < reach**2:
        return -1
    low, end = cells[6 + cell], cells[7 + cell]
    high, half = end, 0.5 * time_tolerance
    earliest = time - half
    while low < high:
        middle = (low + high) // 2
        if tuples[middle, 0] < earliest:
            low = middle + 1
        else:
            high = middle
    best, best_distance = -1, half
    for candidate in range(low, end):
        late = tuples[candidate, 0] - time
        if late >= best_distance:  # and all that follow are later still
            break
        if abs(late) < best_distance and keeps_executed_part(tuples, candidate, 1, executed, elapsed_us):
            best, best_distance = candidate, abs(late)
    return best


@njit(cache=True)
def first_match(
    positions: NDArray[np.float64],
    times: NDArray[np.float64],
    cells: NDArray[np.int64],
    tuples: NDArray[np.float64],
    executed: NDArray[np.float64],
    elapsed_us: float,
    spacing: float,
    reach: float,
    time_tolerance: float,
) -> tuple[int, int]:
    """Find the first point of a path that a motion reaches in time (Sec. IV-A).

    Args:
        positions: In the world frame [m], shape (N, 3).
        times: Time of each since the onset [s], shape (N,).
        cells: As in `nearest_tuple`, like all that follows.
        tuples: The same.
        executed: The same.
        elapsed_us: The same.
        spacing: The same.
        reach: The same.
        time_tolerance: The same.

    Returns:
        Index of the point and of its tuple; -1, -1 if there is none.
    """
    for point in range(positions.shape[0]):
        x, y, z = positions[point, 0], positions[point, 1], positions[point, 2]
        found = nearest_tuple(
            x, y, z, times[point], cells, tuples, executed, elapsed_us, spacing, reach, time_tolerance
        )
        if found >= 0:
            return point, found
    return -1, -1
