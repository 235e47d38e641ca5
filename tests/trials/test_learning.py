"""Which motions are learned."""

import numpy as np
from liberobot import GRID, MOTION
from played_trials import config

from imolo.trials.learning import spread_motions


def test_spread_motions_fill_the_range_of_the_table_and_no_more() -> None:
    motions = np.array(spread_motions(config("mujoco"), 100))
    low, high = GRID.bounds(MOTION)
    assert motions.min(axis=0).tolist() == low.tolist() == [-1.0, 0.21]
    assert motions.max(axis=0).tolist() == high.tolist() == [1.0, 0.41]
    share = (motions - low) / (high - low)
    counts, _, _ = np.histogram2d(*share.T, bins=4, range=((0, 1), (0, 1)))
    # Of 100 draws that do not know of each other, one cell of 16 has fewer than 4 in most cases.
    assert counts.min() >= 4


def test_spread_motions_depend_on_the_seed_alone() -> None:
    assert spread_motions(config("mujoco"), 20) == spread_motions(config("dart"), 20)
    assert spread_motions(config("mujoco"), 20) != spread_motions(config("mujoco", seed=2), 20)


def test_spread_motions_of_fewer_than_the_corners_are_as_many_as_asked_for() -> None:
    assert len(spread_motions(config("mujoco"), 3)) == 3
