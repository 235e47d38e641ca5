"""The choice of the hit by its probability."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from liberobot import BALL as FOAM_BALL
from liberobot import BODY, MOTION
from made_up_motions import MADE_UP
from numpy.typing import NDArray
from rough_tables import TABLE

from imolo.errors import ConfigError
from imolo.method.hit_choice import HitChooser, HitConfig, ProbableHit, group_by_motion
from imolo.method.hit_kernel import BallPath, Extent, Swings, meeting_probability, most_probable_of
from imolo.method.motion import PhasedMotion, Theta

Array = NDArray[np.float64]

ACROSS, UPRIGHT = 0.04 + 0.0225, math.sqrt(0.75) * 0.045  # [m] of Liberobot's plate and ball
STEP = 0.01
BALL = np.array([-4.0, 0.3, -2.0])
HAND = np.array([6.0, 0.2, 5.0])


def probability(offset: Array, covariance: Array, before: float = -1.0, after: float = 1.0) -> float:
    return met(offset, BALL, covariance, before, after)


def met(offset: Array, ball_velocity: Array, covariance: Array, before: float, after: float) -> float:
    extent = Extent(across=ACROSS, upright=UPRIGHT, timing_variance=0.0, time_gap=STEP, farthest=1.0)
    C = covariance
    symmetric = (C[0, 0], C[1, 1], C[2, 2], C[0, 1], C[0, 2], C[1, 2])
    p = meeting_probability(tuple(offset), tuple(ball_velocity), tuple(HAND), symmetric, before, after, extent)
    return float(p)


def spread(scale: float) -> Array:
    return np.diag(np.array([0.03, 0.02, 0.04]) * scale) ** 2


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.05, 0.03, -0.08), (-0.2, 0.1, -0.2), (0.0, 0.3, 0.0)])
@pytest.mark.parametrize("window", [(-1.0, 1.0), (-0.004, 0.003)])
def test_closed_form_is_the_share_of_drawn_offsets_that_fly_through_the_rectangle(
    offset: tuple[float, float, float], window: tuple[float, float]
) -> None:
    """With a covariance that does not couple the axes of the rectangle, the closed form is exact."""
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
    inside = (np.abs(at @ axes[:2].T) < (ACROSS, UPRIGHT)).all(axis=1) & (meets > window[0]) & (meets < window[1])
    p = probability(np.array(offset), covariance, *window)
    assert abs(inside.mean() - p) <= 4.0 * math.sqrt(p * (1.0 - p) / count) + 1e-4


@given(st.floats(0.02, 0.3), st.floats(0.01, 0.2), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_ball_that_counts_as_certain_touches_a_plate_that_is_seen_from_its_edge(
    width: float, radius: float, across: float, upright: float
) -> None:
    made = HitChooser(swings(), MOTION, HitConfig(effector_width=width, ball_radius=radius), STEP)._extent
    a, b = across * made.across, upright * made.upright
    assert math.hypot(max(abs(a) - 0.5 * width, 0.0), b) <= radius * (1.0 + 1e-12)


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
    return group_by_motion(MOTION, theta, time, position, spreads, 0.0)


def ball(y: float, arrives: float, std: float = 0.01) -> BallPath:
    """Return a ball that passes (1, y, 1) a while after the onset."""
    time = STEP * np.arange(1, 90)
    position = np.array([1.0, y, 1.0]) + np.outer(time - arrives, BALL)
    return BallPath(time, position, np.tile(BALL, (len(time), 1)), np.tile(std**2 * np.eye(3), (len(time), 1, 1)))


SURE = dict.fromkeys((-1.0, 0.0, 1.0), 0.005)  # [m] of the hand, by k
SIZES = {"effector_width": BODY.effectors[0].width, "ball_radius": FOAM_BALL.radius}


def chooser(table: Swings, template: PhasedMotion = MOTION, **values: object) -> HitChooser:
    return HitChooser(table, template, HitConfig.model_validate({**SIZES, **values}), STEP)


def chosen(hit: ProbableHit | None) -> tuple[Theta, int]:
    assert hit is not None
    return hit.theta, hit.side


def test_motion_that_meets_the_ball_is_chosen() -> None:
    table = swings(std=SURE)
    hit = chooser(table).start(ball(-0.4, 0.6))
    assert chosen(hit) == ((-1.0, 0.3), 1)
    assert hit is not None
    assert hit.probability > 0.99
    assert np.linalg.norm(hit.position - (1.0, -0.4, 1.0)) < 0.05


@pytest.mark.parametrize("late", [-0.0024, 0.0024])
def test_hand_goes_on_between_the_times_of_the_table(late: float) -> None:
    """A ball that flies with the hand is as near to it 2.4 ms from a tuple, 14 mm farther along x, as at the tuple."""
    small = {"effector_width": 0.004, "ball_radius": 0.002, "start_probability": 0.0}
    made = ball(-0.4, 0.6, std=5e-4)

    def probability_at(time: Array) -> float:
        position = np.array([1.0, -0.4, 1.0]) + np.outer(time - 0.6, HAND * (1.0, 0.0, 1.0))
        hit = chooser(swings(std=dict.fromkeys(SURE, 5e-4)), **small).start(made._replace(time=time, position=position))
        assert chosen(hit) == ((-1.0, 0.3), 1)
        return hit.probability if hit else 0.0

    # The share of meetings beyond the times of the table changes a little with the times of the ball.
    assert abs(probability_at(made.time + late) - probability_at(made.time)) < 0.05
    assert probability_at(made.time) > 0.5


def test_other_hand_is_the_mirrored_hand_of_the_opposite_k() -> None:
    """The left hand of k = 1 is where the right one of k = -1 is, y reversed."""
    hit = chooser(swings(std=SURE)).start(ball(0.4, 0.6))
    assert chosen(hit) == ((1.0, 0.3), -1)
    assert hit is not None
    assert np.linalg.norm(hit.position - (1.0, 0.4, 1.0)) < 0.05


def test_motion_whose_mirrored_one_is_not_in_the_table_has_none() -> None:
    theta = np.array([(-0.5, 0.2), (0.5, 0.2), (0.5, 0.3), (2.0, 0.2)])
    swings = group_by_motion(MOTION, theta, np.full(4, 0.4), np.zeros((4, 3)), np.full((4, 3), 0.01), 0.02)
    assert swings.mirror.tolist() == [1, 0, -1, -1]


def test_mirrored_ball_gets_the_mirrored_motion_with_the_same_probability() -> None:
    table = chooser(swings(), start_probability=0.0)
    right, left = table.start(ball(-0.37, 0.6)), table.start(BallPath(*_mirrored(ball(-0.37, 0.6))))
    assert right is not None
    assert left is not None
    (k, t_w), (other_k, other_t_w) = right.theta, left.theta
    assert (other_k, other_t_w, left.side) == (-k, t_w, -right.side)
    assert abs(left.probability - right.probability) < 1e-12


def _mirrored(path: BallPath) -> BallPath:
    flip = np.array([1.0, -1.0, 1.0])
    return BallPath(path.time, path.position * flip, path.velocity * flip, path.covariance * np.outer(flip, flip))


def test_more_certain_motion_is_preferred() -> None:
    table = swings(ks=(-0.2, 0.0), std={-0.2: 0.10, 0.0: 0.02})
    assert chosen(chooser(table, start_probability=0.0).start(ball(-0.22, 0.6)))[0][0] == 0.0


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
    assert chosen(table.update(ball(-0.4, 0.6), (-1.0, 0.2), 0.1))[0] == (-1.0, 0.3)
    assert chosen(table.update(ball(-0.2, 0.5), (-1.0, 0.3), 0.1))[0][0] == -1.0


def test_update_before_the_onset_is_free() -> None:
    assert chosen(chooser(swings()).update(ball(-0.2, 0.5), (-1.0, 0.3), -0.001))[0] == (0.0, 0.2)


def test_nothing_is_updated_after_the_switch() -> None:
    assert chooser(swings()).update(ball(-0.4, 0.6), (-1.0, 0.2), 0.21) is None


# Any number of parameters.

SINCE = np.linspace(0.02, 0.08, 13)  # [s] of the swing
ROUNDING = 1e-13  # of a probability after some hundred operations that are compiled twice
VALUES = {1: 40, 2: 9, 3: 6, 4: 4}  # of each parameter, by their number
LEADS = np.array([[0.0, 0.4, 0.0], [0.05, 0.0, 0.2], [0.1, -0.1, 0.1], [-0.1, 0.1, 0.2]])  # [m] over each one's range


def lattice_of(template: PhasedMotion) -> Array:
    """Return all combinations of some values of each parameter, shape (T, n)."""
    count = VALUES[len(template.varied)]
    axes = [np.linspace(*template.bounds(one), count + 2)[1:-1].round(6) for one in template.varied]
    return np.stack([part.ravel() for part in np.meshgrid(*axes, indexing="ij")], axis=1)


def place_of(template: PhasedMotion, theta: Array) -> Array:
    """Return where the hand is 50 ms after the start of the swing [m], shape (T, 3)."""
    low, high = np.array([template.bounds(one) for one in template.varied]).T
    share = (theta - low) / (high - low) - 0.5
    return np.asarray((1.0, -0.2, 1.0) + share @ LEADS[: len(low)])


def swings_of(template: PhasedMotion) -> Swings:
    """Return a table in which each parameter leads the hand elsewhere, in place or in time."""
    motions = lattice_of(template)
    theta = np.repeat(motions, len(SINCE), axis=0)
    since = np.tile(SINCE, len(motions))
    position = place_of(template, theta) + np.outer(since - 0.05, HAND)
    time = template.swing_start(theta) + since
    return group_by_motion(template, theta, time, position, np.full((len(motions), 3), 0.03), 0.0)


def towards(place: Array, arrives: float) -> BallPath:
    time = STEP * np.arange(1, 130)
    position = place + np.outer(time - arrives, BALL)
    return BallPath(time, position, np.tile(BALL, (len(time), 1)), np.tile(1e-4 * np.eye(3), (len(time), 1, 1)))


def best_of_all(
    template: PhasedMotion, table: Swings, config: HitConfig, path: BallPath, executed: tuple[Theta, int] | None
) -> tuple[float, dict[Theta, float]]:
    """Return the highest probability, and that of every motion which continues the executed one, one by one."""
    extent = Extent(ACROSS, UPRIGHT, config.timing_std**2, 0.5 * STEP + 1e-6, config.farthest)
    found = {}
    for index, row in enumerate(table.motion.tolist()):
        theta = tuple(row[: len(template.varied)])
        if executed is not None:
            old, elapsed = executed
            if not template.commands(theta, 0).matches_until(template.commands(old, 0), elapsed):
                continue
        found[theta] = most_probable_of(np.array([index]), path, table, extent).probability
    return max(found.values(), default=0.0), found


TABLES = [(template, swings_of(template)) for template in (*MADE_UP, MOTION)]


@settings(deadline=None, max_examples=100)
@given(
    st.sampled_from(TABLES),
    st.integers(0, 10**6),
    st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    st.floats(-0.02, 0.02),
    st.none() | st.tuples(st.integers(0, 10**6), st.integers(-1000, 600_000)),
)
def test_motion_that_is_found_is_the_best_of_all_that_continue_the_executed_one(
    table: tuple[PhasedMotion, Swings],
    aimed: int,
    off: tuple[float, float, float],
    late: float,
    executed: tuple[int, int] | None,
) -> None:
    """Where every value of each parameter is tried."""
    template, stored = table
    motions = stored.motion[:, : len(template.varied)]
    theta = motions[aimed % len(motions)]
    path = towards(place_of(template, theta) + off, template.swing_of(theta) + 0.05 + late)
    config = HitConfig.model_validate({**SIZES, "coarse": (99,) * len(theta), "start_probability": 0.0})
    asked = HitChooser(stored, template, config, STEP)
    old = None if executed is None else (tuple(motions[executed[0] % len(motions)].tolist()), executed[1])
    best, every = best_of_all(template, stored, config, path, old)
    if old is None:
        hit = asked.start(path)
    else:
        hit = asked.update(path, old[0], old[1] * 1e-6)
        if (old[1] > np.rint(1e6 * template.shows_from([old[0]]))).all():
            assert list(every) == [old[0]]  # there is nothing to choose
            assert hit is None
            return
    assert abs(best - (0.0 if hit is None else hit.probability)) < ROUNDING
    if hit is not None:
        assert abs(best - every[hit.theta]) < ROUNDING


@pytest.mark.parametrize("table", TABLES, ids=lambda table: "_".join(one.name for one in table[0].varied))
def test_coarse_search_ends_on_the_motion_that_flies_right_at_the_ball(table: tuple[PhasedMotion, Swings]) -> None:
    """Within a hand of the best one: from the coarse lattice on, the search goes uphill alone."""
    template, stored = table
    motions = stored.motion[:, : len(template.varied)]
    asked = chooser(stored, template, start_probability=0.0)
    for theta in motions[:: max(1, len(motions) // 20)]:
        path = towards(place_of(template, theta), template.swing_of(theta) + 0.05)
        best, _ = best_of_all(template, stored, HitConfig.model_validate(SIZES), path, None)
        hit = asked.start(path)
        assert hit is not None
        assert hit.probability >= 0.99 * best


@pytest.mark.parametrize(
    ("values", "mirrored"),
    [
        ((-0.3, -0.1, 0.1, 0.3, 0.5), (0.3, 0.1, -0.1, -0.3, None)),
        ((-0.2, 0.0, 0.2, 0.3), (0.2, 0.0, -0.2, -0.2)),  # to half a step, that included
        ((-0.2, 0.0, 0.2, 0.31), (0.2, 0.0, -0.2, None)),
    ],
)
def test_mirrored_motion_is_the_stored_one_within_half_a_step(
    values: tuple[float, ...], mirrored: tuple[float | None, ...]
) -> None:
    when = 0.3
    time = np.tile(when + SINCE, len(values))
    theta = np.repeat([(k, when) for k in values], len(SINCE), axis=0)
    stored = group_by_motion(MOTION, theta, time, np.zeros((len(time), 3)), np.full((len(values), 3), 0.03), 0.0)
    assert [None if one < 0 else stored.motion[one, 0] for one in stored.mirror] == list(mirrored)


def test_reachable_part_of_a_path_is_from_the_first_to_the_last_place_near_a_hand() -> None:
    near, far = TABLE.swings.position.mean(axis=0), np.full(3, 10.0)
    asked = chooser(TABLE.swings)
    assert asked.reachable(np.array([far, far, near, far, near, far, far])) == slice(2, 5)
    assert asked.reachable(np.array([near])) == slice(0, 1)
    assert asked.reachable(np.array([far, far])) == slice(0, 0)


def test_number_of_coarse_values_is_that_of_the_parameters() -> None:
    template, stored = TABLES[2]
    with pytest.raises(ConfigError, match=r"hit\.coarse is \(10, 13\); give 3 numbers, one per parameter"):
        chooser(stored, template, coarse=(10, 13))


def test_chooser_without_the_size_of_hand_and_ball_says_so() -> None:
    with pytest.raises(ConfigError, match=r"needs hit\.effector_width and hit\.ball_radius"):
        HitChooser(swings(), MOTION, HitConfig(), STEP)
