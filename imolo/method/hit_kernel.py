"""Compiled: the probability that a swinging plate meets a flying ball, and the motion for which it is highest.

The equations are in docs/choice.md.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from imolo.method.table_kernel import keeps_executed_part

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Vector = tuple[float, float, float]

LEAST_CLOSING_SPEED = 0.5  # [m/s] slower, and hand and ball do not meet within a swing
COARSE_ROWS, COARSE_COLUMNS = 10, 13  # values of k and t_w that are tried first: 28 mm sideways and 16 ms apart
_LEVEL = 1e-6  # [-] horizontal part of a direction that is not vertical
_TINY = 1e-12  # [m²]
_FAR = 6.0  # [standard deviations] beyond which a probability, below 1e-9, is taken for 0


class Swings(NamedTuple):
    """The tuples of a table by motion, T motions and M tuples in all.

    Attributes:
        lattice: Motion by index of k and of t_w, shape (K, W); -1 where there is none.
        place: Index of k and of t_w of each motion, shape (T, 2).
        mirror: Motion with the opposite k, shape (T,); -1 where there is none.
        theta: k [-], t_w [µs] of each motion, shape (T, 2).
        variance: Of the hand's position along each axis [m²], shape (T, 3).
        start: First tuple of each motion, shape (T + 1,).
        time: Since the onset [s], increasing within a motion, shape (M,).
        position: Of the hand [m], shape (M, 3).
        velocity: Of the hand [m/s], shape (M, 3).
    """

    lattice: Indices
    place: Indices
    mirror: Indices
    theta: Array
    variance: Array
    start: Indices
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
        reach: Half the short side of the plate and the radius of the ball [m].
        timing_variance: Of the motion [s²].
        time_gap: Longest time between a point of the path and its tuple [s].
        farthest: Distance of ball and hand beyond which they are not considered [m].
    """

    reach: float
    timing_variance: float
    time_gap: float
    farthest: float


class Underway(NamedTuple):
    """The executed part of a motion, as `keeps_executed_part` wants it."""

    k: float
    switch_us: float
    elapsed_us: float


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
def _variance_along(x: float, y: float, z: float, C: Array, hand: Array, velocity: Vector, timing: float) -> float:
    """Return the variance of the offset along the unit vector (x, y, z) [m²]."""
    ball = C[0, 0] * x * x + C[1, 1] * y * y + C[2, 2] * z * z
    ball += 2.0 * (C[0, 1] * x * y + C[0, 2] * x * z + C[1, 2] * y * z)
    along = velocity[0] * x + velocity[1] * y + velocity[2] * z
    total: float = ball + hand[0] * x * x + hand[1] * y * y + hand[2] * z * z + timing * along * along
    return max(total, _TINY)


@njit(cache=True, inline="always")
def meeting_probability(
    offset: Vector,
    ball_velocity: Array,
    hand_velocity: Vector,
    ball_covariance: Array,
    hand_variance: Array,
    until_first: float,
    until_last: float,
    extent: Extent,
) -> float:
    """Return the probability that the ball, as the hand sees it, flies through a square about the hand while it swings.

    Args:
        offset: Ball minus hand at one moment [m].
        ball_velocity: [m/s], shape (3,).
        hand_velocity: [m/s].
        ball_covariance: Of the ball's position [m²], shape (3, 3).
        hand_variance: Of the hand's position along each axis [m²], shape (3,).
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
    C, hand, timing, reach = ball_covariance, hand_variance, extent.timing_variance, extent.reach
    # n is where the ball comes from as the hand sees it, a horizontal, b = n × a.
    nx, ny, nz = wx / closing, wy / closing, wz / closing
    ax, ay = -wy / level, wx / level
    a = offset[0] * ax + offset[1] * ay
    std_a = math.sqrt(_variance_along(ax, ay, 0.0, C, hand, hand_velocity, timing))
    if abs(a) > reach + _FAR * std_a:
        return 0.0
    bx, by, bz = -nz * ay, nz * ax, nx * ay - ny * ax
    b = offset[0] * bx + offset[1] * by + offset[2] * bz
    std_b = math.sqrt(_variance_along(bx, by, bz, C, hand, hand_velocity, timing))
    if abs(b) > reach + _FAR * std_b:
        return 0.0
    n = offset[0] * nx + offset[1] * ny + offset[2] * nz
    std_n = math.sqrt(_variance_along(nx, ny, nz, C, hand, hand_velocity, timing))
    probability: float = (
        normal_within(a, std_a, -reach, reach)
        * normal_within(b, std_b, -reach, reach)
        * normal_within(-n / closing, std_n / closing, until_first, until_last)
    )
    return probability


@njit(cache=True, inline="always")
def _one_hand(motion: int, side: float, ball: BallPath, swings: Swings, extent: Extent) -> tuple[float, int, int]:
    """Return how likely a motion's hand meets the ball, and the point of the path and the tuple nearest to it.

    `side` mirrors the hand: 1.0 for the one that was learned, -1.0 for the other.
    """
    first, last = swings.start[motion], swings.start[motion + 1]
    begin, end = swings.time[first], swings.time[last - 1]
    gap = extent.time_gap
    nearest, nearest_point, nearest_row = extent.farthest**2, -1, -1
    offset = (0.0, 0.0, 0.0)
    row = first
    for point in range(np.searchsorted(ball.time, begin - gap), len(ball.time)):
        when = ball.time[point]
        if when > end + gap:
            break
        while row + 1 < last and abs(swings.time[row + 1] - when) <= abs(swings.time[row] - when):
            row += 1
        late = when - swings.time[row]
        if abs(late) > gap:
            continue
        x = ball.position[point, 0] - swings.position[row, 0] - late * swings.velocity[row, 0]
        y = ball.position[point, 1] - side * (swings.position[row, 1] + late * swings.velocity[row, 1])
        z = ball.position[point, 2] - swings.position[row, 2] - late * swings.velocity[row, 2]
        distance = x * x + y * y + z * z
        if distance < nearest:
            nearest, nearest_point, nearest_row, offset = distance, point, row, (x, y, z)
    if nearest_row < 0:
        return 0.0, -1, -1
    velocity = swings.velocity[nearest_row]
    p = meeting_probability(
        offset,
        ball.velocity[nearest_point],
        (velocity[0], side * velocity[1], velocity[2]),
        ball.covariance[nearest_point],
        swings.variance[motion],
        begin - ball.time[nearest_point],
        end - ball.time[nearest_point],
        extent,
    )
    return p, nearest_point, nearest_row


@njit(cache=True)
def either_hand(motion: int, ball: BallPath, swings: Swings, extent: Extent) -> Found:
    """Return how likely a given motion meets the ball with one of its hands."""
    p, point, row = _one_hand(motion, 1.0, ball, swings, extent)
    side, other = 1, swings.mirror[motion]
    if other >= 0:
        q, other_point, other_row = _one_hand(other, -1.0, ball, swings, extent)
        if q > p:
            point, row, side = other_point, other_row, -1
        # The plates are farther apart than a ball is wide, so that it meets one at most.
        p = min(1.0, p + q)
    return Found(p, motion, point, row, side)


@njit(cache=True)
def most_probable(ball: BallPath, underway: Underway, refine: bool, swings: Swings, extent: Extent) -> Found:
    """Find the motion that most probably meets the ball: on a coarse lattice of theta, then finer around its best.

    Args:
        ball: Where it is predicted to fly.
        underway: What new commands must equal; k is NaN while it is free.
        refine: Whether to go on to the finest lattice, or to halve the distances once, for a comparison.
        swings: The table.
        extent: Of plate and ball.
    """
    best = Found(0.0, -1, -1, -1, 1)
    count_k, count_w = swings.lattice.shape
    step_k, step_w = max(1, count_k // COARSE_ROWS), max(1, count_w // COARSE_COLUMNS)
    if not math.isnan(underway.k):
        step_k = step_w = 1  # few motions still fit
    first_k, last_k, first_w, last_w = 0, count_k, 0, count_w
    finest = 1 if refine else max(1, max(step_k, step_w) // 2)
    while True:
        for i in range(first_k, last_k, step_k):
            for j in range(first_w, last_w, step_w):
                motion = swings.lattice[i, j]
                if motion < 0 or not keeps_executed_part(
                    swings.theta[motion, 0],
                    swings.theta[motion, 1],
                    underway.k,
                    underway.switch_us,
                    underway.elapsed_us,
                ):
                    continue
                found = either_hand(motion, ball, swings, extent)
                if found.probability > best.probability:
                    best = found
        if best.motion < 0 or max(step_k, step_w) <= finest:
            return best
        # Neighbours of the best, half as far apart.
        i, j = swings.place[best.motion]
        half_k, half_w = max(1, step_k // 2), max(1, step_w // 2)
        first_k, last_k = max(i % half_k, i - 2 * half_k), min(count_k, i + 2 * half_k + 1)
        first_w, last_w = max(j % half_w, j - 2 * half_w), min(count_w, j + 2 * half_w + 1)
        step_k, step_w = half_k, half_w
