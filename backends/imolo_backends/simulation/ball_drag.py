"""What the air does to the ball."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class BallDrag:
    """The drag on the flying ball, F = -k |v| v.

    Attributes:
        drag: k [kg/m].
        force: [N], shape (3,); `step` fills it, and the engine reads the same array.
    """

    def __init__(self, drag: float) -> None:
        """Take k [kg/m]."""
        self.drag = drag
        self.force = np.zeros(3)

    def step(self, velocity: Array) -> None:
        """Set `force` for the velocity of the ball [m/s], shape (3,)."""
        set_force(self.force, self.drag, velocity)


@njit(cache=True)
def set_force(force: Array, drag: float, velocity: Array) -> None:
    """Set the drag on a ball of this velocity [m/s]."""
    speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    for axis in range(3):
        force[axis] = -drag * speed * velocity[axis]
