"""A short run that an engine must pass before its first trial of a robot, for what cannot be read back from it."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from imolo.config.model import Model
from imolo.contracts.engine import Ball, Engine
from imolo.contracts.robot import Body
from imolo.errors import BackendError
from imolo_backends.conformance.reference import Mechanism
from imolo_backends.engines.engine_checks import base_rotation

DURATION = 0.02  # [s]
PUSH = 500.0  # [rad/s²] against the stops: a joint without one would go 6° in that time
GIVE = np.radians(1.0)  # [rad] a soft stop may yield; MuJoCo's yields by 0.1°
HEIGHT = 50.0  # [m] of robot and ball, far above everything
ASIDE = (20.0, 0.0, HEIGHT)  # [m] where the ball is
SOLID = (0.045, 0.010, 8.1e-6)  # radius [m], mass [kg] and moment of inertia [kg m²] of any ball


@lru_cache(maxsize=64)
def check_start_up(engine_class: type[Engine], options: Model, timestep: float, robot: Body) -> None:
    """Check, once per process, that a ball falls freely and that joints stop at their limits.

    Args:
        engine_class: The engine.
        options: Its options.
        timestep: [s].
        robot: Whose joints start at the limit that is nearest to the ready pose, and are pushed against it.

    Raises:
        BackendError: The ball is damped or accelerated, or a joint leaves its range.
    """
    name = engine_class.__name__
    low, high = robot.joint_limits.T
    ready = np.array(robot.ready)
    nearest = np.where(high - ready < ready - low, high, low)
    angle = np.where(np.isfinite(nearest), nearest, ready)
    ball = Ball(*SOLID, position=ASIDE)
    scene = robot.scene(ball, timestep, friction=0.8, restitution=0.0)
    scene = replace(
        scene,
        joint_angle=tuple(angle.tolist()),
        base_position=(0.0, 0.0, HEIGHT),
        base_quaternion=(1.0, 0.0, 0.0, 0.0),
        boxes=(),
    )
    outwards = np.where(np.isfinite(nearest), np.where(nearest == high, PUSH, -PUSH), 0.0)
    push = Mechanism(scene).mass_matrix(angle, base_rotation(scene))[6:, 6:] @ outwards
    engine = engine_class(scene, options)
    steps = round(DURATION / timestep)
    try:
        for _ in range(steps):
            engine.step(push, np.zeros(3))
        reached, _, ball_velocity = (part.copy() for part in engine.motion())
    finally:
        engine.close()
    expected = np.array(scene.gravity) * steps * timestep
    # Every integrator gets a constant acceleration exactly right in the velocity, but for rounding in each step.
    if not np.allclose(ball_velocity, expected, rtol=0.0, atol=1e-9 * steps):
        raise BackendError(
            f"{name}: after {steps} steps of free fall the ball has {ball_velocity.tolist()} m/s instead of "
            f"{expected.tolist()}; something damps or drives it"
        )
    beyond = np.maximum(low - reached, reached - high)
    if not beyond.max(initial=-1.0) < GIVE:
        joint = int(np.argmax(beyond))
        raise BackendError(
            f"{name}: {robot.joint_names[joint]} goes {np.degrees(beyond[joint]):.1f}° beyond its range under "
            f"{push[joint]:.3g} N·m; joint limits are not enforced"
        )
