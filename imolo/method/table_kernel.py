"""Compiled search of the lookup table."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def keeps_executed_part(
    k: float, switch_us: float, executed_k: float, executed_switch_us: float, elapsed_us: float
) -> bool:
    """Return whether new commands equal the executed ones so far (Fig. 4e); says the same as `Commands.matches_until`.

    Two U part where one has ended phase w and the other has not, and where phase c begins with another k.

    Args:
        k: New k [-].
        switch_us: New t_w [µs].
        executed_k: Executed k [-], NaN while phase c has not begun.
        executed_switch_us: Executed t_w [µs].
        elapsed_us: Executed time since the onset [µs], negative before it.
    """
    if switch_us != executed_switch_us and elapsed_us > min(switch_us, executed_switch_us):
        return False
    return math.isnan(executed_k) or k == executed_k


@njit(cache=True)
def first_match(
    positions: NDArray[np.float64],
    times: NDArray[np.float64],
    cell_start: NDArray[np.int64],
    box: NDArray[np.int64],
    tuples: NDArray[np.float64],
    spacing: float,
    reach: float,
    time_tolerance: float,
    executed_k: float,
    executed_switch_us: float,
    elapsed_us: float,
) -> tuple[int, int]:
    """Find the first point of a path that a motion reaches in time (Sec. IV-A).

    Args:
        positions: s_q in the world frame [m], shape (N, 3).
        times: Time of each since the onset [s], shape (N,).
        cell_start: First tuple of each cell of the box, rows of z, shape (cells + 1,).
        box: Lowest grid index of the box along x, y, z, then its number of cells along each, shape (6,).
        tuples: t [s], k [-], t_w [µs] sorted by cell, shape (M, 3).
        spacing: d_grid [m].
        reach: Distance to the nearest grid point that still counts as there, itself excluded [m].
        time_tolerance: Δt [s].
        executed_k: As in `keeps_executed_part`.
        executed_switch_us: As in `keeps_executed_part`.
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
            distance = abs(tuples[candidate, 0] - times[point])
            if distance < best_distance and keeps_executed_part(
                tuples[candidate, 1], tuples[candidate, 2], executed_k, executed_switch_us, elapsed_us
            ):
                best = candidate
                best_distance = distance
        if best >= 0:
            return point, best
    return -1, -1
