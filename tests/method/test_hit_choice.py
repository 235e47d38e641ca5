"""The choice of the hit by its probability."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rough_tables import SHARP, TABLE

from imolo.method.forward_model import GPR, ForwardModel
from imolo.method.hand_uncertainty import HandUncertainty
from imolo.method.hit_choice import HitChooser, HitConfig, ProbableHit, group_by_motion
from imolo.method.hit_kernel import BallPath, Extent, Swings, meeting_probability
from imolo.method.motion import MotionTemplate, Theta

Array = NDArray[np.float64]

REACH = 0.085
STEP = 0.01
BALL = np.array([-4.0, 0.3, -2.0])
HAND = np.array([6.0, 0.2, 5.0])


def probability(offset: Array, covariance: Array, before: float = -1.0, after: float = 1.0) -> float:
    return met(offset, BALL, covariance, before, after)


def met(offset: Array, ball_velocity: Array, covariance: Array, before: float, after: float) -> float:
    extent = Extent(reach=REACH, timing_variance=0.0, time_gap=STEP, farthest=1.0)
    C = covariance
    symmetric = (C[0, 0], C[1, 1], C[2, 2], C[0, 1], C[0, 2], C[1, 2])
    p = meeting_probability(tuple(offset), tuple(ball_velocity), tuple(HAND), symmetric, before, after, extent)
    return float(p)


def spread(scale: float) -> Array:
    return np.diag(np.array([0.03, 0.02, 0.04]) * scale) ** 2


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.05, 0.03, -0.08), (-0.2, 0.1, -0.2), (0.0, 0.3, 0.0)])
@pytest.mark.parametrize("window", [(-1.0, 1.0), (-0.004, 0.003)])
def test_closed_form_is_the_share_of_drawn_offsets_that_fly_through_the_square(
    offset: tuple[float, float, float], window: tuple[float, float]
) -> None:
    """With a covariance that does not couple the axes of the square, the closed form is exact."""
    relative = BALL - HAND
    n = relative / np.linalg.norm(relative)
    a = np.array([-n[1], n[0], 0.0]) / math.hypot(n[0], n[1])
    axes = np.stack([a, np.cross(n, a), n])
    std = np.array([0.05, 0.03, 0.04])
    covariance = axes.T @ np.diag(std**2) @ axes
    count = 200_000
    drawn = np.random.default_rng(0).multivariate_normal(offset, covariance, count)
    meets = -(drawn @ n) / np.linalg.norm(relative)
    at = drawn + meets[:, np.newaxis] * relative
    inside = (np.abs(at @ axes[:2].T) < REACH).all(axis=1) & (meets > window[0]) & (meets < window[1])
    p = probability(np.array(offset), covariance, *window)
    assert abs(inside.mean() - p) <= 4.0 * math.sqrt(p * (1.0 - p) / count) + 1e-4


@given(st.floats(0.1, 3.0), st.floats(1.01, 3.0))
def test_less_uncertainty_never_lowers_the_probability_of_a_centred_ball(scale: float, factor: float) -> None:
    assert probability(np.zeros(3), spread(scale)) >= probability(np.zeros(3), spread(scale * factor)) - 1e-12


@given(st.floats(0.0, 0.5), st.floats(0.001, 0.5))
def test_farther_sideways_is_never_likelier(near: float, more: float) -> None:
    sideways = np.array([-(BALL - HAND)[1], (BALL - HAND)[0], 0.0])
    sideways /= np.linalg.norm(sideways)
    assert probability(sideways * near, spread(1.0)) >= probability(sideways * (near + more), spread(1.0)) - 1e-12


def test_ball_that_moves_with_the_hand_meets_nothing() -> None:
    assert met(np.zeros(3), HAND, spread(1.0), -1.0, 1.0) == 0.0


# Tables by hand: for each motion a hand that passes (1, 0.2 k - 0.2, 1) at 0.3 s after t_w.


def hand(k: float, since: Array) -> Array:
    return np.column_stack((1.0 + 6.0 * (since - 0.3), np.full(len(since), 0.2 * k - 0.2), 1.0 + 5.0 * (since - 0.3)))


def swings(ks: tuple[float, ...] = (-1.0, 0.0, 1.0), std: dict[float, float] | None = None) -> Swings:
    since = np.linspace(0.27, 0.33, 13)
    thetas = [(k, t_w) for k in ks for t_w in (0.2, 0.3)]
    theta = np.repeat(thetas, len(since), axis=0)
    time = theta[:, 1] + np.tile(since, len(thetas))
    position = np.concatenate([hand(k, since) for k, _ in thetas])
    spreads = np.array([[(std or {}).get(k, 0.02)] * 3 for k, _ in thetas])
    return group_by_motion(theta, time, position, spreads, 0.0)


def ball(y: float, arrives: float, std: float = 0.01) -> BallPath:
    """Return a ball that passes (1, y, 1) a while after the onset."""
    time = STEP * np.arange(1, 90)
    position = np.array([1.0, y, 1.0]) + np.outer(time - arrives, BALL)
    return BallPath(time, position, np.tile(BALL, (len(time), 1)), np.tile(std**2 * np.eye(3), (len(time), 1, 1)))


def chooser(table: Swings, **values: object) -> HitChooser:
    return HitChooser(table, MotionTemplate(), HitConfig.model_validate(values), STEP)


def chosen(hit: ProbableHit | None) -> tuple[Theta, int]:
    assert hit is not None
    return hit.theta, hit.side


def test_motion_that_meets_the_ball_is_chosen() -> None:
    table = swings()
    hit = chooser(table).start(ball(-0.4, 0.6))
    assert chosen(hit) == (Theta(-1.0, 0.3), 1)
    assert hit is not None
    assert hit.probability > 0.99
    assert np.linalg.norm(hit.position - (1.0, -0.4, 1.0)) < 0.05


def test_other_hand_is_the_mirrored_hand_of_the_opposite_k() -> None:
    """The left hand of k = 1 is where the right one of k = -1 is, y reversed."""
    hit = chooser(swings()).start(ball(0.4, 0.6))
    assert chosen(hit) == (Theta(1.0, 0.3), -1)
    assert hit is not None
    assert np.linalg.norm(hit.position - (1.0, 0.4, 1.0)) < 0.05


def test_mirrored_ball_gets_the_mirrored_motion_with_the_same_probability() -> None:
    table = chooser(swings(), start_probability=0.0)
    right, left = table.start(ball(-0.37, 0.6)), table.start(BallPath(*_mirrored(ball(-0.37, 0.6))))
    assert right is not None
    assert left is not None
    assert (left.theta.k, left.theta.t_w, left.side) == (-right.theta.k, right.theta.t_w, -right.side)
    assert abs(left.probability - right.probability) < 1e-12


def _mirrored(path: BallPath) -> BallPath:
    flip = np.array([1.0, -1.0, 1.0])
    return BallPath(path.time, path.position * flip, path.velocity * flip, path.covariance * np.outer(flip, flip))


def test_more_certain_motion_is_preferred() -> None:
    table = swings(ks=(-0.2, 0.0), std={-0.2: 0.10, 0.0: 0.02})
    assert chosen(chooser(table, start_probability=0.0).start(ball(-0.22, 0.6)))[0].k == 0.0


def test_ball_out_of_reach_starts_nothing() -> None:
    assert chooser(swings()).start(ball(3.0, 0.6)) is None


def test_start_waits_while_a_later_onset_is_likelier() -> None:
    table = chooser(swings(), look_ahead=(0.05,))
    assert table.start(ball(-0.4, 0.67)) is None
    assert table.start(ball(-0.4, 0.62)) is not None


def test_likely_enough_motion_does_not_wait() -> None:
    assert chooser(swings(), look_ahead=(0.05,), start_probability=0.0).start(ball(-0.4, 0.64)) is not None


def test_update_keeps_k_and_may_move_t_w() -> None:
    table = chooser(swings())
    assert chosen(table.update(ball(-0.4, 0.6), Theta(-1.0, 0.2), 0.1))[0] == Theta(-1.0, 0.3)
    assert chosen(table.update(ball(-0.2, 0.5), Theta(-1.0, 0.3), 0.1))[0].k == -1.0


def test_update_before_the_onset_is_free() -> None:
    assert chosen(chooser(swings()).update(ball(-0.2, 0.5), Theta(-1.0, 0.3), -0.001))[0] == Theta(0.0, 0.2)


def test_nothing_is_updated_after_the_switch() -> None:
    assert chooser(swings()).update(ball(-0.4, 0.6), Theta(-1.0, 0.2), 0.21) is None


def test_table_gives_every_motion_its_swing() -> None:
    made = TABLE.swings
    assert made.start[-1] == len(TABLE)
    assert len(made.theta) == len(TABLE.hand_std)
    for motion in (0, 17, len(made.theta) - 1):
        rows = slice(made.start[motion], made.start[motion + 1])
        assert (np.diff(made.time[rows]) > 0.0).all()
        k, switch = made.theta[motion]
        own = (TABLE.theta[:, 0] == k) & (np.rint(TABLE.theta[:, 1] * 1e6) == switch)
        assert np.array_equal(np.sort(TABLE.time[own]), made.time[rows])
        assert made.theta[made.mirror[motion]].tolist() == [-k, switch]


def test_constant_uncertainty_is_the_error_on_motions_left_out() -> None:
    training, floor = SHARP.training, HandUncertainty(SHARP).floor
    squares = []
    for motion in np.unique(training.theta, axis=0):
        out = (training.theta == motion).all(axis=1)
        other = ForwardModel(SHARP.config).fit(training.theta[~out], training.time[~out], training.position[~out])
        error = other.predict(training.theta[out], training.time[out]) - training.position[out]
        squares.append(np.mean(error**2, axis=0))
    # The floor is found on 200 steps up to the largest error.
    assert np.allclose(floor, np.sqrt(np.mean(squares, axis=0)), rtol=0.05)


@pytest.mark.parametrize("kernel", ["rbf", "matern"])
def test_uncertainty_of_a_gaussian_process_is_no_smaller_than_it_says(kernel: str) -> None:
    training = SHARP.training
    config = GPR.model_copy(update={"kernel": kernel})
    model = ForwardModel(config).fit(training.theta, training.time, training.position)
    theta, time = np.array([[0.2, 0.3], [-1.0, 0.4]]), np.array([0.5, 0.55])
    assert (HandUncertainty(model).std(theta, time) >= model.predict_std(theta, time) - 1e-12).all()
