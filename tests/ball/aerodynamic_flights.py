"""Flights of balls with drag and spin from a known population, and the model that knows it."""

import numpy as np
from ball_flights import GRAVITY, RATE, fly

from imolo.ball.aerodynamic import AerodynamicBallModel
from imolo.ball.flight import Flight

NOISE = 0.002  # [m]
BIAS_TIME = 0.05  # [s]
DENSITY = 1e-11  # [m²/s³] next to none: the balls of these tests obey the equation of motion
MEAN = np.array([-5.5, 0.1, 4.0, 0.13, 0.3, -0.5, 0.2])
SPREAD = np.array([0.3, 0.2, 0.3, 0.015, 0.15, 0.15, 0.15])


def magnus(k, omega):
    return lambda v: GRAVITY - k * np.linalg.norm(v) * v + np.cross(omega, v)


def throws(rng, count, duration=0.9, spin=True):
    """Flights of balls drawn from the population; their start states, shape (count, 10)."""
    time, flights, starts = np.arange(0.0, duration, 1.0 / RATE), [], []
    for _ in range(count):
        latent = MEAN + SPREAD * rng.standard_normal(7)
        latent[4:] *= spin
        start = np.concatenate([[5.0, 0.0, 1.1], latent])
        path = fly(start[:6], time, magnus(start[6], start[7:]))[:, :3]
        flights.append(Flight(time, path + NOISE * rng.standard_normal(path.shape)))
        starts.append(start)
    return flights, np.array(starts)


def lasting(rng, time, std, correlation_time):
    """An error of the cameras that lasts [m], shape (N, 3): a first-order Gauss-Markov process."""
    correlation = np.exp(-np.abs(time[:, None] - time) / correlation_time)
    return std * np.linalg.cholesky(correlation) @ rng.standard_normal((len(time), 3))


def known(kind="spin", density=DENSITY, bias=0.0):
    size = {"drag": 4, "spin": 7}[kind]
    return AerodynamicBallModel(
        kind=kind,
        time_step=0.0083,
        acceleration_density=density,
        measurement_std=np.full(3, NOISE),
        prior_mean=MEAN[:size],
        prior_std=SPREAD[:size],
        bias_std=np.full(3, bias),
        bias_time=BIAS_TIME,
    )
