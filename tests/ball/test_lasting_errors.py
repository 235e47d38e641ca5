"""Errors of the cameras that last from frame to frame: told from white noise, and known to the filter."""

from dataclasses import replace

import numpy as np
import pytest
from aerodynamic_flights import BIAS_TIME, MEAN, NOISE, known, lasting, throws
from ball_flights import GRAVITY, RATE
from scipy.stats import chi2

from imolo.ball.aerodynamic_kernel import COVARIANCE_STEP, LONGEST_STEP, transition
from imolo.ball.correlated_noise import CorrelatedNoise, _moments
from imolo.ball.flight import Flight
from imolo.ball.prediction import filter_flight


def test_white_noise_is_not_taken_for_an_error_that_lasts():
    rng, time = np.random.default_rng(21), np.arange(90) / RATE
    found = CorrelatedNoise.fit([time] * 12, [rng.standard_normal((90, 3)) for _ in range(12)])
    np.testing.assert_array_equal(found.lasting, 0.0)
    # 12 * 86 squares: a variance of relative standard deviation sqrt(2 / 1032).
    np.testing.assert_allclose(found.white, 1.0, rtol=5 * np.sqrt(2.0 / 1032))


def test_error_that_lasts_is_told_from_white_noise():
    # 12 flights of 0.75 s hold 12 * 0.75 / (2 * 0.05) = 90 independent values: each variance is known to sqrt(2 / 90),
    # and the white one to a part of what is mistaken for it between the candidate times.
    rng, time = np.random.default_rng(22), np.arange(90) / RATE
    residuals = [rng.standard_normal((90, 3)) + lasting(rng, time, 1.0, BIAS_TIME) for _ in range(12)]
    found = CorrelatedNoise.fit([time] * 12, residuals)
    np.testing.assert_allclose(found.lasting, 1.0, atol=4 * np.sqrt(2.0 / 90))
    np.testing.assert_allclose(found.white, 1.0, atol=0.3)
    assert 0.03 <= found.time <= 0.1


def test_white_part_is_never_nothing():
    # Squares that grow with the gain alone leave no white part, or less than none.
    gain, white = np.array([0.5, 1.0, 4.0]), np.array([2.0, 3.0, 4.0])
    alone, lasting = _moments(gain, np.tile((gain**2)[:, np.newaxis], 3), white)
    np.testing.assert_allclose(alone, 0.01 * white)
    assert (lasting > 1.0).all()


@pytest.mark.parametrize("kind", ["drag", "spin"])
def test_prediction_with_an_error_that_lasts_is_the_propagated_one(kind):
    # Without a white acceleration, whose covariance depends on the steps (it is not braked within one).
    model = known(kind, bias=0.003)
    core = np.concatenate([[5.0, 0.0, 1.1], MEAN])[: {"drag": 7, "spin": 10}[kind]]
    state = np.concatenate([core, [0.003, -0.002, 0.001]])
    covariance = np.diag(np.full(len(state), 1e-5))
    later, spread = model.propagate(state, covariance, 30 * model.time_step)
    np.testing.assert_allclose(model.predict(state, 30)[-1], later, rtol=0, atol=1e-7)
    np.testing.assert_allclose(model.predict_covariance(state, covariance, 30)[-1], spread, rtol=1e-4, atol=1e-9)
    # At the end of a transition the quick covariance is at most 1 % too large, see the kernel.
    whole = int(COVARIANCE_STEP / model.time_step) * 5
    quick, exact = (
        model.position_covariance(state, covariance, whole),
        model.predict_covariance(state, covariance, whole),
    )
    np.testing.assert_allclose(np.diag(quick[-1]), np.diag(exact[-1, :3, :3]), rtol=0.01)
    # Where the ball is seen, less what the cameras add, is where a ball without it would be.
    fade = np.exp(-30 * model.time_step / BIAS_TIME)
    plain = known(kind).predict(core, 30)[-1, :3]
    np.testing.assert_allclose(later[:3] - plain, (fade - 1.0) * state[-3:], rtol=0, atol=1e-7)


def test_filter_is_honest_about_cameras_that_err_alike():
    # The sum over independent flights is χ², within the bounds but once in 10,000. A filter that takes the errors for
    # independent noise of the same size is too sure.
    rng, count, bias = np.random.default_rng(23), 60, 0.004
    flights, starts = throws(rng, count)
    right = known(bias=bias)
    white = replace(known(), measurement_std=np.full(3, np.hypot(NOISE, bias)))
    squares = {"right": 0.0, "white": 0.0}
    for flight, start in zip(flights, starts, strict=True):
        seen = Flight(flight.time, flight.position + lasting(rng, flight.time, bias, BIAS_TIME))
        truth = transition(start, flight.time[-1], 0.0, GRAVITY, LONGEST_STEP)[0][3:]
        for name, model in (("right", right), ("white", white)):
            states, covariances = filter_flight(model, seen)
            error = states[-1][3:10] - truth
            squares[name] += error @ np.linalg.solve(covariances[-1][3:10, 3:10], error)
    low, high = chi2.ppf([0.5e-4, 1.0 - 0.5e-4], 7 * count)
    assert low < squares["right"] < high
    assert squares["white"] > 1.5 * squares["right"]
