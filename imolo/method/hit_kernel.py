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

LEAST_CLOSING_SPEED = 0.5  # [m/s] slower, and hand and ball do not meet within a swing
FINE_ROWS = 8  # values of k that are tried between two coarse ones
COARSE_ROWS, COARSE_COLUMNS = 19, 26  # values of k and t_w that are tried first: 14 mm sideways and 8 ms apart
_LEVEL = 1e-6  # [-] horizontal part of a direction that is not vertical
_TINY = 1e-12  # [m²]


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


@njit(cache=True)
def normal_within(mean: float, std: float, low: float, high: float) -> float:
    """Return the probability that a normal variable lies between two bounds."""
    scale = 1.0 / (std * math.sqrt(2.0))
    return 0.5 * (math.erf((high - mean) * scale) - math.erf((low - mean) * scale))


@njit(cache=True)
def _quadratic(C: Array, a: float, b: float, c: float) -> float:
    square: float = C[0, 0] * a * a + C[1, 1] * b * b + C[2, 2] * c * c
    square += 2.0 * (C[0, 1] * a * b + C[0, 2] * a * c + C[1, 2] * b * c)
    return square


@njit(cache=True)
def meeting_probability(
    offset: Array,
    ball_velocity: Array,
    hand_velocity: Array,
    covariance: Array,
    until_first: float,
    until_last: float,
    reach: float,
) -> float:
    """Return the probability that the ball, as the hand sees it, flies through a square about the hand while it swings.

    Args:
        offset: Ball minus hand at one moment [m], shape (3,).
        ball_velocity: [m/s], shape (3,).
        hand_velocity: [m/s], shape (3,).
        covariance: Of the offset [m²], shape (3, 3).
        until_first: Begin of the swing after that moment [s]; negative if before it.
        until_last: End of the swing after that moment [s].
        reach: Half the side of the square [m].
    """
    wx = ball_velocity[0] - hand_velocity[0]
    wy = ball_velocity[1] - hand_velocity[1]
    wz = ball_velocity[2] - hand_velocity[2]
    closing = math.sqrt(wx * wx + wy * wy + wz * wz)
    level = math.hypot(wx, wy)
    if closing < LEAST_CLOSING_SPEED or level < _LEVEL * closing:
        return 0.0
    # n is where the ball comes from as the hand sees it, a horizontal, b = n × a.
    nx, ny, nz = wx / closing, wy / closing, wz / closing
    ax, ay = -wy / level, wx / level
    bx, by, bz = -nz * ay, nz * ax, nx * ay - ny * ax
    a = offset[0] * ax + offset[1] * ay
    b = offset[0] * bx + offset[1] * by + offset[2] * bz
    n = offset[0] * nx + offset[1] * ny + offset[2] * nz
    std_a = math.sqrt(max(_quadratic(covariance, ax, ay, 0.0), _TINY))
    std_b = math.sqrt(max(_quadratic(covariance, bx, by, bz), _TINY))
    std_n = math.sqrt(max(_quadratic(covariance, nx, ny, nz), _TINY))
    probability: float = (
        normal_within(a, std_a, -reach, reach)
        * normal_within(b, std_b, -reach, reach)
        * normal_within(-n / closing, std_n / closing, until_first, until_last)
    )
    return probability


@njit(cache=True)
def _one_hand(motion: int, side: float, ball: BallPath, swings: Swings, extent: Extent) -> tuple[float, int, int]:
    """Return how likely a motion's hand meets the ball, and the point of the path and the tuple nearest to it.

    `side` mirrors the hand: 1.0 for the one that was learned, -1.0 for the other.
    """
    first, last = swings.start[motion], swings.start[motion + 1]
    begin, end = swings.time[first], swings.time[last - 1]
    gap = extent.time_gap
    nearest, nearest_point, nearest_row = extent.farthest**2, -1, -1
    row = first
    for point in range(len(ball.time)):
        when = ball.time[point]
        if when < begin - gap:
            continue
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
            nearest, nearest_point, nearest_row = distance, point, row
    if nearest_row < 0:
        return 0.0, -1, -1
    when = ball.time[nearest_point]
    velocity = swings.velocity[nearest_row].copy()
    offset = swings.position[nearest_row] + (when - swings.time[nearest_row]) * velocity
    offset[1] *= side
    velocity[1] *= side
    offset = ball.position[nearest_point] - offset
    covariance = ball.covariance[nearest_point].copy()
    for i in range(3):
        covariance[i, i] += swings.variance[motion, i]
        for j in range(3):
            covariance[i, j] += extent.timing_variance * velocity[i] * velocity[j]
    p = meeting_probability(
        offset,
        ball.velocity[nearest_point],
        velocity,
        covariance,
        begin - when,
        end - when,
        extent.reach,
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
    """Find the motion that most probably meets the ball: on a coarse lattice of theta first, then around its best.

    Args:
        ball: Where it is predicted to fly.
        underway: What new commands must equal; k is NaN while it is free.
        refine: Whether to look around the best of the coarse lattice.
        swings: The table.
        extent: Of plate and ball.
    """
    best = Found(0.0, -1, -1, -1, 1)
    count_k, count_w = swings.lattice.shape
    step_k, step_w = max(1, count_k // COARSE_ROWS), max(1, count_w // COARSE_COLUMNS)
    if not math.isnan(underway.k):
        step_k = step_w = 1  # few motions still fit
    first_k, last_k, first_w, last_w = 0, count_k, 0, count_w
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
        if not refine or best.motion < 0 or step_k * step_w == 1:
            return best
        refine = False
        i, j = swings.place[best.motion]
        first_k, last_k = max(0, i - step_k + 1), min(count_k, i + step_k)
        first_w, last_w = max(0, j - step_w + 1), min(count_w, j + step_w)
        step_k, step_w = max(1, 2 * step_k // FINE_ROWS), 1
