"""Fits are judged on what they have not seen, engines pair by pair, and more parameters must win."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imolo.identification.evaluation import Outcome
from imolo.identification.judge import choose, paired, split, spread


def outcome(loss: object) -> Outcome:
    return Outcome(np.asarray(loss, dtype=np.float64), {})


CHANCE = np.random.default_rng(1)
HARD = CHANCE.uniform(0.2, 2.0, 100)  # recordings differ far more than fits do


def test_a_fit_with_more_parameters_is_taken_if_it_surely_wins() -> None:
    better = HARD - 0.02 + CHANCE.normal(0.0, 0.02, 100)
    assert choose({"default": outcome(HARD), "simplest": outcome(better)}) == "simplest"


@pytest.mark.parametrize("gain", [0.0, 0.001, -0.02])
def test_a_fit_with_more_parameters_that_does_not_surely_win_is_not_taken(gain: float) -> None:
    other = HARD - gain + np.random.default_rng(2).normal(0.0, 0.05, 100)
    assert choose({"simplest": outcome(HARD), "full": outcome(other)}) == "simplest"


def test_a_full_fit_is_held_against_the_one_that_was_taken() -> None:
    # It beats the simplest fit, but not the settings as they are.
    candidates = {"default": outcome(HARD), "simplest": outcome(HARD + 0.2), "full": outcome(HARD + 0.1)}
    assert choose(candidates) == "default"


def test_a_pairing_shows_what_two_spreads_hide() -> None:
    second = HARD + 0.02 + np.random.default_rng(3).normal(0.0, 0.02, 100)
    apart, together = (spread(HARD), spread(second)), paired(HARD, second)
    assert apart[0] is not None
    assert apart[1] is not None
    assert together is not None
    assert apart[0].high > apart[1].low
    assert together.excludes_zero
    assert together.mean == pytest.approx(0.02, abs=4 * 0.02 / 100**0.5)


def test_an_interval_covers_the_mean_as_often_as_it_says() -> None:
    chance = np.random.default_rng(4)
    found = [spread(chance.normal(0.0, 1.0, 50)) for _ in range(200)]
    inside = sum(one is not None and not one.excludes_zero for one in found)
    # Binomial: 190 ± 3.1; the bootstrap of 50 is a little narrow (93.5 %).
    assert 187 - 4 * 3.1 <= inside <= 190 + 3 * 3.1


def test_what_could_not_be_played_is_counted_out() -> None:
    found = spread(np.array([1.0, np.nan, 3.0]))
    assert found is not None
    assert (found.mean, found.count) == (2.0, 2)
    assert spread(np.array([1.0, np.nan])) is None


@given(
    st.integers(0, 60),
    st.integers(1, 40),
    st.none() | st.integers(1, 40),
    st.integers(0, 5),
    st.sets(st.integers(0, 59)),
)
def test_no_recording_is_on_both_sides(
    count: int, training: int, held_out: int | None, seed: int, left_out: set[int]
) -> None:
    seen, rest = split(count, training, held_out, seed, left_out)
    assert not set(seen) & set(rest)
    assert not (set(seen) | set(rest)) & left_out
    assert len(seen) == min(training, count - len(left_out & set(range(count))))
    assert held_out is None or len(rest) <= held_out
    assert (seen, rest) == split(count, training, held_out, seed, left_out)


def test_recordings_apart_are_for_judging_alone() -> None:
    seen, rest = split(30, 50, None, 1, [3, 25], apart=range(20, 30))
    assert seen == [index for index in range(20) if index != 3]
    assert rest == [index for index in range(20, 30) if index != 25]
