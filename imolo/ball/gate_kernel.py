"""Compiled gate of the ball's track."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def nearest_marker(markers: Array, state: Array, P: Array, R: Array, margin: float) -> tuple[int, float, float]:
    """Find the marker that is nearest to a track.

    Args:
        markers: [m], shape (M, 3).
        state: Of the filter, position first, shape (n,).
        P: Its covariance, shape (n, n).
        R: Of a measured position [m²], shape (3, 3).
        margin: Slack of the gate [m²].

    Returns:
        Which; its squared Mahalanobis distance with and without the margin. Infinitely far where there is no marker.
    """
    spread = P[:3, :3] + R
    inverse, wide_inverse = np.linalg.inv(spread), np.linalg.inv(spread + margin * np.eye(3))
    nearest, least, surprise = -1, np.inf, np.inf
    for i in range(len(markers)):
        distance = without = 0.0
        for a in range(3):
            for b in range(3):
                product = (markers[i, a] - state[a]) * (markers[i, b] - state[b])
                distance += wide_inverse[a, b] * product
                without += inverse[a, b] * product
        if distance < least:
            nearest, least, surprise = i, distance, without
    return nearest, least, surprise
