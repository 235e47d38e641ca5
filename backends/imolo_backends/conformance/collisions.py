"""Impacts: momentum, restitution, fast balls against thin plates, and what is told of contacts."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from imolo.conformance import Measurement
from imolo.contracts.engine import Array, Ball, Scene
from imolo_backends.conformance.bodies import (
    BOX_SIDES,
    CONTACT_SINK,
    CONTACT_TIMESTEP,
    GRAVITY,
    WEIGHTLESS,
    ball_scene,
    box_scene,
    flying_robot,
)
from imolo_backends.conformance.subject import SceneCheck, Subject
from imolo_robots.liberobot.body import HAND_OFFSET, LINK_NAMES, foam_ball, standing_box

RADIUS = foam_ball().radius  # [m]
HALF_PLATE = 0.0015  # [m]
ARM = "right_arm"
# The stiffest soft contact that a step resolves well turns by w dt = .2 rad per step; it bounces ½ (w dt)² off.
RESTITUTION_TOLERANCE = 0.02
RESTITUTION_BASIS = "½ (w dt)² of the stiffest soft contact that dt resolves, w dt = 0.2"


def collision_momentum(subject: Subject) -> Iterator[Measurement]:
    """A ball hits a free box off its centre, weightless and without friction."""
    speed, offset, restitution, mass = 4.0, 0.06, 0.5, 0.05
    start = np.array([0.0, 0.0, 1.0])  # [m] of the box
    ball = foam_ball(_moved(start, 0.5 * BOX_SIDES[0] + RADIUS + 0.05, offset, 0.0), (-speed, 0.0, 0.0))
    scene = box_scene(
        mass=mass, base_position=_moved(start, 0.0, 0.0, 0.0), ball=ball, gravity=WEIGHTLESS, timestep=CONTACT_TIMESTEP
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
            scene = ball_scene(foam_ball((0.0, 0.0, RADIUS + height)), restitution=restitution)
            state = subject.final_state(replace(scene, timestep=CONTACT_TIMESTEP), fall + 0.01)
            energy = 0.5 * state.ball_velocity[2] ** 2 + GRAVITY * (state.ball_position[2] - RADIUS)
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


def _restitution(subject: Subject, restitution: float, mass: float = foam_ball().mass) -> float:
    """Throw a weightless ball at the floor; return the speed at which it parts over that at which it meets it."""
    speed = 4.0
    ball = Ball(RADIUS, mass, 0.4 * mass * RADIUS**2, (0.0, 0.0, RADIUS + 0.04), (0.0, 0.0, -speed))
    scene = ball_scene(ball, gravity=WEIGHTLESS, restitution=restitution, timestep=CONTACT_TIMESTEP)
    return float(subject.final_state(scene, 0.04).ball_velocity[2]) / speed


def bounce_masses(subject: Subject) -> Iterator[Measurement]:
    """A ball's mass does not change how it bounces."""
    for mass in (0.0027, 0.010, 0.100):
        quantity = f"e got by {1e3 * mass:g} g"
        got = _restitution(subject, 0.8, mass)
        yield Measurement(quantity, "", 0.8, got, RESTITUTION_TOLERANCE, RESTITUTION_BASIS)


def restitution_asked(subject: Subject) -> Iterator[Measurement]:
    """The coefficient of restitution asked for is the one got."""
    for restitution in (0.0, 0.3, 0.5, 0.8):
        quantity = f"e got for {restitution:g} asked"
        got = _restitution(subject, restitution)
        yield Measurement(quantity, "", restitution, got, RESTITUTION_TOLERANCE, RESTITUTION_BASIS)


def robot_does_not_bounce(subject: Subject) -> Iterator[Measurement]:
    """A box that is the robot does not bounce off the floor, however much the ball does."""
    speed, glance = 2.0, 0.01
    scene = box_scene(
        base_position=(0.0, 0.0, 0.5 * BOX_SIDES[2] + 0.02), base_velocity=(0.0, 0.0, -speed), gravity=WEIGHTLESS,
        restitution=0.8, timestep=CONTACT_TIMESTEP,
    )  # fmt: skip
    with subject.run(scene) as run:
        low, high = (run.advance(duration).link_position[0, 2] for duration in (0.03, glance))
    parting = float(high - low) / glance / speed
    basis = "e⁻², what a critically damped contact gives back"
    yield Measurement("e got by the robot", "", 0.0, parting, float(np.exp(-2.0)), basis)


def _hanging_arm(**changes: Any) -> Scene:
    """Return the robot fixed and upright, weightless, its arms hanging at their stops."""
    return flying_robot(
        fixed_base=True,
        base_quaternion=(1.0, 0.0, 0.0, 0.0),
        gravity=WEIGHTLESS,
        joint_angle=(0.0,) * 8,
        timestep=CONTACT_TIMESTEP,
        **changes,
    )


def _hand(subject: Subject) -> Array:
    with subject.run(_hanging_arm()) as run:
        place: Array = run.engine.read().link_position[LINK_NAMES.index(ARM)] + HAND_OFFSET
    return place


def _moved(place: Array, *offset: float) -> tuple[float, float, float]:
    x, y, z = (place + np.array(offset)).tolist()
    return x, y, z


def _fast_ball(subject: Subject, speed: float) -> Iterator[Measurement]:
    hand, restitution = _hand(subject), 0.3
    # The outer corners, where the ball does not meet the trunk.
    for where, offset in (("middle", (0.0, 0.0)), ("lower corner", (-0.03, -0.12)), ("upper corner", (-0.03, 0.12))):
        ball = foam_ball(_moved(hand, 0.15, *offset), (-speed, 0.0, 0.0))
        with subject.run(_hanging_arm(ball=ball, restitution=restitution)) as run:
            path = [state.ball_position[0] for state in run.states(0.3 / speed, CONTACT_TIMESTEP)]
            rebound = float(run.engine.read().ball_velocity[0]) / speed
        depth = RADIUS + HALF_PLATE - float(min(path) - hand[0])
        yield Measurement(
            f"how deep the ball gets at the {where}", "m", 0.0, depth, RADIUS,
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
    scene = box_scene(base_position=(0.0, 0.0, half), ball=foam_ball((1.0, 0.0, RADIUS)), timestep=CONTACT_TIMESTEP)
    state = subject.final_state(scene, 1.0)
    basis = "g t² of a soft contact of 20 steps"
    for name, (x, y, z), start, height in (
        ("box", state.link_position[0], 0.0, half),
        ("ball", state.ball_position, 1.0, RADIUS),
    ):
        yield Measurement(f"sink of the {name}", "m", 0.0, float(height - z), CONTACT_SINK, basis)
        yield Measurement(f"drift of the {name}", "m", 0.0, float(np.hypot(x - start, y)), CONTACT_SINK, basis)


def contact_report(subject: Subject) -> Iterator[Measurement]:
    """Every contact of the ball is told, once, where it is, and with all of its force."""
    speed, duration = 3.0, 0.06
    box = standing_box()
    top = box.center[2] + box.half_extents[2]
    down, weightless = (0.0, 0.0, -speed), {"gravity": WEIGHTLESS, "timestep": CONTACT_TIMESTEP}
    before_hand = _moved(_hand(subject), 0.1, 0.0, 0.0)
    scenes = {
        "floor": ball_scene(foam_ball((0.0, 0.0, 0.1), down), **weightless),
        box.name: ball_scene(foam_ball((-0.4, 0.0, top + 0.1), down), boxes=(box,), **weightless),
        ARM: _hanging_arm(ball=foam_ball(before_hand, (-speed, 0.0, 0.0))),
    }
    for name, scene in scenes.items():
        with subject.run(scene) as run:
            state = run.advance(duration)
        with subject.run(scene) as run:
            told = sum(len(now.ball_contacts) for now in run.states(duration, CONTACT_TIMESTEP))
        contacts = state.ball_contacts
        heading = np.array(scene.ball.velocity) / speed
        gained = scene.ball.mass * float(heading @ (scene.ball.velocity - state.ball_velocity))
        pushed = sum(contact.force for contact in contacts) * CONTACT_TIMESTEP
        # The arm turns away a little, and the normal with it.
        turn = 0.02 if name == ARM else 0.0  # [rad]
        yield Measurement(
            f"momentum told over gained, {name}", "", 1.0, pushed / gained, 1e-5 + 0.5 * turn**2,
            "single precision; cosine of the arm's turn",
        )  # fmt: skip
        aside = max(float(np.linalg.norm(np.cross(heading, c.position - scene.ball.position))) for c in contacts)
        yield Measurement(
            f"contact told aside of the ball's path, {name}", "m", 0.0, aside, 1e-6 + turn * RADIUS,
            "single precision; sine of the arm's turn",
        )  # fmt: skip
        others = sum(contact.other != name for contact in contacts)
        yield Measurement(f"contacts told under other names, {name}", "", 0.0, others, 0.0, "a count")
        twice = len(contacts) - len({contact.time for contact in contacts})
        yield Measurement(f"contacts told twice a step, {name}", "", 0.0, twice, 0.0, "a count")
        lost = told - len(contacts)
        yield Measurement(f"contacts lost between two reads, {name}", "", 0.0, lost, 0.0, "a count")


SCENES: tuple[SceneCheck, ...] = (
    collision_momentum,
    bounce_heights,
    bounce_masses,
    restitution_asked,
    robot_does_not_bounce,
    fast_ball_10,
    fast_ball_25,
    resting_body,
    contact_report,
)
