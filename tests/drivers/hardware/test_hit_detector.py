"""What the ball did, told from the cameras: hits near an arm, landings near the ground, and nothing else."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from imolo.ball.tracker import BallTrackerConfig
from imolo.config.loading import body_of, config_for
from imolo.contracts.trial import EventName
from imolo_drivers.hit_detector import BallEvent, HitDetector, HitDetectorConfig
from imolo_msgs import marker_t, mocap_frame_t

RATE = 120.0  # [Hz]
RADIUS = 0.045  # [m]
START = np.array([5.0, -0.16, 1.1])
GRAVITY, DRAG = 9.81, 0.172  # [m/s²], [1/m] of the foam ball
NOISE = 0.001  # [m]
Array = np.ndarray
LIBEROBOT = body_of(config_for("mujoco").robot)
Bounce = Callable[[float, Array, Array], Array | None]


def fly(velocity: Array, bounce: Bounce, duration: float = 1.3) -> list[Array]:
    """Return where the ball is in each frame; `bounce` may give it another velocity."""
    step, position, places = 1e-4, START.copy(), []
    velocity = velocity.copy()
    for count in range(round(duration / step)):
        if count % round(1.0 / RATE / step) == 0:
            places.append(position.copy())
        time = count * step
        after = bounce(time, position, velocity)
        velocity = velocity if after is None else after
        acceleration = -DRAG * np.linalg.norm(velocity) * velocity - np.array([0.0, 0.0, GRAVITY])
        velocity = velocity + step * acceleration
        position = position + step * velocity
    return places


def floor(_: float, position: Array, velocity: Array) -> Array | None:
    if position[2] <= RADIUS and velocity[2] < 0.0:
        return velocity * np.array([0.8, 0.8, -0.3])
    return None


def watch(
    places: list[Array], arm: Array | None = None, hidden: tuple[int, ...] = (), ghosts: bool = False
) -> dict[str, BallEvent]:
    """Return what a detector tells of a ball, and of an arm that stretches from `arm` [m] along x."""
    chance = np.random.default_rng(1)
    detector = HitDetector(HitDetectorConfig(), BallTrackerConfig(), LIBEROBOT)
    told: list[BallEvent] = []
    shoulder = np.array([0.0, -0.16, 1.2]) if arm is None else arm
    for number, place in enumerate(places):
        body = {0: np.array([-0.2, 0.0, 0.8]), 8: shoulder, 6: shoulder + np.array([0.35, 0.0, 0.0])}
        markers = list(body.items())
        if number not in hidden:
            markers.append((marker_t.UNLABELLED, place + NOISE * chance.standard_normal(3)))
        if ghosts and number % 3 == 0:
            markers.append((marker_t.UNLABELLED, place + chance.uniform(-0.4, 0.4, 3)))
        frame = mocap_frame_t()
        frame.utime, frame.frame_number = round(1e6 * number / RATE), number
        for label, where in markers:
            marker = marker_t()
            marker.marker_id, marker.marker_position = label, where.tolist()
            frame.markers.append(marker)
        frame.num_markers = len(frame.markers)
        told += detector.update(frame)
    assert len({event.name for event in told}) == len(told), "an event was told twice"
    return {event.name.value: event for event in told}


def kick(at: float, velocity: Array) -> tuple[Bounce, list[Array]]:
    """Return a bounce that gives the ball a velocity at a time [s], and then lets it land; and where it was."""
    where: list[Array] = []

    def bounce(time: float, position: Array, before: Array) -> Array | None:
        if not where and time >= at:
            where.append(position.copy())
            return velocity
        return floor(time, position, before)

    return bounce, where


def first_landing(places: list[Array]) -> int:
    """Return the frame in which the ball is lowest before it bounces."""
    return next(i for i in range(60, len(places)) if places[i + 1][2] > places[i][2])


THROW = np.array([-6.5, 0.0, 4.0])


def test_ball_that_lands_is_told_where_and_when_it_landed() -> None:
    landed: list[float] = []

    def bounce(time: float, position: Array, velocity: Array) -> Array | None:
        after = floor(time, position, velocity)
        if after is not None:
            landed.append(time)
        return after

    told = watch(fly(THROW * 0.8, bounce))
    assert set(told) == {EventName.THROW, EventName.BALL_LANDED}
    event = told[EventName.BALL_LANDED]
    assert abs(event.utime * 1e-6 - landed[0]) < 1.0 / RATE
    assert event.position[2] == pytest.approx(RADIUS, abs=0.05)  # a fall of 5 m/s for a frame, and noise
    assert event.detail.startswith("on floor, its velocity changed by")


@settings(max_examples=25, deadline=None)
@given(
    at=st.floats(0.55, 0.75),
    away=st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(-2.0, 6.0)),
)
@example(at=0.625, away=(-3.0, 0.0, -1.0))
def test_ball_that_is_struck_near_an_arm_is_a_hit(at: float, away: tuple[float, float, float]) -> None:
    bounce, where = kick(at, np.array(away))
    places = fly(THROW, bounce)
    before = fly(THROW, floor)
    frame = round(at * RATE)
    change = np.linalg.norm(np.array(away) - (before[frame + 1] - before[frame]) * RATE)
    arm = where[0] - np.array([0.3, 0.0, RADIUS])
    told = watch(places, arm)
    if change > 1.0:
        event = told[EventName.TOUCH]
        # As long as the ball is within the gate of its old flight nobody can tell that it was struck.
        config = HitDetectorConfig()
        gate = np.sqrt(chi2.ppf(config.gate_probability, 3) * (config.margin**2 + 2.0 * config.ball_noise**2))
        assert abs(event.utime * 1e-6 - at) < 1.5 / RATE + gate / change
        assert np.linalg.norm(event.position - where[0]) < 0.1
    assert told.get(EventName.BALL_LANDED) is None or told[EventName.BALL_LANDED].utime > at * 1e6


def test_touch_far_from_every_arm_is_neither_hit_nor_landing() -> None:
    bounce, _ = kick(0.6, np.array([2.0, 0.0, 3.0]))
    told = watch(fly(THROW, bounce, 0.9), arm=np.array([-3.0, 0.0, 1.2]))
    assert set(told) == {EventName.THROW}


def test_landing_beside_a_lowered_arm_is_no_hit() -> None:
    places = fly(THROW * 0.8, floor)
    told = watch(places, arm=places[first_landing(places)] - np.array([0.3, 0.0, 0.0]))
    assert set(told) == {EventName.THROW, EventName.BALL_LANDED}


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(0.6, 0.9), side=st.floats(-0.6, 0.6), hidden=st.sets(st.integers(10, 80), max_size=12))
def test_free_flight_past_an_arm_is_no_hit(scale: float, side: float, hidden: set[int]) -> None:
    places = fly(THROW * scale + np.array([0.0, side, 0.0]), floor)
    nearest = places[45]
    told = watch(places, nearest - np.array([0.3, 0.0, 0.06]), tuple(hidden), ghosts=True)
    assert EventName.TOUCH not in told


def test_ball_that_is_hidden_when_it_lands_has_landed() -> None:
    places = fly(THROW * 0.8, floor)
    land = first_landing(places)
    told = watch(places[: land + 30], hidden=tuple(range(land - 3, land + 30)))
    assert EventName.TOUCH not in told
    assert abs(told[EventName.BALL_LANDED].utime * 1e-6 - land / RATE) < 2.0 / RATE


def test_ball_that_nobody_throws_does_nothing() -> None:
    assert watch([START] * 100) == {}
