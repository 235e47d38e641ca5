"""Friction: distance and direction of sliding, rolling, ramps, and what pairs of bodies get."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from imolo.conformance import Measurement
from imolo.contracts.engine import Array, Ball, BoxShape, Scene
from imolo_backends.conformance.bodies import (
    BALL_MASS,
    BALL_RADIUS,
    BOX_SIDES,
    CONTACT_SINK,
    CONTACT_TIMESTEP,
    GRAVITY,
    WEIGHTLESS,
    ball_scene,
    box_scene,
    solid_ball,
    tilted_gravity,
)
from imolo_backends.conformance.reference import rotation_vector
from imolo_backends.conformance.subject import CONTACT_TIMESTEPS, SceneCheck, Subject, at_timestep, at_zero

SPEED = 1.0  # [m/s] of what is pushed
FRICTION = 0.5
HALF_HEIGHT = 0.5 * BOX_SIDES[2]  # [m]
TABLE = BoxShape("table", (0.0, 0.0, 0.2), (2.0, 0.5, 0.2))
TABLE_TOP = 0.4  # [m]
PERIOD = 0.2  # [s] between two looks at what is on the ramp
# Until it has sunk in, a body is pressed by less than its weight: it brakes later by mu times how deep it sinks.
SINK = "mu times the sink of a soft contact"
LATE = "½ v dt of Euler's, or a contact that begins a step late: v dt"


@dataclass(frozen=True)
class Slide:
    """How a box slid.

    Attributes:
        place: Where it stops [m], shape (2,).
        at_zero: The same at dt = 0, from two timesteps.
        hop: How far it was off its height on its way at most [m].
        turn: How far it was turned at most [rad].
    """

    place: Array
    at_zero: Array
    hop: float
    turn: float


@lru_cache(maxsize=16)
def box_slide(subject: Subject, degrees: float, friction: float, table: bool = False) -> Slide:
    """Push the box at `SPEED` in a direction [°], on the floor or on a table; several scenes look at the same slide."""
    heading = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    height = HALF_HEIGHT + (TABLE_TOP if table else 0.0)
    scene = box_scene(
        base_position=(0.0, 0.0, height),
        base_velocity=(*(SPEED * heading).tolist(), 0.0),
        boxes=(TABLE,) if table else (),
        friction=friction,
    )
    ends, duration = [], 1.1 * SPEED / (friction * GRAVITY)
    for timestep in CONTACT_TIMESTEPS:
        with subject.run(at_timestep(scene, timestep)) as run:
            states = list(run.states(duration, duration / 100.0))
        ends.append(states[-1].link_position[0, :2])
    coarse, fine = ends
    hop = max(abs(float(state.link_position[0, 2]) - height) for state in states)
    turn = max(float(np.linalg.norm(rotation_vector(state.link_rotation[0]))) for state in states)
    return Slide(fine, at_zero(coarse, fine), hop, turn)


def _box_friction(subject: Subject, friction: float, degrees: float = 0.0, table: bool = False) -> float:
    """Return the friction coefficient that explains how far the box slides at dt = 0."""
    return SPEED**2 / (2.0 * GRAVITY * float(np.hypot(*box_slide(subject, degrees, friction, table).at_zero)))


def _box_friction_tolerance(friction: float) -> float:
    return 2.0 * GRAVITY * friction**2 / SPEED**2 * friction * CONTACT_SINK


def _slide(subject: Subject, degrees: float) -> Iterator[Measurement]:
    slide = box_slide(subject, degrees, FRICTION)
    expected, tolerance = SPEED**2 / (2.0 * FRICTION * GRAVITY), FRICTION * CONTACT_SINK
    distance, limit = float(np.hypot(*slide.place)), float(np.hypot(*slide.at_zero))
    late = SPEED * CONTACT_TIMESTEP
    yield Measurement("distance", "m", expected, distance, late + tolerance, f"{LATE}; {SINK}")
    yield Measurement("distance at dt = 0", "m", expected, limit, tolerance, f"Richardson of first order; {SINK}")
    direction = float(np.degrees(np.arctan2(slide.place[1], slide.place[0])))
    sideways = float(np.degrees(tolerance / expected))
    yield Measurement("direction", "°", degrees, direction, sideways, "as far sideways as the distance may be off")
    yield Measurement("height off, at most", "m", 0.0, slide.hop, CONTACT_SINK, "sink of a soft contact")
    turn = float(np.degrees(2.0 * CONTACT_SINK / min(BOX_SIDES[:2])))
    yield Measurement("turn, at most", "°", 0.0, float(np.degrees(slide.turn)), turn, "one edge sinks as deep again")


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
    along, across = (_box_friction(subject, FRICTION, degrees) for degrees in (0.0, 45.0))
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
    ball = solid_ball((-0.1, 0.0, height + BALL_RADIUS), (2.0 * SPEED, 0.0, 0.0))
    velocity = subject.final_state(replace(scene, ball=ball, friction=FRICTION), duration).ball_velocity
    got = float((ball.velocity[0] - velocity[0]) / (GRAVITY * duration + velocity[2]))
    tolerance = FRICTION * CONTACT_TIMESTEP / duration
    return Measurement("", "", FRICTION, got, tolerance, "contact may begin a step late")


def friction_combination(subject: Subject) -> Iterator[Measurement]:
    """Every pair of bodies gets the friction asked for, by whatever rule the engine combines two coefficients."""
    tolerance = _box_friction_tolerance(FRICTION)
    for other, table in (("floor", False), ("box", True)):
        got = _box_friction(subject, FRICTION, table=table)
        yield Measurement(f"mu got between robot and {other}", "", FRICTION, got, tolerance, SINK)
    floor, table_top = ball_scene(solid_ball()), ball_scene(solid_ball(), boxes=(TABLE,))
    robot = box_scene((2.0, 0.5, 0.1), base_position=(0.0, 0.0, 1.0), fixed_base=True)
    for other, scene, height in (("floor", floor, 0.0), ("box", table_top, TABLE_TOP), ("robot", robot, 1.05)):
        got_by_ball = _ball_friction(subject, scene, height)
        yield replace(got_by_ball, quantity=f"mu got between ball and {other}")


def friction_begins(subject: Subject) -> Iterator[Measurement]:
    """Friction is mu times the normal impulse from the first step of a contact on."""
    steps = 100
    duration = steps * CONTACT_TIMESTEP
    lead = CONTACT_TIMESTEP if subject.order == 1 else 0.0
    braking = FRICTION * GRAVITY * CONTACT_TIMESTEP  # [m/s] in a step
    box = box_scene(base_position=(0.0, 0.0, HALF_HEIGHT), base_velocity=(SPEED, 0.0, 0.0), friction=FRICTION)
    place = subject.final_state(box, duration).link_position[0]
    pressed = float(place[2]) - HALF_HEIGHT + 0.5 * GRAVITY * duration * (duration + lead)
    of_box = (FRICTION * pressed - (SPEED * duration - float(place[0]))) / (braking * duration)
    ball = solid_ball((0.0, 0.0, BALL_RADIUS), (2.0 * SPEED, 0.0, 0.0))
    velocity = subject.final_state(ball_scene(ball, friction=FRICTION), duration).ball_velocity
    pressed = float(velocity[2]) + GRAVITY * duration
    of_ball = (FRICTION * pressed - (ball.velocity[0] - float(velocity[0]))) / braking
    for body, lost in (("box", of_box), ("ball", of_ball)):
        basis = "none, whatever the normal force; a fifth of one"
        yield Measurement(f"steps of friction that the {body} loses", "", 0.0, lost, 0.2, basis)
    # What lands is braked by mu times the whole impulse; the ball is fast enough not to roll before it parts.
    friction, fall, gap, glance = 0.2, 1.0, 0.01, 0.01
    basis = "a hundredth, less than a step of the thirty of a soft impact"
    ball = solid_ball((0.0, 0.0, BALL_RADIUS + gap), (2.0 * SPEED, 0.0, -fall))
    velocity = subject.final_state(ball_scene(ball, friction=friction, gravity=WEIGHTLESS), 0.03).ball_velocity
    got = (ball.velocity[0] - float(velocity[0])) / (float(velocity[2]) + fall)
    yield Measurement("mu got by a ball that lands", "", friction, got, 0.01 * friction, basis)
    thrown = (2.0 * SPEED, 0.0, -fall)
    box = box_scene(base_position=(0.0, 0.0, HALF_HEIGHT + gap), base_velocity=thrown, friction=friction)
    with subject.run(replace(box, gravity=WEIGHTLESS)) as run:
        before, after = (run.advance(duration).link_position[0] for duration in (0.03, glance))
    x, _, z = ((after - before) / glance).tolist()
    got = (thrown[0] - x) / (z + fall)
    yield Measurement("mu got by a box that lands", "", friction, got, 0.01 * friction, basis)


def friction_of_impacts(subject: Subject) -> Iterator[Measurement]:
    """Cubes that land tumbling and slipping get no more than mu times the normal impulse, in whatever direction."""
    friction, side, speed, fall, flight, glance = 0.2, 0.1, 1.0, 1.0, 0.12, 0.01
    rng = np.random.default_rng(1)
    excess = []
    for heading in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        turn = Rotation.random(random_state=rng)
        thrown = np.array([speed * np.cos(heading), speed * np.sin(heading), -fall])
        scene = box_scene(
            (side, side, side),
            mass=0.4,
            base_position=(0.0, 0.0, side),
            base_quaternion=tuple(np.roll(turn.as_quat(), 1).tolist()),
            base_velocity=tuple(thrown.tolist()),
            base_angular_velocity=tuple(rng.uniform(-10.0, 10.0, 3).tolist()),
            friction=friction,
            gravity=WEIGHTLESS,
        )
        with subject.run(scene) as run:
            before, after = (run.advance(duration).link_position[0] for duration in (flight, glance))
        gained = (after - before) / glance - thrown
        excess.append(float(np.hypot(*gained[:2]) / (friction * gained[2])) - 1.0)
    basis = "a cone is kept at every instant, and so by the sum; a hundredth"
    yield Measurement("friction beyond mu times the normal impulse", "", 0.0, max(*excess, 0.0), 0.01, basis)


def slide_to_roll(subject: Subject) -> Iterator[Measurement]:
    """A ball that slides without spin ends up rolling, a solid one with 5/7 of its speed, a hollow one with 3/5."""
    early, late, speed = 0.05, 0.25, 2.0  # [s, s, m/s]
    gain = FRICTION * GRAVITY * CONTACT_TIMESTEP  # [m/s]
    basis = "braking in a step, for contact may begin a step late"
    solid = solid_ball((0.0, 0.0, BALL_RADIUS), (speed, 0.0, 0.0))
    radius, mass = 1.6 * BALL_RADIUS, 2.0 * BALL_MASS
    hollow = Ball(radius, mass, 2.0 / 3.0 * mass * radius**2, (0.0, 0.0, radius), (speed, 0.0, 0.0))
    for name, ball in (("solid", solid), ("hollow", hollow)):
        share = ball.inertia / (ball.mass * ball.radius**2)
        places: list[Array] = []
        for timestep in CONTACT_TIMESTEPS:
            with subject.run(ball_scene(ball, friction=FRICTION, timestep=timestep)) as run:
                slow = float(run.advance(early).ball_velocity[0])
                state = run.advance(late - early)
            places.append(state.ball_position)
        expected = speed - FRICTION * GRAVITY * early
        yield Measurement(f"speed while the {name} ball slides", "m/s", expected, slow, gain, basis)
        rolling = speed / (1.0 + share)
        got = speed / float(state.ball_velocity[0]) - 1.0
        yield Measurement(f"I / m r² got by the {name} ball", "", share, got, gain * speed / rolling**2, basis)
        sink = float(ball.radius - state.ball_position[2])
        yield Measurement(f"sink of the {name} ball", "m", 0.0, sink, CONTACT_SINK, "of a soft contact")
        sliding = (speed - rolling) / (FRICTION * GRAVITY)  # [s] until it rolls
        way = 0.5 * (speed + rolling) * sliding + rolling * (late - sliding)
        fine, limit = float(places[1][0]), float(at_zero(places[0], places[1])[0])
        tolerance = FRICTION * CONTACT_SINK
        yield Measurement(f"way of the {name} ball", "m", way, fine, gain * sliding + tolerance, f"{basis}; {SINK}")
        basis_at_zero = f"Richardson of first order; {SINK}"
        yield Measurement(f"way of the {name} ball at dt = 0", "m", way, limit, tolerance, basis_at_zero)


def friction_ramp(subject: Subject) -> Iterator[Measurement]:
    """On a ramp the box stays below the friction angle and slides above it; the ball rolls with 5/7 g sin a."""
    slope = float(np.arctan(FRICTION))
    box = box_scene(base_position=(0.0, 0.0, HALF_HEIGHT), friction=FRICTION, timestep=CONTACT_TIMESTEP)
    ball = ball_scene(solid_ball((0.0, 0.0, BALL_RADIUS)), friction=FRICTION, timestep=CONTACT_TIMESTEP)

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
    friction_begins,
    friction_of_impacts,
    slide_to_roll,
    friction_ramp,
)
