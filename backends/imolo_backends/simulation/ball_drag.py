"""What the air does to the ball."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class BallDrag:
    """The drag on the flying ball, F = -k |v| v.

    Attributes:
        force: [N], shape (3,); `step` fills it, and the engine reads the same array.
    """

    def __init__(self, drag: float) -> None:
        """Take k [kg/m]."""
        self._drag = drag
        self.force = np.zeros(3)

    def step(self, velocity: Array) -> None:
        """Set `force` for the velocity of the ball [m/s], shape (3,)."""
        _set_force(self.force, self._drag, velocity)


@njit(cache=True)
def _set_force(force: Array, drag: float, velocity: Array) -> None:
    speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    for axis in range(3):
        force[axis] = -drag * speed * velocity[axis]
