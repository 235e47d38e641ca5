"""Free flight: gravity, momentum and energy of bodies that touch nothing."""

from collections.abc import Iterator

import numpy as np

from imolo.conformance import Measurement
from imolo_backends.conformance.bodies import BOX_INERTIA, GRAVITY, WEIGHTLESS, ball_scene, box_scene
from imolo_backends.conformance.reference import base_twist, rotation_of, rotation_vector, tumbling_rotation
from imolo_backends.conformance.subject import ROUNDING, Errors, Run, SceneCheck, Subject, at_timestep, observed_order
from imolo_robots.liberobot.body import foam_ball


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


def projectile(subject: Subject) -> Iterator[Measurement]:
    """A box is thrown without spin, the ball beside it too."""
    duration, timestep = 0.5, 5e-4
    velocity, beside = (3.0, -2.0, 4.0), (0.0, 5.0, 1.0)
    ball = foam_ball(beside, velocity)
    scene = box_scene(collides=False, base_position=(0.0, 0.0, 1.0), base_velocity=velocity, ball=ball)
    state = subject.final_state(at_timestep(scene, timestep), duration)
    bias = 0.5 * GRAVITY * duration * timestep if subject.order == 1 else 0.0
    way = np.array(velocity) * duration - [0.0, 0.0, 0.5 * GRAVITY * duration**2 + bias]
    for body, start, end, rounding in (
        ("box", scene.base_position, state.link_position[0], ROUNDING),
        ("ball", beside, state.ball_position, 1e-9),
    ):
        for axis, expected, measured in zip("xyz", way, end - start, strict=True):
            basis = "parabola less ½ g dt t (order 1), rounding" if axis == "z" else "v t, rounding"
            yield Measurement(f"{axis} of the {body}", "m", float(expected), float(measured), rounding, basis)
    turned = float(np.abs(state.link_rotation[0] - np.eye(3)).max())
    yield Measurement("rotation of the box", "", 0.0, turned, 1e-9, "gravity turns nothing, rounding")


def tumbling_box(subject: Subject) -> Iterator[Measurement]:
    """A weightless box tumbles about its middle axis for 10 s."""
    duration = 10.0
    inertia, spin, velocity = np.array(BOX_INERTIA), np.array([0.3, 2.0, 0.4]), np.array([0.02, -0.03, 0.01])
    scene = box_scene(
        collides=False,
        gravity=WEIGHTLESS,
        base_position=(0.0, 0.0, 1.0),
        base_velocity=tuple(velocity.tolist()),
        base_angular_velocity=tuple(spin.tolist()),
    )
    rotation = tumbling_rotation(inertia, spin, duration)
    momentum = inertia * spin
    energy = 0.5 * spin @ momentum

    def errors(run: Run) -> Errors:
        window = run.window(duration)
        moved = window[2].link_position[0] - scene.base_position - velocity * duration
        turned = rotation_of(window[2])
        _, omega = base_twist(window)
        omega_in_body = turned.T @ omega
        return {
            "position [m]": (moved, float(np.linalg.norm(velocity)) * duration),
            "orientation [rad]": (rotation_vector(rotation.T @ turned), 1.0),
            "angular momentum [kg m²/s]": (
                turned @ (inertia * omega_in_body) - momentum,
                float(np.linalg.norm(momentum)),
            ),
            "kinetic energy [J]": (
                np.array([0.5 * omega_in_body @ (inertia * omega_in_body) - energy]),
                float(energy),
            ),
        }

    yield from subject.converge(scene, float(np.linalg.norm(spin)), duration, errors)


SCENES: tuple[SceneCheck, ...] = (free_fall, projectile, tumbling_box)
