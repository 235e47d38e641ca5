"""Impacts: momentum, restitution, fast balls against thin plates, and what is told of contacts."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from imolo.conformance import Measurement
from imolo_backends.conformance.bodies import (
    BALL_MASS,
    BALL_RADIUS,
    BOX_SIDES,
    CONTACT_SINK,
    CONTACT_TIME,
    CONTACT_TIMESTEP,
    GRAVITY,
    PLATE_CENTER,
    WEIGHTLESS,
    ball_scene,
    box_scene,
    hanging_links,
    hanging_robot,
    moved,
    solid_ball,
)
from imolo_backends.conformance.subject import SceneCheck, Subject

HALF_PLATE = 0.0015  # [m]
ARM = "right_arm"
# The stiffest soft contact that a step resolves well turns by w dt = .2 rad per step; it bounces ½ (w dt)² off.
RESTITUTION_TOLERANCE = 0.02
RESTITUTION_BASIS = "½ (w dt)² of the stiffest soft contact that dt resolves, w dt = 0.2"


def collision_momentum(subject: Subject) -> Iterator[Measurement]:
    """A ball hits a free box off its centre, weightless and without friction."""
    speed, offset, restitution, mass = 4.0, 0.06, 0.5, 0.05
    start = np.array([0.0, 0.0, 1.0])  # [m] of the box
    ball = solid_ball(moved(start, 0.5 * BOX_SIDES[0] + BALL_RADIUS + 0.05, offset, 0.0), (-speed, 0.0, 0.0))
    scene = box_scene(
        mass=mass, base_position=moved(start, 0.0, 0.0, 0.0), ball=ball, gravity=WEIGHTLESS, timestep=CONTACT_TIMESTEP
    )
    glance = 0.02  # [s]
    with subject.run(replace(scene, friction=0.0, restitution=restitution)) as run:
        before, after = run.advance(0.04), run.advance(glance)
    velocity = (after.link_position[0] - before.link_position[0]) / glance
    spin = Rotation.from_matrix(after.link_rotation[0] @ before.link_rotation[0].T).as_rotvec()[2] / glance
    rebound = after.ball_velocity
    inertia = mass / 12.0 * (BOX_SIDES[0] ** 2 + BOX_SIDES[1] ** 2)

    momentum = float(ball.mass * rebound[0] + mass * velocity[0])
    expected = -ball.mass * speed
    yield Measurement("momentum", "kg m/s", expected, momentum, 1e-5 * abs(expected), "single precision")
    # About where the centre of the box was; nothing turns the ball.
    of_ball = ball.mass * np.cross(after.ball_position - start, rebound)[2]
    of_box = mass * np.cross(after.link_position[0] - start, velocity)[2] + inertia * spin
    expected = ball.mass * speed * offset
    yield Measurement(
        "angular momentum", "kg m²/s", expected, float(of_ball + of_box), 1e-5 * expected, "single precision"
    )
    # The impulse at that place per speed of meeting is the reduced mass.
    reduced = 1.0 / (1.0 / ball.mass + 1.0 / mass + offset**2 / inertia)
    yield Measurement(
        "speed of the ball afterwards", "m/s", (1.0 + restitution) * speed * reduced / ball.mass - speed,
        float(rebound[0]), RESTITUTION_TOLERANCE * speed * reduced / ball.mass, RESTITUTION_BASIS,
    )  # fmt: skip
    parting = float(rebound[0] - velocity[0] + spin * offset) / speed
    yield Measurement(
        "speed of parting over speed of meeting", "", restitution, parting, RESTITUTION_TOLERANCE, RESTITUTION_BASIS
    )


def bounce_heights(subject: Subject) -> Iterator[Measurement]:
    """A ball bounces off the floor from three heights: the share of its height is e²."""
    for restitution in (0.3, 0.8):
        for height in (0.25, 0.5, 1.0):
            fall = float(np.sqrt(2.0 * height / GRAVITY))
            scene = ball_scene(solid_ball((0.0, 0.0, BALL_RADIUS + height)), restitution=restitution)
            state = subject.final_state(replace(scene, timestep=CONTACT_TIMESTEP), fall + 0.01)
            energy = 0.5 * state.ball_velocity[2] ** 2 + GRAVITY * (state.ball_position[2] - BALL_RADIUS)
            yield Measurement(
                f"rebound over height from {height:g} m, e = {restitution:g}", "", restitution**2,
                float(energy / (GRAVITY * height)), 2.0 * restitution * RESTITUTION_TOLERANCE,
                f"2 e times {RESTITUTION_BASIS}",
            )  # fmt: skip
            touch = state.ball_contacts[0].time if state.ball_contacts else np.nan
            # Euler falls ½ dt early; the contact is told at the end of the step that finds it.
            early = 0.5 * CONTACT_TIMESTEP if subject.order == 1 else 0.0
            if restitution == 0.3:
                yield Measurement(
                    f"time of impact from {height:g} m", "s", fall - early, touch, 2.0 * CONTACT_TIMESTEP,
                    "a step to touch, a step to tell",
                )  # fmt: skip


def _restitution(subject: Subject, restitution: float, mass: float = BALL_MASS, speed: float = 4.0) -> float:
    """Throw a weightless ball at the floor; return the speed at which it parts over that at which it meets it."""
    ball = solid_ball((0.0, 0.0, BALL_RADIUS + 0.02), (0.0, 0.0, -speed), mass)
    scene = ball_scene(ball, gravity=WEIGHTLESS, restitution=restitution, timestep=CONTACT_TIMESTEP)
    return float(subject.final_state(scene, 0.04 / speed + 0.02).ball_velocity[2]) / speed


def bounce_masses(subject: Subject) -> Iterator[Measurement]:
    """A ball's mass does not change how it bounces."""
    for mass in (0.0027, 0.010, 0.100):
        quantity = f"e got by {1e3 * mass:g} g"
        got = _restitution(subject, 0.8, mass)
        yield Measurement(quantity, "", 0.8, got, RESTITUTION_TOLERANCE, RESTITUTION_BASIS)


def bounce_speeds(subject: Subject) -> Iterator[Measurement]:
    """The speed of meeting does not change how a ball bounces."""
    for speed in (1.0, 4.0, 16.0):
        got = _restitution(subject, 0.8, speed=speed)
        yield Measurement(f"e got at {speed:g} m/s", "", 0.8, got, RESTITUTION_TOLERANCE, RESTITUTION_BASIS)


def restitution_asked(subject: Subject) -> Iterator[Measurement]:
    """The coefficient of restitution asked for is the one got."""
    for restitution in (0.0, 0.3, 0.5, 0.8):
        quantity = f"e got for {restitution:g} asked"
        got = _restitution(subject, restitution)
        yield Measurement(quantity, "", restitution, got, RESTITUTION_TOLERANCE, RESTITUTION_BASIS)


def robot_does_not_bounce(subject: Subject) -> Iterator[Measurement]:
    """A box that is the robot neither bounces off the floor, however much the ball does, nor sinks into it."""
    speed, glance = 2.0, 0.01
    scene = box_scene(
        base_position=(0.0, 0.0, 0.5 * BOX_SIDES[2] + 0.02), base_velocity=(0.0, 0.0, -speed), gravity=WEIGHTLESS,
        restitution=0.8, timestep=CONTACT_TIMESTEP,
    )  # fmt: skip
    with subject.run(scene) as run:
        path = [float(state.link_position[0, 2]) for state in run.states(0.03, CONTACT_TIMESTEP)]
        high = float(run.advance(glance).link_position[0, 2])
    parting = (high - path[-1]) / glance / speed
    basis = "e⁻², what a critically damped contact gives back"
    yield Measurement("e got by the robot", "", 0.0, parting, float(np.exp(-2.0)), basis)
    depth = 0.5 * BOX_SIDES[2] - min(path)
    basis = "v T / e, how deep a critically damped contact of 20 steps lets it"
    yield Measurement("how deep the robot gets", "m", 0.0, depth, speed * CONTACT_TIME * float(np.exp(-1.0)), basis)


def _fast_ball(subject: Subject, speed: float) -> Iterator[Measurement]:
    hand, restitution = hanging_links()[ARM][0] + PLATE_CENTER, 0.3
    # The outer corners, where the ball does not meet the trunk.
    for where, offset in (("middle", (0.0, 0.0)), ("lower corner", (-0.03, -0.12)), ("upper corner", (-0.03, 0.12))):
        ball = solid_ball(moved(hand, 0.15, *offset), (-speed, 0.0, 0.0))
        with subject.run(hanging_robot(ball=ball, restitution=restitution)) as run:
            path = [state.ball_position[0] for state in run.states(0.3 / speed, CONTACT_TIMESTEP)]
            rebound = float(run.engine.read().ball_velocity[0]) / speed
        depth = BALL_RADIUS + HALF_PLATE - float(min(path) - hand[0])
        yield Measurement(
            f"how deep the ball gets at the {where}", "m", 0.0, depth, BALL_RADIUS,
            "the ball's centre stays before the plate",
        )  # fmt: skip
        yield Measurement(
            f"rebound at the {where}", "", 0.5 * restitution, rebound, 0.5 * restitution + RESTITUTION_TOLERANCE,
            "between 0, for the arm gives way, and e",
        )  # fmt: skip


def fast_ball_10(subject: Subject) -> Iterator[Measurement]:
    """A ball at 10 m/s does not pass through the plate of 3 mm."""
    yield from _fast_ball(subject, 10.0)


def fast_ball_25(subject: Subject) -> Iterator[Measurement]:
    """A ball at 25 m/s does not pass through the plate of 3 mm."""
    yield from _fast_ball(subject, 25.0)


def resting_body(subject: Subject) -> Iterator[Measurement]:
    """A box and a ball that lie on the floor for a second neither sink nor drift."""
    half = 0.5 * BOX_SIDES[2]
    scene = box_scene(
        base_position=(0.0, 0.0, half), ball=solid_ball((1.0, 0.0, BALL_RADIUS)), timestep=CONTACT_TIMESTEP
    )
    state = subject.final_state(scene, 1.0)
    basis = "g t² of a soft contact of 20 steps"
    for name, (x, y, z), start, height in (
        ("box", state.link_position[0], 0.0, half),
        ("ball", state.ball_position, 1.0, BALL_RADIUS),
    ):
        yield Measurement(f"sink of the {name}", "m", 0.0, float(height - z), CONTACT_SINK, basis)
        yield Measurement(f"drift of the {name}", "m", 0.0, float(np.hypot(x - start, y)), CONTACT_SINK, basis)


SCENES: tuple[SceneCheck, ...] = (
    collision_momentum,
    bounce_heights,
    bounce_masses,
    bounce_speeds,
    restitution_asked,
    robot_does_not_bounce,
    fast_ball_10,
    fast_ball_25,
    resting_body,
)
