"""Free flight: gravity, momentum and energy of bodies that touch nothing."""

from collections.abc import Iterator

import numpy as np

from imolo.conformance import Measurement
from imolo_backends.conformance.bodies import BOX_INERTIA, GRAVITY, WEIGHTLESS, ball_scene, box_scene, solid_ball
from imolo_backends.conformance.reference import base_twist, rotation_of, rotation_vector, tumbling_rotation
from imolo_backends.conformance.subject import ROUNDING, Errors, Run, SceneCheck, Subject, at_timestep, observed_order


def free_fall(subject: Subject) -> Iterator[Measurement]:
    """A ball falls from rest."""
    duration, coarse, fine = 0.5, 1e-3, 5e-4
    start = 20.0
    scene = ball_scene(solid_ball((0.0, 0.0, start)))
    heights = {}
    for timestep in (coarse, fine):
        state = subject.final_state(at_timestep(scene, timestep), duration)
        heights[timestep] = float(state.ball_position[2])
    # Semi-implicit Euler falls g dt² n (n + 1) / 2: the parabola and half g dt t more.
    bias = 0.5 * GRAVITY * duration * fine if subject.order == 1 else 0.0
    exact = start - 0.5 * GRAVITY * duration**2
    fall, steps = GRAVITY * duration, round(duration / fine)
    rounding = subject.rounding(start, steps)
    basis = "parabola less ½ g dt t (order 1), rounding"
    yield Measurement("height", "m", exact - bias, heights[fine], rounding, basis)
    basis = "-g t in every order, rounding"
    yield Measurement("velocity", "m/s", -fall, float(state.ball_velocity[2]), subject.rounding(fall, steps), basis)
    if subject.order == 1 and bias > 10.0 * rounding:
        order = observed_order(heights[coarse] - exact, heights[fine] - exact)
        yield Measurement("order of convergence", "", 1.0, order, 1e-3, "the error is exactly linear in dt")


def projectile(subject: Subject) -> Iterator[Measurement]:
    """A box is thrown without spin, the ball beside it too."""
    duration, timestep = 0.5, 5e-4
    velocity, beside = (3.0, -2.0, 4.0), (0.0, 5.0, 1.0)
    ball = solid_ball(beside, velocity)
    scene = box_scene(collides=False, base_position=(0.0, 0.0, 1.0), base_velocity=velocity, ball=ball)
    state = subject.final_state(at_timestep(scene, timestep), duration)
    bias = 0.5 * GRAVITY * duration * timestep if subject.order == 1 else 0.0
    way = np.array(velocity) * duration - [0.0, 0.0, 0.5 * GRAVITY * duration**2 + bias]
    for body, start, end, least in (
        ("box", scene.base_position, state.link_position[0], ROUNDING),
        ("ball", beside, state.ball_position, 1e-9),
    ):
        far = max(float(np.linalg.norm(place)) for place in (start, end))
        rounding = subject.rounding(far, round(duration / timestep), least)
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


def braked_fall(subject: Subject) -> Iterator[Measurement]:
    """A ball falls from rest while a force that grows with the square of its speed brakes it."""
    speed, duration, start = 6.0, 1.0, 20.0  # [m/s] in the end, [s], [m]
    length = speed**2 / GRAVITY
    ways = []
    for timestep in (1e-3, 5e-4):
        scene = ball_scene(solid_ball((0.0, 0.0, start)), timestep=timestep)
        with subject.run(scene) as run:
            for _ in range(round(duration / timestep)):
                velocity = run.engine.motion()[2]
                force = -run.weight[2] * float(np.linalg.norm(velocity)) * velocity / speed**2
                run.engine.step(run.no_torque, force)
            state = run.engine.read()
        ways.append(start - float(state.ball_position[2]))
    # In units of `speed` and `length`, with s the time and eps the step: du/ds = 1 - u² is tanh s. The force is held
    # for a step, so that every engine does Euler steps in u, which add eps ln(cosh s) / cosh² s. The way adds their
    # integral, and half a step's worth of speed where the position follows with the new velocity (order 1).
    ahead = 0.5 if subject.order == 1 else 0.0
    s, eps = duration * GRAVITY / speed, timestep * GRAVITY / speed
    ln_cosh = float(np.log(np.cosh(s)))
    basis = "tanh with its bias of order dt; what remains is of order dt²"
    truth = speed * float(np.tanh(s) + eps * ln_cosh / np.cosh(s) ** 2)
    steps = round(duration / timestep)
    tolerance = subject.rounding(speed, steps, speed * eps**2)
    yield Measurement("speed", "m/s", truth, -float(state.ball_velocity[2]), tolerance, basis)
    exact = length * ln_cosh
    bias = length * eps * float(np.tanh(s) * (1.0 + ahead + ln_cosh) - s)
    tolerance = subject.rounding(start, steps, length * eps**2)
    yield Measurement("way", "m", exact + bias, ways[1], tolerance, basis)
    if abs(bias) > 10.0 * tolerance:
        order = observed_order(ways[0] - exact, ways[1] - exact)
        basis = "a force held for a step; second order is eps of it"
        yield Measurement("order of convergence", "", 1.0, order, 4.0 * eps, basis)


SCENES: tuple[SceneCheck, ...] = (free_fall, projectile, braked_fall, tumbling_box)
