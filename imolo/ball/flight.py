"""Recorded flights of the ball, cut out of what the cameras saw."""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from imolo.errors import TrainingDataError

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.81])  # [m/s²] standard; the ball model learns its own
MOST_RATE = 10.0  # [1/s] assumed: drag over speed of any ball; a 10 g foam ball at 8 m/s has 1.4
LEAST_NOISE = 1e-4  # [m] assumed: below what any mocap resolves; keeps fits regular on noise-free data
FEWEST_SAMPLES = 12  # of a flight: 0.1 s at 120 Hz


@dataclass(frozen=True, eq=False)
class Flight:
    """One recorded throw, free flight only (`free_flight` cuts it out of a marker track).

    Attributes:
        time: Time of the samples, increasing, gaps allowed [s], shape (N,).
        position: Ball position in the world frame [m], shape (N, 3).
    """

    time: Array
    position: Array


def free_flight(time: Array, position: Array, window: float = 0.15) -> Flight:
    """Cut the free flight out of a marker track that also has the thrower's hand, a bounce or a hit.

    Within a window that is all free flight the acceleration less gravity can only oppose the velocity (air drag); at
    rest the hand carries the weight, and while throwing it pushes along the velocity. The longest run of such windows
    is the flight. A quarter of g divides the two, up to a half where the fitted acceleration is noisier.

    Args:
        time: Time of the samples, increasing, gaps allowed [s], shape (N,).
        position: Marker position in the world frame [m], shape (N, 3).
        window: Duration of the local fits [s]; 2 mm of noise at 120 Hz leave 0.6 m/s² of uncertainty.

    Returns:
        The samples of the free flight, less a quarter of a window at both ends, where a fit hardly notices a mismatch.

    Raises:
        TrainingDataError: The track has no free flight, is too short or is not finite.
    """
    if not (np.isfinite(time).all() and np.isfinite(position).all()):
        raise TrainingDataError("the marker track has values that are not finite; leave the missing samples out")
    size = round(window / float(np.median(np.diff(time)))) if len(time) > FEWEST_SAMPLES else FEWEST_SAMPLES
    if len(time) < max(size, FEWEST_SAMPLES):
        raise TrainingDataError(f"the marker track has {len(time)} samples; a flight needs {max(size, FEWEST_SAMPLES)}")
    times = sliding_window_view(time, size)
    places = sliding_window_view(position, size, axis=0).transpose(0, 2, 1)
    elapsed = times - times.mean(axis=1, keepdims=True)
    design = np.stack([np.ones_like(elapsed), elapsed, elapsed**2 / 2.0], axis=2)
    solver = np.linalg.pinv(design)
    coefficients = solver @ places
    rms = np.sqrt(np.mean((places - design @ coefficients) ** 2, axis=(1, 2)))
    noise = float(np.median(rms)) + 1e-3  # [m] a quadratic misses the change of drag by up to 1 mm
    velocity, force = coefficients[:, 1], coefficients[:, 2] - GRAVITY
    drag_rate = np.clip(-np.sum(force * velocity, axis=1) / np.sum(velocity**2 + 1e-12, axis=1), 0.0, MOST_RATE)
    mismatch = np.linalg.norm(force + drag_rate[:, None] * velocity, axis=1)
    uncertainty = noise * np.linalg.norm(solver[:, 2], axis=1)
    weight = np.linalg.norm(GRAVITY)
    limit = np.clip(5.0 * uncertainty, 0.25 * weight, 0.5 * weight)
    free = (mismatch < limit) & (rms < 3.0 * noise) & (np.ptp(times, axis=1) < 2.0 * window)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(int), [0]])))
    if not len(edges):
        raise TrainingDataError("the marker track has no free flight; check that the ball was thrown and was seen")
    first, last = max(zip(edges[::2], edges[1::2], strict=True), key=lambda run: time[run[1] - 1] - time[run[0]])
    trim = size // 4
    inside = slice(first + trim, last - 1 + size - trim)
    return Flight(time=time[inside], position=position[inside])
