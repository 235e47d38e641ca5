"""Compiled flight of a ball under gravity, quadratic drag and Magnus lift, with its sensitivity to the state.

The state is (p, v, k) or (p, v, k, ω), see `imolo.ball.aerodynamic`.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

GRAVITY = 9.81  # [m/s²] as everywhere in imolo
LONGEST_STEP = 0.01  # [s] of RK4; a 25 m/s foam ball is then right to 1e-6 m after 1 s
COVARIANCE_STEP = 0.05  # [s] of the uncertainty along a path, which need not be as exact as the path
LEAST_SPEED = 1e-9  # [m/s] keeps the direction of a ball at rest finite


@njit(cache=True)
def _derivative(state: Array) -> Array:
    rate = np.zeros_like(state)
    vx, vy, vz, k = state[3], state[4], state[5], state[6]
    drag = k * math.sqrt(vx * vx + vy * vy + vz * vz)
    rate[0], rate[1], rate[2] = vx, vy, vz
    rate[3], rate[4], rate[5] = -drag * vx, -drag * vy, -drag * vz - GRAVITY
    if len(state) > 7:
        wx, wy, wz = state[7], state[8], state[9]
        rate[3] += wy * vz - wz * vy
        rate[4] += wz * vx - wx * vz
        rate[5] += wx * vy - wy * vx
    return rate


@njit(cache=True)
def _sensitivity_rate(state: Array, sensitivity: Array) -> Array:
    """Return d/dt of the sensitivity ∂x(t)/∂x(0), shape (n, n)."""
    n = len(state)
    speed = math.sqrt(state[3] ** 2 + state[4] ** 2 + state[5] ** 2) + LEAST_SPEED
    jacobian = np.zeros((n, n))
    for i in range(3):
        jacobian[i, 3 + i] = 1.0
        for j in range(3):
            jacobian[3 + i, 3 + j] = -state[6] * state[3 + i] * state[3 + j] / speed
        jacobian[3 + i, 3 + i] -= state[6] * speed
        jacobian[3 + i, 6] = -speed * state[3 + i]
    if n > 7:
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            # (ω × v)_i = ω_j v_k - ω_k v_j
            jacobian[3 + i, 3 + k] += state[7 + j]
            jacobian[3 + i, 3 + j] -= state[7 + k]
            jacobian[3 + i, 7 + j] += state[3 + k]
            jacobian[3 + i, 7 + k] -= state[3 + j]
    return jacobian @ sensitivity


@njit(cache=True)
def _acceleration(
    vx: float, vy: float, vz: float, k: float, wx: float, wy: float, wz: float
) -> tuple[float, float, float]:
    drag = k * math.sqrt(vx * vx + vy * vy + vz * vz)
    return (
        wy * vz - wz * vy - drag * vx,
        wz * vx - wx * vz - drag * vy,
        wx * vy - wy * vx - drag * vz - GRAVITY,
    )


@njit(cache=True)
def fly(state: Array, step: float, steps: int) -> Array:
    """Return the states `step`, 2 `step`, ... later, shape (steps, n), by one RK4 step each.

    In scalars, since the planner does this for every frame.
    """
    path = np.empty((steps, len(state)))
    path[:] = state
    x, y, z = state[0], state[1], state[2]
    vx, vy, vz, k = state[3], state[4], state[5], state[6]
    wx = wy = wz = 0.0
    if len(state) > 7:
        wx, wy, wz = state[7], state[8], state[9]
    h, half, sixth = step, 0.5 * step, step / 6.0
    for i in range(steps):
        ax, ay, az = _acceleration(vx, vy, vz, k, wx, wy, wz)
        bx, by, bz = _acceleration(vx + half * ax, vy + half * ay, vz + half * az, k, wx, wy, wz)
        cx, cy, cz = _acceleration(vx + half * bx, vy + half * by, vz + half * bz, k, wx, wy, wz)
        dx, dy, dz = _acceleration(vx + h * cx, vy + h * cy, vz + h * cz, k, wx, wy, wz)
        # The velocity's own stages, summed.
        x += h * (vx + sixth * (ax + bx + cx))
        y += h * (vy + sixth * (ay + by + cy))
        z += h * (vz + sixth * (az + bz + cz))
        vx += sixth * (ax + 2.0 * (bx + cx) + dx)
        vy += sixth * (ay + 2.0 * (by + cy) + dy)
        vz += sixth * (az + 2.0 * (bz + cz) + dz)
        path[i, 0], path[i, 1], path[i, 2] = x, y, z
        path[i, 3], path[i, 4], path[i, 5] = vx, vy, vz
    return path


@njit(cache=True)
def transition(
    state: Array, duration: float, density: float, longest_step: float = LONGEST_STEP
) -> tuple[Array, Array, Array]:
    """Carry a state over any duration [s], which may be negative, in steps of `longest_step` [s] at most.

    Returns:
        State, shape (n,); its sensitivity F to the old state, shape (n, n); Q, the covariance that a white acceleration
        of this density [m²/s³] has added, shape (n, n).
    """
    n = len(state)
    sensitivity, noise = np.eye(n), np.zeros((n, n))
    count = max(1, math.ceil(abs(duration) / longest_step))
    h = duration / count
    for _ in range(count):
        one = np.eye(n)
        k1, s1 = _derivative(state), _sensitivity_rate(state, one)
        at = state + 0.5 * h * k1
        k2, s2 = _derivative(at), _sensitivity_rate(at, one + 0.5 * h * s1)
        at = state + 0.5 * h * k2
        k3, s3 = _derivative(at), _sensitivity_rate(at, one + 0.5 * h * s2)
        at = state + h * k3
        k4, s4 = _derivative(at), _sensitivity_rate(at, one + h * s3)
        state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        one += h / 6.0 * (s1 + 2.0 * s2 + 2.0 * s3 + s4)
        sensitivity = one @ sensitivity
        noise = one @ noise @ one.T
        t = abs(h)
        for i in range(3):
            noise[i, i] += density * t * t * t / 3.0
            noise[3 + i, 3 + i] += density * t
            noise[i, 3 + i] += density * t * t / 2.0
            noise[3 + i, i] += density * t * t / 2.0
    return state, sensitivity, noise


@njit(cache=True)
def position_covariances(state: Array, covariance: Array, step: float, steps: int, density: float) -> Array:
    """Return the covariance of the position `step`, 2 `step`, ... later [m²], shape (steps, 3, 3).

    One transition every `COVARIANCE_STEP`, linear between. There the variance is less than 1 % too large, because drag
    does not brake the noise within a transition; between, too large by at most COVARIANCE_STEP²/8 times its second
    derivative, the distance of a chord from a convex curve.
    """
    result = np.empty((steps, 3, 3))
    stride = max(1, int(COVARIANCE_STEP / step))
    before = covariance[:3, :3].copy()
    done = 0
    while done < steps:
        state, F, Q = transition(state, stride * step, density, COVARIANCE_STEP)
        covariance = F @ covariance @ F.T + Q
        for i in range(min(stride, steps - done)):
            share = (i + 1) / stride
            for a in range(3):
                for b in range(3):
                    result[done + i, a, b] = before[a, b] + share * (covariance[a, b] - before[a, b])
        before = covariance[:3, :3].copy()
        done += stride
    return result


@njit(cache=True)
def normal_equations(state: Array, time: Array, position: Array) -> tuple[Array, Array, Array]:
    """Linearise measured positions about the flight that starts from `state` at time[0].

    Args:
        state: At time[0], shape (n,).
        time: [s], shape (N,).
        position: Measured [m], shape (N, 3).

    Returns:
        Information about the state of each measured axis at unit noise, shape (3, n, n); its gradient, shape (3, n);
        residuals [m], shape (N, 3).
    """
    n = len(state)
    information, gradient = np.zeros((3, n, n)), np.zeros((3, n))
    residuals = np.empty_like(position)
    sensitivity = np.eye(n)
    for i in range(len(time)):
        if i:
            state, one, _ = transition(state, time[i] - time[i - 1], 0.0)
            sensitivity = one @ sensitivity
        for axis in range(3):
            residuals[i, axis] = position[i, axis] - state[axis]
            for a in range(n):
                gradient[axis, a] += sensitivity[axis, a] * residuals[i, axis]
                for b in range(n):
                    information[axis, a, b] += sensitivity[axis, a] * sensitivity[axis, b]
    return information, gradient, residuals
