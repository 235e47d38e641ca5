"""Find the free flight of a recorded ball before it bounces or is hit, for any ball and any rate."""

import numpy as np
from numpy.typing import NDArray

from imolo.ball.flight import FEWEST_SAMPLES, GRAVITY, Flight
from imolo.errors import TrainingDataError

Array = NDArray[np.float64]

WINDOW = 0.05  # [s] of a local fit on each side of a kink; the air changes 1 m/s² in it, gravity 0.5 m/s
FEWEST_IN_WINDOW = 6  # twice the unknowns of a quadratic
CERTAIN = 6.0  # standard deviations of a velocity jump that noise does not reach in a million samples
LEAST_CHANGE = 0.5  # share of the velocity that a contact changes: towards the floor, or of the faster side
FALLING = (0.25, 3.0)  # [g] downward acceleration of a flying ball, lift and drag included; at rest it is 0


def before_bounce(time: Array, position: Array) -> Flight:
    """Cut the free flight before the first bounce out of a recorded track.

    Where a ball touches something its velocity jumps. Quadratics are fitted on both sides of every sample; a jump that
    is certain against their noise, and larger than what gravity does within a window, parts the track if it takes at
    least half of a downward velocity, which is a bounce, or is half of the speed, as a launch or a hit. Of the parts
    before the first bounce the longest one that falls is the flight.

    Args:
        time: Time of the samples, increasing, gaps allowed [s], shape (N,).
        position: Measured positions, z up [m], shape (N, 3).

    Returns:
        The samples of the free flight, up to the last one before the contact.

    Raises:
        TrainingDataError: The track is too short, or nothing in it falls freely.
    """
    if len(time) < FEWEST_SAMPLES:
        raise TrainingDataError(f"it has {len(time)} samples; a flight needs {FEWEST_SAMPLES}")
    start, parts = 0, []
    for kink, bounces in _kinks(time, position):
        parts.append((start, kink))
        start = kink
        if bounces:
            break
    else:
        parts.append((start, len(time)))
    falling = [part for part in parts if part[1] - part[0] >= FEWEST_SAMPLES and _falls(time, position, *part)]
    if not falling:
        raise TrainingDataError(
            f"none of its {len(parts)} parts before a bounce has {FEWEST_SAMPLES} samples and falls like a free ball"
        )
    first, last = max(falling, key=lambda part: time[part[1] - 1] - time[part[0]])
    return Flight(time=time[first:last], position=position[first:last])


def _falls(time: Array, position: Array, first: int, last: int) -> bool:
    curvature = 2.0 * np.polynomial.Polynomial.fit(time[first:last], position[first:last, 2], 2).convert().coef[2]
    low, high = (share * np.linalg.norm(GRAVITY) for share in FALLING)
    return bool(low <= -curvature <= high)


def _kinks(time: Array, position: Array) -> list[tuple[int, bool]]:
    """Return the first sample after each jump of the velocity, and whether the jump is a bounce."""
    size = max(FEWEST_IN_WINDOW, round(WINDOW / float(np.median(np.diff(time)))))
    splits = np.arange(size, len(time) - size + 1)
    if not len(splits):
        return []
    fits = [_two_sides(time, position, int(split), size) for split in splits]
    before, after = (np.array([fit[side] for fit in fits]) for side in (0, 1))
    rms, lever = np.array([fit[2] for fit in fits]), np.array([fit[3] for fit in fits])
    noise = np.median(rms, axis=0) + 1e-9
    jump = after - before
    deviation = noise * lever[:, None]
    size_of_jump = np.linalg.norm(jump, axis=1)
    gravity_in_window = np.linalg.norm(GRAVITY) * np.array([time[s + size - 1] - time[s] for s in splits])
    bouncing = (before[:, 2] < -CERTAIN * deviation[:, 2]) & (
        jump[:, 2] > np.max([-LEAST_CHANGE * before[:, 2], CERTAIN * deviation[:, 2], gravity_in_window], axis=0)
    )
    faster = np.maximum(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1))
    hit = np.any(np.abs(jump) > CERTAIN * deviation, axis=1) & (
        size_of_jump > np.maximum(LEAST_CHANGE * faster, gravity_in_window)
    )
    certain = bouncing | hit
    kinks = []
    while certain.any():
        top = int(np.argmax(np.where(certain, size_of_jump, 0.0)))
        near = np.abs(np.arange(len(splits)) - top) < size
        # The jump is widest where both sides are free flight; among its neighbours the parts fit best there, too.
        candidates = np.flatnonzero(np.abs(np.arange(len(splits)) - top) <= size // 2)
        best = int(candidates[np.argmin(np.sum((rms[candidates] / noise) ** 2, axis=1))])
        kinks.append((int(splits[best]), bool(bouncing[top])))
        certain &= ~near
    return sorted(kinks)


def _two_sides(time: Array, position: Array, split: int, size: int) -> tuple[Array, Array, Array, float]:
    """Fit quadratics to `size` samples before and from `split` on.

    Returns:
        Velocity just before and just after [m/s], shape (3,) each; rms residual per axis [m], shape (3,); standard
        deviation of the difference of the velocities at unit noise [1/s].
    """
    at = 0.5 * (time[split - 1] + time[split])
    velocities, squares, variance = [], np.zeros(3), 0.0
    for part in (slice(split - size, split), slice(split, split + size)):
        elapsed = time[part] - at
        solver = np.linalg.pinv(np.stack([np.ones(size), elapsed, elapsed**2], axis=1))
        coefficients = solver @ position[part]
        fitted = np.stack([np.ones(size), elapsed, elapsed**2], axis=1) @ coefficients
        velocities.append(coefficients[1])
        squares += np.sum((position[part] - fitted) ** 2, axis=0)
        variance += float(solver[1] @ solver[1])
    return velocities[0], velocities[1], np.sqrt(squares / (2.0 * (size - 3))), float(np.sqrt(variance))
