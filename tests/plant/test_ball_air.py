"""What the air does to the ball."""

import math

import numpy as np
from liberobot import BALL
from numpy.testing import assert_allclose

from imolo.tasks.thrower import drag_of, lift_of
from imolo_backends.simulation.ball_air import BallAir

ROUNDING = 1e-12  # relative, of some operations in double precision
DRAG = 0.5 * 1.2 * 0.45 * math.pi * 0.045**2  # [kg/m] ½ rho Cd A: 1.2 kg/m³, 0.45, 45 mm


def force(velocity: list[float], spin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    air = BallAir(drag_of(BALL), lift_of(BALL, np.array(spin)))
    air.step(np.array(velocity))
    return air.force


def test_topspin_presses_the_ball_down() -> None:
    # ½ rho A v² Cl at 5 m/s and 10 rad/s, Cl = r ω / v = .09.
    lift = 0.5 * 1.2 * math.pi * 0.045**2 * 25.0 * 0.09
    drag = force([-5.0, 0.0, 0.0])
    assert_allclose(force([-5.0, 0.0, 0.0], (0.0, -10.0, 0.0)) - drag, [0.0, 0.0, -lift], rtol=ROUNDING, atol=1e-18)


def test_lift_does_no_work() -> None:
    velocity = [-4.0, 1.0, 3.0]
    lift = force(velocity, (20.0, -11.0, 7.0)) - force(velocity)
    assert np.linalg.norm(lift) > 0.001
    assert abs(lift @ velocity) < ROUNDING * np.linalg.norm(lift) * np.linalg.norm(velocity)


def test_drag_is_opposite_and_quadratic() -> None:
    velocity = [-6.0, 0.4, 3.0]
    assert_allclose(force(velocity), -DRAG * math.sqrt(45.16) * np.array(velocity), rtol=ROUNDING)


def test_terminal_speed_of_the_ball_is_7_6_metres_per_second() -> None:
    speed = math.sqrt(0.010 * 9.81 / DRAG)
    assert round(speed, 1) == 7.6
    assert_allclose(force([0.0, 0.0, -speed]), [0.0, 0.0, 0.010 * 9.81], rtol=ROUNDING)
