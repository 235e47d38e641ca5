"""Compiled search of the lookup table."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, inline="always")
def keeps_executed_part(motion: NDArray[np.float64], executed: NDArray[np.float64], elapsed_us: float) -> bool:
    """Return whether new commands equal the executed ones so far (Fig. 4e); says the same as `Commands.matches_until`.

    Two U part where the first of their parameters that differ shows in either of them.

    Args:
        motion: New theta, then from when on each of its parameters shows in U [µs], shape (2 n,).
        executed: The same of the executed motion.
        elapsed_us: Executed time since the onset [µs], negative before it.
    """
    count = len(executed) // 2
    for i in range(count):
        if motion[i] != executed[i] and elapsed_us > min(motion[count + i], executed[count + i]):
            return False
    return True


@njit(cache=True)
def first_match(
    positions: NDArray[np.float64],
    times: NDArray[np.float64],
    cell_start: NDArray[np.int64],
    box: NDArray[np.int64],
    tuple_time: NDArray[np.float64],
    motions: NDArray[np.float64],
    spacing: float,
    reach: float,
    time_tolerance: float,
    executed: NDArray[np.float64],
    elapsed_us: float,
) -> tuple[int, int]:
    """Find the first point of a path that a motion reaches in time (Sec. IV-A).

    Args:
        positions: s_q in the world frame [m], shape (N, 3).
        times: Time of each since the onset [s], shape (N,).
        cell_start: First tuple of each cell of the box, rows of z, shape (cells + 1,).
        box: Lowest grid index of the box along x, y, z, then its number of cells along each, shape (6,).
        tuple_time: t of the tuples [s], sorted by cell, shape (M,).
        motions: Their theta, then from when on each parameter shows in U [µs], shape (M, 2 n).
        spacing: d_grid [m].
        reach: Distance to the nearest grid point that still counts as there, itself excluded [m].
        time_tolerance: Δt [s].
        executed: As in `keeps_executed_part`; any before the onset.
        elapsed_us: As in `keeps_executed_part`.

    Returns:
        Index of the point and of its tuple: the one nearest in time, of equally near ones the first; -1, -1 if none.
    """
    for point in range(positions.shape[0]):
        cell = 0
        square = 0.0
        for axis in range(3):
            nearest = np.floor(positions[point, axis] / spacing + 0.5)
            square += (positions[point, axis] - nearest * spacing) ** 2
            index = nearest - box[axis]
            if not 0.0 <= index < box[axis + 3]:  # also NaN and infinity
                cell = -1
                break
            cell = cell * box[axis + 3] + int(index)
        # Only the nearest grid point can be nearer than half a cell, so no other cell is searched.
        if cell < 0 or not square < reach**2:
            continue
        best = -1
        best_distance = 0.5 * time_tolerance
        for candidate in range(cell_start[cell], cell_start[cell + 1]):
            distance = abs(tuple_time[candidate] - times[point])
            if distance < best_distance and keeps_executed_part(motions[candidate], executed, elapsed_us):
                best = candidate
                best_distance = distance
        if best >= 0:
            return point, best
    return -1, -1
