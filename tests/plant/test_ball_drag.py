"""What the air does to the ball."""

import math

import numpy as np
from liberobot import BALL
from numpy.testing import assert_allclose

from imolo.tasks.thrower import drag_of
from imolo_backends.simulation.ball_drag import BallDrag

ROUNDING = 1e-12  # relative, of some operations in double precision
DRAG = 0.5 * 1.2 * 0.45 * math.pi * 0.045**2  # [kg/m] ½ rho Cd A: 1.2 kg/m³, 0.45, 45 mm


def force(velocity: list[float]) -> np.ndarray:
    drag = BallDrag(drag_of(BALL))
    drag.step(np.array(velocity))
    return drag.force


def test_drag_is_opposite_and_quadratic() -> None:
    velocity = [-6.0, 0.4, 3.0]
    assert_allclose(force(velocity), -DRAG * math.sqrt(45.16) * np.array(velocity), rtol=ROUNDING)


def test_terminal_speed_of_the_ball_is_7_6_metres_per_second() -> None:
    speed = math.sqrt(0.010 * 9.81 / DRAG)
    assert round(speed, 1) == 7.6
    assert_allclose(force([0.0, 0.0, -speed]), [0.0, 0.0, 0.010 * 9.81], rtol=ROUNDING)
