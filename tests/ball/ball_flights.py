"""An independent ball for the tests: quadratic air drag, thrown from 5 m as in Sec. VII-A."""

import numpy as np
from scipy.integrate import solve_ivp

from imolo.ball.flight import Flight
from imolo_msgs import marker_t, mocap_frame_t

RATE = 120.0  # [Hz] Sec. VII-A
DRAG = 0.172  # [1/m] 0.45 · ½ · 1.2 kg/m³ · π (0.045 m)² / 10 g
GRAVITY = np.array([0.0, 0.0, -9.81])


def drag(velocity):
    return GRAVITY - DRAG * np.linalg.norm(velocity) * velocity


def fly(state, time, acceleration=drag):
    """States of a ball [m, m/s], shape (N, 6), at `time` [s], shape (N,), that starts at time[0]."""
    solution = solve_ivp(
        lambda _, x: np.concatenate([x[3:], acceleration(x[3:])]),
        (time[0], time[-1]),
        state,
        t_eval=time,
        method="DOP853",
        rtol=1e-11,
        atol=1e-12,
    )
    return solution.y.T


def release(rng):
    """State at the release of a throw towards the robot at the origin, 6 to 8 m/s."""
    speed, elevation, azimuth = rng.uniform(6.0, 8.0), np.radians(rng.uniform(25, 50)), np.radians(rng.uniform(-8, 8))
    direction = [-np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return np.concatenate([[5.0, rng.uniform(-0.5, 0.5), 1.1], speed * np.array(direction)])


def record(rng, count, noise, acceleration=drag, duration=1.0, missing=0.0):
    """Recorded throws; a share `missing` of the samples is lost."""
    flights = []
    for _ in range(count):
        time = np.arange(0.0, duration, 1.0 / RATE)
        states = fly(release(rng), time, acceleration)
        seen = rng.random(len(time)) >= missing
        flights.append(Flight(time[seen], (states[:, :3] + noise * rng.standard_normal((len(time), 3)))[seen]))
    return flights


def make_frame(utime, unlabelled, labelled=((0.0, 0.1, 0.9), (0.0, -0.1, 0.5))):
    """A mocap frame with a robot at the origin."""
    frame = mocap_frame_t()
    frame.utime = int(utime)
    for marker_id, position in [*enumerate(labelled), *((-1, position) for position in unlabelled)]:
        marker = marker_t()
        marker.marker_id, marker.marker_position = marker_id, [float(value) for value in position]
        frame.markers.append(marker)
    frame.num_markers = len(frame.markers)
    return frame
