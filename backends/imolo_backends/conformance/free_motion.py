"""Free flight: gravity, momentum and energy of bodies that touch nothing."""

from collections.abc import Iterator

from imolo.conformance import Measurement
from imolo_backends.conformance.bodies import GRAVITY, ball_scene
from imolo_backends.conformance.subject import SceneCheck, Subject, at_timestep, observed_order
from imolo_backends.liberobot import foam_ball


def free_fall(subject: Subject) -> Iterator[Measurement]:
    """A ball falls from rest."""
    duration, coarse, fine = 0.5, 1e-3, 5e-4
    start = 20.0
    scene = ball_scene(foam_ball((0.0, 0.0, start)))
    heights = {}
    for timestep in (coarse, fine):
        state = subject.final_state(at_timestep(scene, timestep), duration)
        heights[timestep] = float(state.ball_position[2])
    # Semi-implicit Euler falls g dt² n (n + 1) / 2: the parabola and half g dt t more.
    bias = 0.5 * GRAVITY * duration * fine if subject.order == 1 else 0.0
    exact = start - 0.5 * GRAVITY * duration**2
    yield Measurement("height", "m", exact - bias, heights[fine], 1e-9, "parabola less ½ g dt t (order 1), rounding")
    yield Measurement(
        "velocity", "m/s", -GRAVITY * duration, float(state.ball_velocity[2]), 1e-9, "-g t in every order, rounding"
    )
    if subject.order == 1:
        order = observed_order(heights[coarse] - exact, heights[fine] - exact)
        yield Measurement("order of convergence", "", 1.0, order, 1e-3, "the error is exactly linear in dt")


SCENES: tuple[SceneCheck, ...] = (free_fall,)
