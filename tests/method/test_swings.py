"""What the choice of the hit knows of the hand: where each motion swings it, how fast, and how certainly."""

import numpy as np
import pytest
from liberobot import MOTION
from rough_tables import SHARP, TABLE

from imolo.method.commands import to_microseconds
from imolo.method.forward_model import GPR, ForwardModel
from imolo.method.hand_uncertainty import HandUncertainty
from imolo.method.hit_choice import group_by_motion


def test_table_gives_every_motion_its_swing() -> None:
    made = TABLE.swings
    assert made.start[-1] == len(TABLE)
    assert len(made.motion) == len(TABLE.hand_std)
    for motion in (0, 17, len(made.motion) - 1):
        rows = slice(made.start[motion], made.start[motion + 1])
        assert (np.diff(made.time[rows]) > 0.0).all()
        k, t_w, k_shows, t_w_shows = made.motion[motion]
        assert (k_shows, t_w_shows) == (0.0, to_microseconds(t_w))
        own = (TABLE.theta == (k, t_w)).all(axis=1)
        assert np.array_equal(np.sort(TABLE.time[own]), made.time[rows])
        assert made.motion[made.mirror[motion], :2].tolist() == [-k, t_w]


def test_constant_uncertainty_is_the_error_on_motions_left_out() -> None:
    training, floor = SHARP.training, HandUncertainty(SHARP).floor
    squares = []
    for motion in np.unique(training.theta, axis=0):
        out = (training.theta == motion).all(axis=1)
        other = ForwardModel(SHARP.config, MOTION).fit(
            training.theta[~out], training.time[~out], training.position[~out]
        )
        error = other.predict(training.theta[out], training.time[out]) - training.position[out]
        squares.append(np.mean(error**2, axis=0))
    # The floor is found on 200 steps up to the largest error.
    assert np.allclose(floor, np.sqrt(np.mean(squares, axis=0)), rtol=0.05)


@pytest.mark.parametrize("kernel", ["rbf", "matern"])
def test_uncertainty_of_a_gaussian_process_is_no_smaller_than_it_says(kernel: str) -> None:
    training = SHARP.training
    config = GPR.model_copy(update={"kernel": kernel})
    model = ForwardModel(config, MOTION).fit(training.theta, training.time, training.position)
    theta, time = np.array([[0.2, 0.3], [-1.0, 0.4]]), np.array([0.5, 0.55])
    assert (HandUncertainty(model).std(theta, time) >= model.predict_std(theta, time) - 1e-12).all()


def test_grid_point_is_as_uncertain_as_a_hand_anywhere_in_its_cell() -> None:
    """The variance of a uniform spread is that of its moments: ∫x²dx / spacing over the cell."""
    spacing, std, edges = 0.03, 0.02, np.linspace(-0.015, 0.015, 100_001)
    one = group_by_motion(
        MOTION, np.array([[0.5, 0.2]]), np.array([0.5]), np.zeros((1, 3)), np.full((1, 3), std), spacing
    )
    assert np.allclose(one.variance, std**2 + np.mean(edges**2), rtol=1e-4, atol=0.0)


def test_velocities_of_hands_rounded_to_the_grid_are_those_of_the_motion_within_the_rounding() -> None:
    """Half a cell of 3 mm at each end of the span of 12 ms is 0.25 m/s; over a step of 2 ms it would be 1.5."""
    since = 0.002 * np.arange(40)
    speed = np.array([6.13, 0.23, 5.17])  # no whole number of cells in a step
    exact = np.outer(since, speed)
    rounded = 0.003 * np.round(exact / 0.003)
    theta = np.tile((0.5, 0.2), (len(since), 1))
    table = group_by_motion(MOTION, theta, since, rounded, np.full((1, 3), 0.02), 0.003)
    inner = slice(3, -3)  # at the ends the span is cut
    assert np.abs(table.velocity[inner] - speed).max() <= 0.003 / 0.012 + 1e-9
