"""The loop over the steps: actuators, air around the ball, engine."""

from collections.abc import Callable
from typing import Any

from numba import njit, typeof

from imolo.contracts.actuators import Actuators
from imolo.contracts.engine import Array, Engine
from imolo_backends.compiled import CFunction, CompiledStep, call, twin
from imolo_backends.simulation.ball_air import BallAir, set_force

Stepping = Callable[[int, bool], None]


def stepping(engine: Engine, actuators: Actuators, air: BallAir) -> Stepping:
    """Return what takes a number of steps, and whether the ball flies or `air.force` stays as it is.

    What an engine and actuators offer as compiled code runs in one call, up to the next touch of the ball.
    """
    angle, velocity, ball_velocity = engine.motion()
    law, step = twin(actuators, "step", angle, velocity), twin(engine, "step")
    if law is not None and step is not None:
        return _compiled(law, actuators.joint_torque, air, ball_velocity, step)

    actuate, drag, engine_step, motion = actuators.step, air.step, engine.step, engine.motion
    torque, force = actuators.joint_torque, air.force

    def run(steps: int, flies: bool) -> None:
        angle, velocity, ball_velocity = motion()
        for _ in range(steps):
            actuate(angle, velocity)
            if flies:
                drag(ball_velocity)
            engine_step(torque, force)
            angle, velocity, ball_velocity = motion()

    return run


def _compiled(law: CFunction, torque: Array, air: BallAir, ball_velocity: Array, step: CompiledStep) -> Stepping:
    acting = (*law, torque, step.joint_torque, air.force, step.ball_force, air.drag, air.lift, ball_velocity)
    stepping = (*acting, *step.function, step.ball_reaction)
    # As of now: to find the types of so many arguments out again would cost more than a step's actuators.
    take_steps = _take_steps.compile(tuple(map(typeof, (1, True, *stepping))))

    def run(steps: int, flies: bool) -> None:
        while steps:
            done, touched = take_steps(steps, flies, *stepping)
            step.taken(done, touched)
            steps -= done

    return run


@njit(cache=True, nogil=True)
def _take_steps(
    steps: int,
    flies: bool,
    law: int,
    law_arguments: tuple[Any, ...],
    joint_torque: Array,
    engine_torque: Array,
    ball_force: Array,
    engine_ball_force: Array,
    drag: float,
    lift: Array,
    ball_velocity: Array,
    step: int,
    step_arguments: tuple[Any, ...],
    ball_reaction: Array,
) -> tuple[int, bool]:
    """Take steps until the ball touches something; return how many there were, and whether it touches."""
    for done in range(1, steps + 1):
        call(law, law_arguments)
        if flies:
            set_force(ball_force, drag, lift, ball_velocity)
        engine_torque[:] = joint_torque
        engine_ball_force[:] = ball_force
        call(step, step_arguments)
        if ball_reaction[0] != 0.0 or ball_reaction[1] != 0.0 or ball_reaction[2] != 0.0:
            return done, True
    return steps, False
