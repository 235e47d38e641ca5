"""The throwing machine: aimed well, scattered as said, and the same for the same seed."""

import math

import numpy as np
import pytest
from liberobot import BALL, CONFIG, THROWER
from numpy.typing import NDArray

from imolo.config.loading import create_task
from imolo.config.simulation import ThrowerConfig
from imolo.contracts.task import Throw
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import ConfigError
from imolo.tasks.thrower import aimed_velocity, draw_throw, lift_of

Array = NDArray[np.float64]

STEADY = THROWER.model_copy(
    update={"flight_time_spread": 0.0, "speed_scatter": 0.0, "angle_scatter": 0.0, "spin_scatter": 0.0}
)
EXACT = STEADY.model_copy(update={"aim_spread": (0.0, 0.0, 0.0)})
THROWS = 100


def unit(way: Array) -> Array:
    """Return the horizontal direction of a way, shape (3,)."""
    return np.array([way[0], way[1], 0.0]) / math.hypot(way[0], way[1])


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def fly(throw: Throw, time: float, steps: int = 200) -> Array:
    """Integrate a ball with quadratic drag and lift by the classical Runge-Kutta method; return where it is."""
    drag = 1.2 * 0.45 * math.pi * 0.045**2 / (2 * 0.010)

    def derivative(state: Array) -> Array:
        v = state[3:]
        lift = np.cross(throw.lift, v) / 0.010
        return np.concatenate((v, lift - drag * math.sqrt(v @ v) * v - [0.0, 0.0, 9.81]))

    state, h = np.concatenate((throw.position, throw.velocity)), time / steps
    for _ in range(steps):
        a = derivative(state)
        b = derivative(state + h / 2 * a)
        c = derivative(state + h / 2 * b)
        d = derivative(state + h * c)
        state = state + h / 6 * (a + 2 * b + 2 * c + d)
    return state[:3]


@pytest.mark.parametrize("topspin", [0.0, 11.0, -30.0])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("index", [0, 1])
def test_ball_is_at_the_aim_point_after_the_flight_time(seed: int, index: int, topspin: float) -> None:
    aim_point = rng(seed).uniform(THROWER.aim_center, np.add(THROWER.aim_center, THROWER.aim_spread))
    config = EXACT.model_copy(update={"aim_center": tuple(aim_point.tolist()), "topspin": topspin})
    throw = draw_throw(config, BALL, index, rng(seed))
    # Root and integrator of the thrower stop at 1e-6 m.
    assert np.abs(fly(throw, config.flight_time) - aim_point).max() < 2e-6


def test_topspin_is_about_the_axis_across_the_throw() -> None:
    config = EXACT.model_copy(update={"positions": ((5.0, 0.0, 1.1),), "aim_center": (1.0, 3.0, 1.5), "topspin": 10.0})
    lift = draw_throw(config, BALL, 0, rng()).lift
    # ½ rho A r ω: the lift coefficient of a slow spin is r ω / v. The ball flies along (-.8, .6).
    size = 0.5 * 1.2 * math.pi * 0.045**3 * 10.0
    assert lift == pytest.approx([-0.6 * size, -0.8 * size, 0.0], rel=1e-12)


def test_balls_to_learn_from_have_no_topspin() -> None:
    task, count = create_task(CONFIG), 25
    lifts = {
        kind: np.mean([task.throw(Trial(kind, index, 1)).lift for index in range(count)], axis=0)
        for kind in (TrialKind.THROW, TrialKind.HIT)
    }
    per_spin = 0.5 * 1.2 * math.pi * 0.045**3
    # Four standard errors of a mean; the thrower's ways are within 10° of -x, so that the axes are of -y.
    allowed = 4 * THROWER.spin_scatter * per_spin / math.sqrt(count)
    assert np.abs(lifts[TrialKind.THROW]).max() < allowed
    assert lifts[TrialKind.HIT][1] == pytest.approx(-THROWER.topspin * per_spin, rel=0.02, abs=allowed)


def test_spin_scatters_as_configured() -> None:
    config, generator = THROWER.model_copy(update={"topspin": 0.0}), rng(5)
    spins = np.array([draw_throw(config, BALL, 0, generator).lift for _ in range(THROWS)])
    spins /= 0.5 * 1.2 * math.pi * 0.045**3
    # Four standard errors of the standard deviation of normal samples, three axes pooled.
    assert abs(spins.std() / config.spin_scatter - 1.0) < 4 / math.sqrt(2 * 3 * (THROWS - 1))


def test_ball_without_drag_flies_the_parabola() -> None:
    vacuum = BALL.model_copy(update={"drag_coefficient": 0.0})
    velocity = aimed_velocity(vacuum, np.array([5.0, 0.0, 1.0]), np.array([1.0, 0.2, 1.6]), 0.8)
    assert velocity == pytest.approx([-5.0, 0.25, 0.75 + 0.4 * 9.81], abs=1e-6)


def test_machine_takes_its_positions_in_turn() -> None:
    config = STEADY.model_copy(update={"positions": ((5.0, -0.4, 1.1), (5.0, 0.4, 1.1), (4.5, 0.0, 1.0))})
    thrown = [tuple(draw_throw(config, BALL, index, rng(index)).position.tolist()) for index in range(7)]
    assert thrown == [config.positions[index % 3] for index in range(7)]


def test_impossible_aim_says_so() -> None:
    config = STEADY.model_copy(update={"aim_center": (-1e4, 0.0, 1.0)})
    with pytest.raises(ConfigError, match=r"no throw from \[5\.0.* aim nearer or give it more time"):
        draw_throw(config, BALL, 0, rng())


def same(one: Throw, other: Throw) -> bool:
    return np.array_equal(one.velocity, other.velocity) and one.release_time == other.release_time


def test_trial_alone_decides_the_throw() -> None:
    def throw(kind: TrialKind, index: int, seed: int) -> Throw:
        return draw_throw(THROWER, BALL, index, Trial(kind, index, seed).generator("throw"))

    assert same(throw(TrialKind.HIT, 4, 1), throw(TrialKind.HIT, 4, 1))
    for other in (throw(TrialKind.HIT, 6, 1), throw(TrialKind.HIT, 4, 2), throw(TrialKind.THROW, 4, 1)):
        assert not same(throw(TrialKind.HIT, 4, 1), other)


@pytest.fixture(scope="module")
def scattered() -> list[Throw]:
    """Throws from one place at one point, so that all that differs is the scatter of the machine."""
    steady = {"positions": ((5.0, 0.0, 1.1),), "aim_spread": (0.0, 0.0, 0.0), "flight_time_spread": 0.0}
    config = THROWER.model_copy(update=steady)
    generator = rng(7)
    return [draw_throw(config, BALL, 0, generator) for _ in range(THROWS)]


@pytest.mark.parametrize("quantity", ["speed", "elevation", "azimuth"])
def test_scatter_of_the_machine_is_as_configured(scattered: list[Throw], quantity: str) -> None:
    velocity = np.array([throw.velocity for throw in scattered])
    speed = np.linalg.norm(velocity, axis=1)
    config, center = THROWER, np.array(THROWER.aim_center)
    lift = lift_of(BALL, config.topspin * np.cross([0.0, 0.0, 1.0], unit(center - [5.0, 0.0, 1.1])))
    aimed = aimed_velocity(BALL, np.array([5.0, 0.0, 1.1]), center, config.flight_time, lift)
    deviation, sd = {
        "speed": (speed / np.linalg.norm(aimed) - 1.0, config.speed_scatter),
        "elevation": (
            np.arcsin(velocity[:, 2] / speed) - np.arcsin(aimed[2] / np.linalg.norm(aimed)),
            config.angle_scatter,
        ),
        "azimuth": (
            np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0])) - np.arctan2(aimed[1], aimed[0]) % (2 * np.pi),
            config.angle_scatter,
        ),
    }[quantity]
    deviation = (deviation + np.pi) % (2 * np.pi) - np.pi
    # Four standard errors of a mean and of a standard deviation of normal samples.
    assert abs(deviation.mean()) < 4 * sd / math.sqrt(THROWS)
    assert abs(deviation.std(ddof=1) / sd - 1.0) < 4 / math.sqrt(2 * (THROWS - 1))


def test_aim_points_and_release_times_fill_their_ranges() -> None:
    config, generator = STEADY, rng(3)
    throws = [draw_throw(config, BALL, index, generator) for index in range(THROWS)]
    aimed_at = [fly(throw, config.flight_time) for throw in throws]
    offset = np.array(aimed_at) - config.aim_center
    release = np.array([throw.release_time for throw in throws])
    spread = np.array(config.aim_spread)
    # Root and integrator of the thrower stop at 1e-6 m.
    assert (np.abs(offset) <= spread + 2e-6).all()
    assert ((config.hold_time[0] <= release) & (release <= config.hold_time[1])).all()
    # That a tenth of the range stays empty at a given end has a chance of 0.9^100 = 3e-5.
    assert (np.ptp(offset, axis=0) > 0.8 * 2 * spread).all()
    assert np.ptp(release) > 0.8 * (config.hold_time[1] - config.hold_time[0])


def test_hold_time_that_is_no_range_is_refused() -> None:
    with pytest.raises(ValueError, match="is not \\(shortest, longest\\)"):
        ThrowerConfig.model_validate({**THROWER.model_dump(), "hold_time": (0.2, 0.1)})
