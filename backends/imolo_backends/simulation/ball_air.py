"""What the air does to the ball."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class BallAir:
    """Drag and lift on the flying ball, F = -k |v| v + l × v.

    Attributes:
        drag: k [kg/m].
        lift: l [kg/s], shape (3,).
        force: [N], shape (3,); `step` fills it, and the engine reads the same array.
    """

    def __init__(self, drag: float, lift: Array) -> None:
        """Take k [kg/m] and l [kg/s], shape (3,)."""
        self.drag = drag
        self.lift = lift
        self.force = np.zeros(3)

    def step(self, velocity: Array) -> None:
        """Set `force` for the velocity of the ball [m/s], shape (3,)."""
        set_force(self.force, self.drag, self.lift, velocity)


@njit(cache=True)
def set_force(force: Array, drag: float, lift: Array, velocity: Array) -> None:
    """Set the force on a ball of this velocity [m/s]."""
    x, y, z = velocity
    braking = drag * math.sqrt(x**2 + y**2 + z**2)
    force[0] = -braking * x + (lift[1] * z - lift[2] * y)
    force[1] = -braking * y + (lift[2] * x - lift[0] * z)
    force[2] = -braking * z + (lift[0] * y - lift[1] * x)
