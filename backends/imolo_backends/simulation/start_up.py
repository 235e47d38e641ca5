"""A short run that an engine must pass before its first trial, for what cannot be read back from it."""

from functools import cache

import numpy as np

from imolo.config.model import Model
from imolo.contracts.engine import Engine
from imolo.errors import BackendError
from imolo_robots.liberobot.body import JOINT_LIMITS, JOINT_NAMES, READY_JOINT_ANGLE, foam_ball, ready_scene

DURATION = 0.02  # [s] long enough for a joint without a stop to run away by several degrees
PUSH = 20.0  # [N·m] against the stops of the ready pose, less than the cylinders can do
GIVE = np.radians(1.0)  # [rad] a soft stop may yield under it; MuJoCo's yields by 0.16°
HEIGHT = 50.0  # [m] of the ball, far above everything


@cache
def check_start_up(engine_class: type[Engine], options: Model, timestep: float) -> None:
    """Check, once per process, that a ball falls freely and that joints stop at their limits.

    Args:
        engine_class: The engine.
        options: Its options.
        timestep: [s].

    Raises:
        BackendError: The ball is damped or accelerated, or a joint leaves its range.
    """
    scene = ready_scene(ball=foam_ball((0.0, 0.0, HEIGHT)), timestep=timestep)
    engine = engine_class(scene, options)
    outwards = np.where(np.array(READY_JOINT_ANGLE) > JOINT_LIMITS.mean(axis=1), PUSH, -PUSH)
    steps = round(DURATION / timestep)
    try:
        for _ in range(steps):
            engine.step(outwards, np.zeros(3))
        angle, _, ball_velocity = (part.copy() for part in engine.motion())
    finally:
        engine.close()
    expected = np.array(scene.gravity) * steps * timestep
    # Every integrator gets a constant acceleration exactly right in the velocity, but for rounding in each step.
    name = engine_class.__name__
    if not np.allclose(ball_velocity, expected, rtol=0.0, atol=1e-9 * steps):
        raise BackendError(
            f"{name}: after {steps} steps of free fall the ball has {ball_velocity.tolist()} m/s instead of "
            f"{expected.tolist()}; something damps or drives it"
        )
    beyond = np.maximum(JOINT_LIMITS[:, 0] - angle, angle - JOINT_LIMITS[:, 1])
    if not beyond.max() < GIVE:
        joint = int(np.argmax(beyond))
        raise BackendError(
            f"{name}: {JOINT_NAMES[joint]} goes {np.degrees(beyond[joint]):.1f}° beyond its range under {PUSH:g} N·m; "
            "joint limits are not enforced"
        )
