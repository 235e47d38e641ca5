"""Compiled flight of a ball under gravity, quadratic drag and Magnus lift, with its sensitivity to the state.

The state is (p, v, k) or (p, v, k, ω), see `imolo.ball.aerodynamic`; gravity [m/s²], shape (3,), is the model's. Where
`bias_variance` [m²], shape (3,), is not 0, the error b of the cameras follows, and p is where they see the ball.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST_STEP = 0.01  # [s] of RK4; a 25 m/s foam ball is then right to 1e-6 m after 1 s
COVARIANCE_STEP = 0.05  # [s] of the uncertainty along a path, which need not be as exact as the path
LEAST_SPEED = 1e-9  # [m/s] keeps the direction of a ball at rest finite


@njit(cache=True, inline="always")
def _acceleration(
    vx: float, vy: float, vz: float, k: float, wx: float, wy: float, wz: float, gravity: Array
) -> tuple[float, float, float]:
    drag = k * math.sqrt(vx * vx + vy * vy + vz * vz)
    return (
        wy * vz - wz * vy - drag * vx + gravity[0],
        wz * vx - wx * vz - drag * vy + gravity[1],
        wx * vy - wy * vx - drag * vz + gravity[2],
    )


@njit(cache=True)
def _sensitivity_rate(velocity: Array, constants: Array, sensitivity: Array, rate: Array) -> None:
    """Write d/dt of the sensitivity ∂(p, v)/∂x(0), shape (6, n), to `rate`.

    Args:
        velocity: v, shape (3,).
        constants: k and perhaps ω, shape (n - 6,).
        sensitivity: Shape (6, n); that of the constants is 1, and so is not carried along.
        rate: Shape (6, n).
    """
    vx, vy, vz, k = velocity[0], velocity[1], velocity[2], constants[0]
    wx = wy = wz = 0.0
    if len(constants) > 1:
        wx, wy, wz = constants[1], constants[2], constants[3]
    speed = math.sqrt(vx * vx + vy * vy + vz * vz) + LEAST_SPEED
    drag, along = k * speed, k / speed
    for column in range(sensitivity.shape[1]):
        sx, sy, sz = sensitivity[3, column], sensitivity[4, column], sensitivity[5, column]
        braked = along * (vx * sx + vy * sy + vz * sz)
        rate[0, column], rate[1, column], rate[2, column] = sx, sy, sz
        rate[3, column] = wy * sz - wz * sy - drag * sx - braked * vx
        rate[4, column] = wz * sx - wx * sz - drag * sy - braked * vy
        rate[5, column] = wx * sy - wy * sx - drag * sz - braked * vz
    rate[3, 6] -= speed * vx
    rate[4, 6] -= speed * vy
    rate[5, 6] -= speed * vz
    if len(constants) > 1:  # (ω × v)_x = ω_y v_z - ω_z v_y, and so on
        rate[3, 8] += vz
        rate[3, 9] -= vy
        rate[4, 7] -= vz
        rate[4, 9] += vx
        rate[5, 7] += vy
        rate[5, 8] -= vx


@njit(cache=True)
def fly(state: Array, step: float, steps: int, gravity: Array) -> Array:
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
        ax, ay, az = _acceleration(vx, vy, vz, k, wx, wy, wz, gravity)
        bx, by, bz = _acceleration(vx + half * ax, vy + half * ay, vz + half * az, k, wx, wy, wz, gravity)
        cx, cy, cz = _acceleration(vx + half * bx, vy + half * by, vz + half * bz, k, wx, wy, wz, gravity)
        dx, dy, dz = _acceleration(vx + h * cx, vy + h * cy, vz + h * cz, k, wx, wy, wz, gravity)
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
    state: Array, duration: float, density: float, gravity: Array, longest_step: float
) -> tuple[Array, Array, Array]:
    """Carry a state over any duration [s], which may be negative, in steps of `longest_step` [s] at most.

    Returns:
        State, shape (n,); its sensitivity F to the old state, shape (n, n); Q, the covariance that a white acceleration
        of this density [m²/s³] has added, shape (n, n).
    """
    n = len(state)
    state, total, noise = state.copy(), np.eye(n), np.zeros((n, n))
    constants = state[6:]
    k, wx, wy, wz = constants[0], 0.0, 0.0, 0.0
    if n > 7:
        wx, wy, wz = constants[1], constants[2], constants[3]
    one, at = np.eye(n), np.empty((6, n))
    rates = np.empty((4, 6, n))
    velocity, acceleration = np.empty((4, 3)), np.empty((4, 3))
    count = max(1, math.ceil(abs(duration) / longest_step))
    h = duration / count
    for step in range(count):
        at[:] = one[:6] = np.eye(6, n)
        for stage in range(4):
            ahead = h if stage == 3 else 0.5 * h
            if stage:
                for axis in range(3):
                    velocity[stage, axis] = state[3 + axis] + ahead * acceleration[stage - 1, axis]
                for row in range(6):
                    for column in range(n):
                        at[row, column] = one[row, column] + ahead * rates[stage - 1, row, column]
            else:
                velocity[0] = state[3:6]
            vx, vy, vz = velocity[stage]
            ax, ay, az = _acceleration(vx, vy, vz, k, wx, wy, wz, gravity)
            acceleration[stage, 0], acceleration[stage, 1], acceleration[stage, 2] = ax, ay, az
            _sensitivity_rate(velocity[stage], constants, at, rates[stage])
        for axis in range(3):
            v, a = velocity[:, axis], acceleration[:, axis]
            state[axis] += h / 6.0 * (v[0] + 2.0 * v[1] + 2.0 * v[2] + v[3])
            state[3 + axis] += h / 6.0 * (a[0] + 2.0 * a[1] + 2.0 * a[2] + a[3])
        for row in range(6):
            for column in range(n):
                r = rates[:, row, column]
                one[row, column] += h / 6.0 * (r[0] + 2.0 * r[1] + 2.0 * r[2] + r[3])
        if step:
            total = one @ total
            noise = one @ noise @ one.T
        else:
            total[:] = one
        t = abs(h)
        for i in range(3):
            noise[i, i] += density * t * t * t / 3.0
            noise[3 + i, 3 + i] += density * t
            noise[i, 3 + i] += density * t * h / 2.0
            noise[3 + i, i] += density * t * h / 2.0
    return state, total, noise


@njit(cache=True)
def seen_transition(
    state: Array,
    duration: float,
    density: float,
    gravity: Array,
    bias_variance: Array,
    bias_time: float,
    longest_step: float,
) -> tuple[Array, Array, Array]:
    """Carry a state as the cameras see it over any duration [s]; b fades as exp(-t / bias_time) and is driven anew.

    Returns:
        State, F and Q as of `transition`, with b where there is one.
    """
    if not bias_variance.any():
        later, sensitivity, noise = transition(state, duration, density, gravity, longest_step)
        return later, sensitivity, noise
    size = len(state)
    n = size - 3
    fade = math.exp(-abs(duration) / bias_time)
    later, sensitivity, noise = state.copy(), np.eye(size), np.zeros((size, size))
    later[:n], sensitivity[:n, :n], noise[:n, :n] = transition(state[:n], duration, density, gravity, longest_step)
    for axis in range(3):
        b, driven = n + axis, bias_variance[axis] * (1.0 - fade * fade)
        later[axis] += (fade - 1.0) * state[b]
        later[b] = fade * state[b]
        sensitivity[axis, b], sensitivity[b, b] = fade - 1.0, fade
        noise[axis, axis] += driven
        noise[axis, b] = noise[b, axis] = noise[b, b] = driven
    return later, sensitivity, noise


@njit(cache=True)
def noise_at(position: Array, center: Array, slope: Array, reach: float) -> float:
    """Return the variance of the cameras' errors at a position [m], shape (3,), over that at `center`.

    Its logarithm changes by `slope` [1/m], shape (3,), but never by more than `reach`.
    """
    change = 0.0
    for axis in range(3):
        change += slope[axis] * (position[axis] - center[axis])
    return math.exp(min(max(change, -reach), reach))


@njit(cache=True)
def filter_step(
    state: Array,
    duration: float,
    density: float,
    gravity: Array,
    measurement_std: Array,
    bias_std: Array,
    bias_time: float,
    center: Array,
    slope: Array,
    reach: float,
) -> tuple[Array, Array, Array, Array]:
    """Return what a Kalman filter needs to carry a state over `duration` [s], in one call.

    Returns:
        F and Q as of `seen_transition`; what is added to F x, shape (n, 1); R, the covariance of a position measured
        then [m²], shape (3, 3).
    """
    bias_variance = bias_std * bias_std * noise_at(state, center, slope, reach)
    later, F, Q = seen_transition(state, duration, density, gravity, bias_variance, bias_time, LONGEST_STEP)
    offset = later - F @ state
    R = np.diag(measurement_std * measurement_std * noise_at(later, center, slope, reach))
    return F, Q, offset.reshape((len(state), 1)), R


@njit(cache=True)
def position_covariances(
    state: Array,
    covariance: Array,
    step: float,
    steps: int,
    density: float,
    gravity: Array,
    bias_variance: Array,
    bias_time: float,
) -> Array:
    """Return the covariance of the position `step`, 2 `step`, ... later [m²], shape (steps, 3, 3).

    One transition every `COVARIANCE_STEP`, linear between. There the variance is less than 1 % too large, because drag
    does not brake the noise within a transition; between, too large by at most COVARIANCE_STEP²/8 times its second
    derivative, the distance of a chord from a convex curve. The part of b, at most twice `bias_variance`, is concave
    and may be too small between.
    """
    result = np.empty((steps, 3, 3))
    stride = max(1, int(COVARIANCE_STEP / step))
    before = covariance[:3, :3].copy()
    done = 0
    while done < steps:
        state, F, Q = seen_transition(state, stride * step, density, gravity, bias_variance, bias_time, COVARIANCE_STEP)
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
def normal_equations(state: Array, time: Array, position: Array, gravity: Array) -> tuple[Array, Array, Array]:
    """Linearise measured positions about the flight that starts from `state` at time[0].

    Args:
        state: At time[0], shape (n,).
        time: [s], shape (N,).
        position: Measured [m], shape (N, 3).
        gravity: [m/s²], shape (3,).

    Returns:
        Information about state and gravity of each measured axis at unit noise, shape (3, n + 3, n + 3); its gradient,
        shape (3, n + 3); residuals [m], shape (N, 3).
    """
    n = len(state)
    information, gradient = np.zeros((3, n + 3, n + 3)), np.zeros((3, n + 3))
    residuals = np.empty_like(position)
    sensitivity = np.eye(n, n + 3)
    for i in range(len(time)):
        if i:
            half = 0.5 * (time[i] - time[i - 1])
            state, one, _ = transition(state, 2.0 * half, 0.0, gravity, LONGEST_STEP)
            # Gravity pulls half before a step and half after it, which is right to the square of the step.
            for axis in range(3):
                sensitivity[3 + axis, n + axis] += half
            sensitivity = one @ sensitivity
            for axis in range(3):
                sensitivity[3 + axis, n + axis] += half
        for axis in range(len(gradient)):
            residuals[i, axis] = position[i, axis] - state[axis]
            for a in range(n + 3):
                gradient[axis, a] += sensitivity[axis, a] * residuals[i, axis]
                for b in range(n + 3):
                    information[axis, a, b] += sensitivity[axis, a] * sensitivity[axis, b]
    return information, gradient, residuals
