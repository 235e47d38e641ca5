"""The machine that throws the ball (Sec. VII-A)."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import root

from imolo.config.simulation import BallConfig, ThrowerConfig
from imolo.contracts.task import Throw
from imolo.errors import ConfigError

Array = NDArray[np.float64]

GRAVITY = 9.81  # [m/s²]
FASTEST = 50.0  # [m/s] no machine throws a foam ball faster, and the drag law would not hold


def draw_throw(thrower: ThrowerConfig, ball: BallConfig, index: int, rng: np.random.Generator) -> Throw:
    """Draw the throw of one trial.

    Raises:
        ConfigError: No release velocity reaches the aim point in the flight time.
    """
    position = held_at(thrower, index)
    aim_point = np.array(thrower.aim_center) + rng.uniform(-1.0, 1.0, 3) * np.array(thrower.aim_spread)
    flight_time = thrower.flight_time + rng.uniform(-1.0, 1.0) * thrower.flight_time_spread
    spin = thrower.topspin * _across(aim_point - position)
    velocity = aimed_velocity(ball, position, aim_point, flight_time, lift_of(ball, spin))
    speed = np.linalg.norm(velocity) * (1.0 + rng.normal(0.0, thrower.speed_scatter))
    elevation = math.asin(velocity[2] / np.linalg.norm(velocity)) + rng.normal(0.0, thrower.angle_scatter)
    azimuth = math.atan2(velocity[1], velocity[0]) + rng.normal(0.0, thrower.angle_scatter)
    direction = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    release_time = rng.uniform(*thrower.hold_time)
    spin = spin + rng.normal(0.0, thrower.spin_scatter, 3)
    return Throw(position, speed * direction, release_time, lift_of(ball, spin))


def by_hand(thrower: ThrowerConfig) -> ThrowerConfig:
    """Return how the balls are thrown that a ball model is learned from: not by the machine, so without its topspin."""
    return thrower.model_copy(update={"topspin": 0.0})


def held_at(thrower: ThrowerConfig, index: int) -> Array:
    """Return where the ball of one trial is released [m], shape (3,); the positions take turns."""
    return np.array(thrower.positions[index % len(thrower.positions)])


def aimed_velocity(
    ball: BallConfig, position: Array, aim_point: Array, flight_time: float, lift: Array | None = None
) -> Array:
    """Return the release velocity with which the ball is at the aim point after the flight time in the air.

    Args:
        ball: Gives mass and drag.
        position: Release point [m], shape (3,).
        aim_point: [m], shape (3,).
        flight_time: [s].
        lift: l in F = l × v [kg/s], shape (3,); none if not given.

    Returns:
        Velocity [m/s], shape (3,).

    Raises:
        ConfigError: There is none.
    """
    drag = drag_of(ball) / ball.mass
    turn = np.zeros(3) if lift is None else lift / ball.mass

    def derivative(_: float, state: Array) -> Array:
        velocity = state[3:]
        acceleration = np.cross(turn, velocity) - drag * np.linalg.norm(velocity) * velocity
        acceleration[2] -= GRAVITY
        return np.concatenate((velocity, acceleration))

    def miss(velocity: Array) -> Array:
        flight = solve_ivp(derivative, (0.0, flight_time), np.concatenate((position, velocity)), rtol=1e-9, atol=1e-9)
        return np.asarray(flight.y[:3, -1] - aim_point)

    too_far = ConfigError(
        f"no throw from {position.tolist()} at up to {FASTEST:g} m/s is at {aim_point.tolist()} after "
        f"{flight_time:g} s; aim nearer or give it more time"
    )
    without_drag = (aim_point - position) / flight_time + np.array([0.0, 0.0, 0.5 * GRAVITY * flight_time])
    if np.linalg.norm(without_drag) > FASTEST:
        raise too_far
    solution = root(miss, without_drag)
    if not solution.success or np.abs(solution.fun).max() > 1e-6 or np.linalg.norm(solution.x) > FASTEST:
        raise too_far
    return np.asarray(solution.x)


def drag_of(ball: BallConfig) -> float:
    """Return the force of the air over the square of the speed, ½ ρ Cd A [kg/m]."""
    return 0.5 * ball.air_density * ball.drag_coefficient * math.pi * ball.radius**2


def lift_of(ball: BallConfig, spin: Array) -> Array:
    """Return l in F = l × v, the lift ½ ρ A Cl |v|² of a ball that spins with ω, where Cl = slope · r |ω| / |v|.

    Args:
        ball: The ball.
        spin: ω [rad/s], shape (3,).

    Returns:
        l [kg/s], shape (3,).
    """
    return np.asarray(0.5 * ball.air_density * ball.lift_slope * math.pi * ball.radius**3 * spin)


def _across(way: Array) -> Array:
    """Return the axis, shape (3,), about which a ball turns that rolls a way [m], shape (3,), on level ground."""
    return np.array([-way[1], way[0], 0.0]) / max(math.hypot(way[0], way[1]), 1e-12)
