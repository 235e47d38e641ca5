"""Friction: distance and direction of sliding, rolling, ramps, and what pairs of bodies get."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from imolo.conformance import Measurement
from imolo.contracts.engine import Array, BoxShape, Scene
from imolo_backends.conformance.bodies import (
    BOX_SIDES,
    CONTACT_SINK,
    CONTACT_TIMESTEP,
    GRAVITY,
    ball_scene,
    box_scene,
    tilted_gravity,
)
from imolo_backends.conformance.subject import SceneCheck, Subject
from imolo_robots.liberobot.body import foam_ball

SPEED = 2.0  # [m/s] of what is pushed
FRICTION = 0.5
HALF_HEIGHT = 0.5 * BOX_SIDES[2]  # [m]
RADIUS = foam_ball().radius  # [m]
TABLE = BoxShape("table", (0.0, 0.0, 0.2), (2.0, 0.5, 0.2))
TABLE_TOP = 0.4  # [m]
PERIOD = 0.2  # [s] between two looks at what is on the ramp
# Until it has sunk in, a body is pressed by less than its weight: it brakes later by mu times how deep it sinks.
SINK = "mu times the sink of a soft contact"


def _box_slide(subject: Subject, direction: float, friction: float, table: bool = False) -> Array:
    """Push the box at `SPEED` in a direction [rad] and return where it stops [m], shape (2,).

    Semi-implicit Euler brakes at the start of each step, so that the box loses ½ v dt on its way; that is added.
    """
    heading = np.array([np.cos(direction), np.sin(direction)])
    scene = box_scene(
        base_position=(0.0, 0.0, HALF_HEIGHT + (TABLE_TOP if table else 0.0)),
        base_velocity=(*(SPEED * heading).tolist(), 0.0),
        boxes=(TABLE,) if table else (),
        friction=friction,
        timestep=CONTACT_TIMESTEP,
    )
    state = subject.final_state(scene, 1.1 * SPEED / (friction * GRAVITY))
    bias = 0.5 * SPEED * CONTACT_TIMESTEP if subject.order == 1 else 0.0
    place: Array = state.link_position[0, :2] + bias * heading
    return place


def _box_friction(subject: Subject, friction: float, direction: float = 0.0, table: bool = False) -> float:
    """Return the friction coefficient that explains how far the box slides."""
    return SPEED**2 / (2.0 * GRAVITY * float(np.hypot(*_box_slide(subject, direction, friction, table))))


def _box_friction_tolerance(friction: float) -> float:
    return 2.0 * GRAVITY * friction**2 / SPEED**2 * friction * CONTACT_SINK


def _slide(subject: Subject, degrees: float) -> Iterator[Measurement]:
    x, y = _box_slide(subject, np.radians(degrees), FRICTION)
    distance, tolerance = SPEED**2 / (2.0 * FRICTION * GRAVITY), FRICTION * CONTACT_SINK
    yield Measurement("distance", "m", distance, float(np.hypot(x, y)), tolerance, f"½ v dt of Euler added; {SINK}")
    direction = float(np.degrees(np.arctan2(y, x)))
    sideways = float(np.degrees(tolerance / distance))
    yield Measurement("direction", "°", degrees, direction, sideways, "as far sideways as the distance may be off")


def slide_0(subject: Subject) -> Iterator[Measurement]:
    """A box pushed along the x axis slides v²/(2 mu g)."""
    yield from _slide(subject, 0.0)


def slide_30(subject: Subject) -> Iterator[Measurement]:
    """A box pushed at 30° to the x axis slides as far, and straight."""
    yield from _slide(subject, 30.0)


def slide_45(subject: Subject) -> Iterator[Measurement]:
    """A box pushed at 45° to the x axis slides as far, and straight."""
    yield from _slide(subject, 45.0)


def cone_or_pyramid(subject: Subject) -> Iterator[Measurement]:
    """Friction is as strong at 45° as at 0°: 1 is a cone, 1.41 and 0.71 are pyramids."""
    along, across = (_box_friction(subject, FRICTION, np.radians(degrees)) for degrees in (0.0, 45.0))
    tolerance = 2.0 * _box_friction_tolerance(FRICTION) / FRICTION
    yield Measurement("friction at 45° over friction at 0°", "", 1.0, across / along, tolerance, f"twice {SINK}")


def friction_asked(subject: Subject) -> Iterator[Measurement]:
    """The friction coefficient asked for is the one got, from how far a box slides."""
    for friction in (0.2, 0.5, 0.8, 1.2):
        got, tolerance = _box_friction(subject, friction), _box_friction_tolerance(friction)
        yield Measurement(f"mu got for {friction:g} asked", "", friction, got, tolerance, SINK)


def _ball_friction(subject: Subject, scene: Scene, height: float) -> Measurement:
    """Return the tangential over the normal impulse on a ball that slides at this height [m]."""
    duration = 0.05  # [s] less than half of the time until it rolls
    ball = foam_ball((-0.1, 0.0, height + RADIUS), (SPEED, 0.0, 0.0))
    scene = replace(scene, ball=ball, friction=FRICTION, timestep=CONTACT_TIMESTEP)
    velocity = subject.final_state(scene, duration).ball_velocity
    got = float((SPEED - velocity[0]) / (GRAVITY * duration + velocity[2]))
    tolerance = FRICTION * CONTACT_TIMESTEP / duration
    return Measurement("", "", FRICTION, got, tolerance, "contact may begin a step late")


def friction_combination(subject: Subject) -> Iterator[Measurement]:
    """Every pair of bodies gets the friction asked for, by whatever rule the engine combines two coefficients."""
    tolerance = _box_friction_tolerance(FRICTION)
    for other, table in (("floor", False), ("box", True)):
        got = _box_friction(subject, FRICTION, table=table)
        yield Measurement(f"mu got between robot and {other}", "", FRICTION, got, tolerance, SINK)
    floor, table_top = ball_scene(foam_ball()), ball_scene(foam_ball(), boxes=(TABLE,))
    robot = box_scene((2.0, 0.5, 0.1), base_position=(0.0, 0.0, 1.0), fixed_base=True)
    for other, scene, height in (("floor", floor, 0.0), ("box", table_top, TABLE_TOP), ("robot", robot, 1.05)):
        got_by_ball = _ball_friction(subject, scene, height)
        yield replace(got_by_ball, quantity=f"mu got between ball and {other}")


def slide_to_roll(subject: Subject) -> Iterator[Measurement]:
    """A ball that slides without spin ends up rolling with 5/7 of its speed."""
    early, late = 0.05, 0.25  # [s]
    braking = FRICTION * GRAVITY
    sliding = 2.0 * SPEED / (7.0 * braking)  # [s] until it rolls
    basis = "braking in a step, for contact may begin a step late"
    scene = ball_scene(foam_ball((0.0, 0.0, RADIUS), (SPEED, 0.0, 0.0)), friction=FRICTION, timestep=CONTACT_TIMESTEP)
    with subject.run(scene) as run:
        slow = float(run.advance(early).ball_velocity[0])
        state = run.advance(late - early)
    gain = braking * CONTACT_TIMESTEP
    yield Measurement("speed while it slides", "m/s", SPEED - braking * early, slow, gain, basis)
    rolling = 5.0 / 7.0 * SPEED
    yield Measurement("speed when it rolls", "m/s", rolling, float(state.ball_velocity[0]), gain, basis)
    # Euler brakes half a step early as long as it slides.
    bias = 0.5 * gain * sliding if subject.order == 1 else 0.0
    way = SPEED * sliding - 0.5 * braking * sliding**2 + rolling * (late - sliding) - bias
    yield Measurement(
        "way", "m", way, float(state.ball_position[0]), FRICTION * CONTACT_SINK + gain * CONTACT_TIMESTEP,
        f"½ mu g dt t of Euler's slide subtracted; {SINK}",
    )  # fmt: skip


def friction_ramp(subject: Subject) -> Iterator[Measurement]:
    """On a ramp the box stays below the friction angle and slides above it; the ball rolls with 5/7 g sin a."""
    slope = float(np.arctan(FRICTION))
    box = box_scene(base_position=(0.0, 0.0, HALF_HEIGHT), friction=FRICTION, timestep=CONTACT_TIMESTEP)
    ball = ball_scene(foam_ball((0.0, 0.0, RADIUS)), friction=FRICTION, timestep=CONTACT_TIMESTEP)

    def places(scene: Scene, angle: float) -> tuple[float, float, float]:
        """Return where box and ball, added, are on the way down 0.1, 0.3 and 0.5 s after the start [m]."""
        with subject.run(replace(scene, gravity=tilted_gravity(angle))) as run:
            states = [run.advance(duration) for duration in (0.1, PERIOD, PERIOD)]
        body = "ball_position" if scene is ball else "link_position"
        first, second, third = (float(np.ravel(getattr(state, body))[0]) for state in states)
        return first, second, third

    _, early, late = places(box, 0.95 * slope)
    gain = GRAVITY * CONTACT_TIMESTEP
    yield Measurement(
        "creep of the box at 0.95 of the friction angle", "m/s", 0.0, (late - early) / PERIOD, gain, "g dt"
    )
    steep, flat = 1.2 * slope, float(np.radians(20.0))
    tolerance = FRICTION * CONTACT_SINK / PERIOD**2
    for name, scene, angle, acceleration in (
        ("box at 1.2 of the friction angle", box, steep, GRAVITY * (np.sin(steep) - FRICTION * np.cos(steep))),
        ("ball at 20°", ball, flat, 5.0 / 7.0 * GRAVITY * np.sin(flat)),
    ):
        first, second, third = places(scene, angle)
        # Euler's second differences are exact.
        got = (third - 2.0 * second + first) / PERIOD**2
        yield Measurement(f"acceleration of the {name}", "m/s²", float(acceleration), got, tolerance, SINK)


SCENES: tuple[SceneCheck, ...] = (
    slide_0,
    slide_30,
    slide_45,
    cone_or_pyramid,
    friction_asked,
    friction_combination,
    slide_to_roll,
    friction_ramp,
)
