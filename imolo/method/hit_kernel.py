"""Compiled: the probability that a swinging plate meets a flying ball, and the motion for which it is highest.

The equations are in docs/choice.md.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from imolo.method.motion import Row
from imolo.method.table_kernel import keeps_executed_part

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Vector = tuple[float, float, float]
Symmetric = tuple[float, float, float, float, float, float]  # xx, yy, zz, xy, xz, yz

LEAST_CLOSING_SPEED = 0.5  # [m/s] slower, and hand and ball do not meet within a swing
_LEVEL = 1e-6  # [-] horizontal part of a direction that is not vertical
_TINY = 1e-12  # [m²]
_FAR = 6.0  # [standard deviations] beyond which a probability, below 1e-9, is taken for 0


class Swings(NamedTuple):
    """The tuples of a table by motion, T motions and M tuples in all.

    Attributes:
        lattice: Motion by index of each parameter, the last one fastest, shape (product of `size`,); -1 where there is
            none.
        size: Number of values of each parameter, shape (n,).
        place: Index of each parameter of each motion, shape (T, n).
        mirror: Mirrored motion, shape (T,); -1 where there is none.
        motion: As `motion.motion_rows` makes them, shape (T, 2 n).
        variance: Of the hand's position along each axis [m²], shape (T, 3).
        start: First tuple of each motion, shape (T + 1,).
        span: Time of its first and last tuple since the onset [s], shape (T, 2).
        time: Since the onset [s], increasing within a motion, shape (M,).
        position: Of the hand [m], shape (M, 3).
        velocity: Of the hand [m/s], shape (M, 3).
    """

    lattice: Indices
    size: Indices
    place: Indices
    mirror: Indices
    motion: Array
    variance: Array
    start: Indices
    span: Array
    time: Array
    position: Array
    velocity: Array


class BallPath(NamedTuple):
    """The predicted ball.

    Attributes:
        time: Since the onset [s], increasing, shape (N,).
        position: [m], shape (N, 3).
        velocity: [m/s], shape (N, 3).
        covariance: Of the positions [m²], shape (N, 3, 3).
    """

    time: Array
    position: Array
    velocity: Array
    covariance: Array


class Extent(NamedTuple):
    """What meets, and how exactly in time.

    Attributes:
        across: Offset along the horizontal up to which the ball meets the plate for certain [m].
        upright: The same along the direction across both [m].
        timing_variance: Of the motion [s²].
        time_gap: Longest time between a point of the path and its tuple [s].
        farthest: Distance of ball and hand beyond which they are not considered [m].
    """

    across: float
    upright: float
    timing_variance: float
    time_gap: float
    farthest: float


class Underway(NamedTuple):
    """The executed part of a motion, as `keeps_executed_part` wants it; `begun` tells that it binds a target."""

    motion: Row
    elapsed: float
    begun: bool


class Found(NamedTuple):
    """The answer of `most_probable`.

    Attributes:
        probability: That one of the hands meets the ball [-].
        motion: Which motion; -1 if none comes near.
        point: Point of the path near which they meet.
        row: Tuple of the hand that is likelier to: for the other hand, of the mirrored motion.
        side: 1 for the learned hand, -1 for the other one.
    """

    probability: float
    motion: int
    point: int
    row: int
    side: int


@njit(cache=True, inline="always")
def normal_within(mean: float, std: float, low: float, high: float) -> float:
    """Return the probability that a normal variable lies between two bounds."""
    scale = 1.0 / (std * math.sqrt(2.0))
    return 0.5 * (math.erf((high - mean) * scale) - math.erf((low - mean) * scale))


@njit(cache=True, inline="always")
def _variance_along(x: float, y: float, z: float, C: Symmetric, velocity: Vector, timing: float) -> float:
    """Return the variance of the offset along the unit vector (x, y, z) [m²]."""
    along = velocity[0] * x + velocity[1] * y + velocity[2] * z
    total: float = C[0] * x * x + C[1] * y * y + C[2] * z * z + timing * along * along
    total += 2.0 * (C[3] * x * y + C[4] * x * z + C[5] * y * z)
    return max(total, _TINY)


@njit(cache=True, inline="always")
def meeting_probability(
    offset: Vector,
    ball_velocity: Vector,
    hand_velocity: Vector,
    covariance: Symmetric,
    until_first: float,
    until_last: float,
    extent: Extent,
) -> float:
    """Return the probability that the ball, as the hand sees it, flies through a square about the hand while it swings.

    Args:
        offset: Ball minus hand at one moment [m].
        ball_velocity: [m/s].
        hand_velocity: [m/s].
        covariance: Of the offset [m²].
        until_first: Begin of the swing after that moment [s]; negative if before it.
        until_last: End of the swing after that moment [s].
        extent: Of plate and ball.
    """
    wx = ball_velocity[0] - hand_velocity[0]
    wy = ball_velocity[1] - hand_velocity[1]
    wz = ball_velocity[2] - hand_velocity[2]
    closing = math.sqrt(wx * wx + wy * wy + wz * wz)
    level = math.hypot(wx, wy)
    if closing < LEAST_CLOSING_SPEED or level < _LEVEL * closing:
        return 0.0
    timing, across, upright = extent.timing_variance, extent.across, extent.upright
    # n is where the ball comes from as the hand sees it, a horizontal, b = n × a.
    nx, ny, nz = wx / closing, wy / closing, wz / closing
    ax, ay = -wy / level, wx / level
    a = offset[0] * ax + offset[1] * ay
    std_a = math.sqrt(_variance_along(ax, ay, 0.0, covariance, hand_velocity, timing))
    if abs(a) > across + _FAR * std_a:
        return 0.0
    bx, by, bz = -nz * ay, nz * ax, nx * ay - ny * ax
    b = offset[0] * bx + offset[1] * by + offset[2] * bz
    std_b = math.sqrt(_variance_along(bx, by, bz, covariance, hand_velocity, timing))
    if abs(b) > upright + _FAR * std_b:
        return 0.0
    n = offset[0] * nx + offset[1] * ny + offset[2] * nz
    std_n = math.sqrt(_variance_along(nx, ny, nz, covariance, hand_velocity, timing))
    probability: float = (
        normal_within(a, std_a, -across, across)
        * normal_within(b, std_b, -upright, upright)
        * normal_within(-n / closing, std_n / closing, until_first, until_last)
    )
    return probability


@njit(cache=True)
def part_within(position: Array, low: Array, high: Array) -> tuple[int, int]:
    """Return the first point of a path, shape (N, 3), inside a box, and the point behind the last; 0, 0 if none is."""
    first, end = 0, 0
    for point in range(len(position)):
        inside = True
        for axis in range(3):
            inside = inside and low[axis] < position[point, axis] < high[axis]
        if inside:
            first = first if end else point
            end = point + 1
    return first, end


@njit(cache=True)
def most_probable_of(motions: Indices, ball: BallPath, swings: Swings, extent: Extent) -> Found:
    """Return which of some motions most probably meets the ball, with either of its hands.

    One long function, with every array taken out of its tuple once: numba counts references to an array wherever it is
    handed on, and to do so for every motion takes twice the time of the search.
    """
    best = Found(0.0, -1, -1, -1, 1)
    when, ball_position, ball_velocity, ball_covariance = ball
    mirror, start, span, variance = swings.mirror, swings.start, swings.span, swings.variance
    time, position, velocity = swings.time, swings.position, swings.velocity
    gap = extent.time_gap
    for motion in motions:
        total = likelier = 0.0
        likelier_point, likelier_row, likelier_side = -1, -1, 1
        for side in (1, -1):
            swing = motion if side == 1 else mirror[motion]
            if swing < 0:
                continue
            # Where hand and ball are nearest to each other.
            first, last = start[swing], start[swing + 1] - 1
            begin, end = span[swing, 0], span[swing, 1]
            rate = (last - first) / max(end - begin, gap)
            nearest, point, row = extent.farthest**2, -1, -1
            offset = (0.0, 0.0, 0.0)
            for i in range(len(when)):
                if when[i] < begin - gap:
                    continue
                if when[i] > end + gap:
                    break
                # The tuple nearest in time, from about where it must be.
                j = min(max(first + int((when[i] - begin) * rate), first), last)
                while j > first and abs(time[j - 1] - when[i]) < abs(time[j] - when[i]):
                    j -= 1
                while j < last and abs(time[j + 1] - when[i]) <= abs(time[j] - when[i]):
                    j += 1
                late = when[i] - time[j]
                if abs(late) > gap:
                    continue
                x = ball_position[i, 0] - position[j, 0] - late * velocity[j, 0]
                y = ball_position[i, 1] - side * (position[j, 1] + late * velocity[j, 1])
                z = ball_position[i, 2] - position[j, 2] - late * velocity[j, 2]
                distance = x * x + y * y + z * z
                if distance < nearest:
                    nearest, point, row, offset = distance, i, j, (x, y, z)
            if row < 0:
                continue
            probability = meeting_probability(
                offset,
                (ball_velocity[point, 0], ball_velocity[point, 1], ball_velocity[point, 2]),
                (velocity[row, 0], side * velocity[row, 1], velocity[row, 2]),
                (
                    ball_covariance[point, 0, 0] + variance[swing, 0],
                    ball_covariance[point, 1, 1] + variance[swing, 1],
                    ball_covariance[point, 2, 2] + variance[swing, 2],
                    ball_covariance[point, 0, 1],
                    ball_covariance[point, 0, 2],
                    ball_covariance[point, 1, 2],
                ),
                begin - when[point],
                end - when[point],
                extent,
            )
            # The plates are farther apart than a ball is wide, so that it meets one at most.
            total += probability
            if likelier_row < 0 or probability > likelier:
                likelier, likelier_point, likelier_row, likelier_side = probability, point, row, side
        total = min(1.0, total)
        if total > best.probability:
            best = Found(total, motion, likelier_point, likelier_row, likelier_side)
    return best


@njit(cache=True)
def most_probable(
    ball: BallPath, underway: Underway, refine: bool, swings: Swings, extent: Extent, coarse: Indices
) -> Found:
    """Find the motion that most probably meets the ball: on a coarse lattice of theta, then finer around its best.

    Args:
        ball: Where it is predicted to fly.
        underway: What new commands must equal.
        refine: Whether to go on to the finest lattice, or to halve the distances once, for a comparison.
        swings: The table.
        extent: Of plate and ball.
        coarse: How many values apart those are that are tried first, of each parameter, shape (n,).
    """
    best = Found(0.0, -1, -1, -1, 1)
    lattice, size, place, motion_rows = swings.lattice, swings.size, swings.place, swings.motion
    executed, elapsed = underway.motion, underway.elapsed
    # Few motions still fit once a target is bound.
    step = np.ones_like(coarse) if underway.begun else coarse.copy()
    first, last = np.zeros_like(size), size.copy()
    finest = 1 if refine else max(1, step.max() // 2)
    motions = np.empty(lattice.size, dtype=np.int64)
    index = np.empty_like(size)
    while True:
        count = 0
        index[:] = first
        while index[0] < last[0]:
            cell = 0
            for axis in range(len(size)):
                cell = cell * size[axis] + index[axis]
            motion = lattice[cell]
            if motion >= 0 and keeps_executed_part(motion_rows, motion, 0, executed, elapsed):
                motions[count] = motion
                count += 1
            # The next one, the last parameter fastest.
            axis = len(size) - 1
            index[axis] += step[axis]
            while axis > 0 and index[axis] >= last[axis]:
                index[axis] = first[axis]
                axis -= 1
                index[axis] += step[axis]
        found = most_probable_of(motions[:count], ball, swings, extent)
        if found.probability > best.probability:
            best = found
        if best.motion < 0 or step.max() <= finest:
            return best
        # Neighbours of the best, half as far apart.
        for axis in range(len(size)):
            middle, half = place[best.motion, axis], max(1, step[axis] // 2)
            first[axis] = max(middle % half, middle - 2 * half)
            last[axis] = min(size[axis], middle + 2 * half + 1)
            step[axis] = half
