"""Drag and lift of the ball against SciPy's integrator, finite differences and flights of a known population."""

import json
from dataclasses import replace

import numpy as np
import pytest
from aerodynamic_flights import DENSITY, MEAN, NOISE, SPREAD, known, magnus, throws
from ball_flights import GRAVITY, RATE, fly, make_frame
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from imolo.ball.aerodynamic_kernel import COVARIANCE_STEP, LONGEST_STEP, normal_equations, transition
from imolo.ball.fit import _vertex, fit_ball_model, restore_ball_model
from imolo.ball.flight import Flight
from imolo.ball.linear import LinearBallModel
from imolo.ball.model import BallModelConfig
from imolo.ball.prediction import filter_flight, prediction_errors
from imolo.ball.tracker import BallTracker
from imolo.errors import TableFileError


@pytest.fixture(scope="module")
def fitted():
    flights, starts = throws(np.random.default_rng(0), 12)
    config = BallModelConfig(kind="spin", density_grid=(1e-6, 1e-3, 1e-1))
    return fit_ball_model(flights, config), starts


@pytest.mark.parametrize("kind", ["drag", "spin"])
def test_quick_position_covariance_is_the_exact_one_and_never_smaller(kind):
    model = known(kind, density=1e-2)
    state = np.concatenate([[5.0, 0.0, 1.1], MEAN])[: {"drag": 7, "spin": 10}[kind]]
    covariance = np.diag(np.concatenate([np.full(3, NOISE), 0.1 * np.ones(3), SPREAD[3:]])[: len(state)] ** 2)
    quick, exact = model.position_covariance(state, covariance, 96), model.predict_covariance(state, covariance, 96)
    quick, exact = (np.diagonal(c[:, :3, :3], axis1=1, axis2=2) for c in (quick, exact))
    assert (quick >= exact * (1.0 - 1e-3)).all()
    # A chord over h is above a convex curve by at most h²/8 times its largest second derivative there; 2 % for taking
    # that from differences. Its end itself is less than 1 % high: drag does not brake the noise within a step.
    stride = int(COVARIANCE_STEP / model.time_step)
    start = np.diagonal(covariance)[np.newaxis, :3]
    second = np.diff(np.concatenate([start, exact]), n=2, axis=0)
    for first in range(0, 96, stride):
        chord = slice(first, first + stride)
        bound = 1.02 * stride**2 / 8.0 * second[max(first - 1, 0) : first + stride].max(axis=0)
        assert (quick[chord] - exact[chord] <= bound + 0.01 * exact[chord]).all()


@pytest.mark.parametrize("speed", [5.0, 25.0])
@pytest.mark.parametrize(("k", "omega"), [(0.0, (0, 0, 0)), (0.172, (0, 0, 0)), (0.09, (1.0, -2.0, 0.5))])
def test_predicted_path_is_that_of_an_independent_integrator(speed, k, omega):
    # RK4 of 120 steps: the local error is of the order of h^5 v'''' / 120, below 1e-7 m for k v = 4 /s at h = 8.3 ms.
    model = known()
    state = np.array([0.0, 0.0, 1.0, 0.8 * speed, 0.1 * speed, 0.6 * speed, k, *omega])
    time = model.time_step * np.arange(121)
    truth = fly(state[:6], time, magnus(k, np.array(omega)))
    np.testing.assert_allclose(model.predict(state, 120)[:, :6], truth[1:], rtol=0, atol=1e-6)


def test_vertical_fall_follows_the_closed_form():
    # v = v_t tanh(g t / v_t), z = -v_t² / g ln cosh(g t / v_t), with v_t² = g / k.
    k, t = 0.172, 0.0083 * np.arange(1, 97)
    terminal = np.sqrt(9.81 / k)
    path = known("drag").predict(np.array([0, 0, 0, 0, 0, 0, k]), 96)
    np.testing.assert_allclose(path[:, 2], -(terminal**2) / 9.81 * np.log(np.cosh(9.81 * t / terminal)), atol=1e-8)
    np.testing.assert_allclose(path[:, 5], -terminal * np.tanh(9.81 * t / terminal), atol=1e-7)


@pytest.mark.parametrize("axis", range(3))
def test_fit_knows_what_gravity_does(axis):
    # The trapezoidal rule is right to (2 k |v| h)² / 12 = 3e-5 in a step.
    state, time = np.concatenate([[5.0, 0.0, 1.1], MEAN]), np.arange(60) / RATE
    step = np.zeros(3)
    step[axis] = 1e-4
    path = np.zeros((60, 3))
    change = [normal_equations(state, time, path, GRAVITY + sign * step)[2] for sign in (-1.0, 1.0)]
    sensitivity = (change[0] - change[1])[:, axis] / 2e-4
    information, gradient, _ = normal_equations(state, time, path, GRAVITY)
    assert information[axis, 10 + axis, 10 + axis] == pytest.approx(sensitivity @ sensitivity, rel=1e-4)
    residuals = normal_equations(state, time, path, GRAVITY)[2][:, axis]
    assert gradient[axis, 10 + axis] == pytest.approx(sensitivity @ residuals, rel=1e-4)


def test_gravity_of_all_flights_is_learned():
    # A light ball in a frame that is not level. A parabola through 108 samples of 2 mm in 0.9 s leaves
    # sqrt(720 / 108) 2 mm / T² = 6 mm/s², 12 flights 2 mm/s²; drag, unknown too, makes it five times as uncertain.
    gravity, time, rng = np.array([0.2, -0.1, -9.5]), np.arange(0.0, 0.9, 1.0 / RATE), np.random.default_rng(5)
    flights = []
    for _ in range(12):
        start = np.concatenate([[5.0, 0.0, 1.1], MEAN[:4] + SPREAD[:4] * rng.standard_normal(4)])
        path = [transition(start, t, 0.0, gravity, LONGEST_STEP)[0][:3] for t in time]
        flights.append(Flight(time, path + NOISE * rng.standard_normal((len(time), 3))))
    model = fit_ball_model(flights, BallModelConfig(kind="drag", acceleration_density=1e-6))
    np.testing.assert_allclose(model.gravity, gravity, rtol=0, atol=4 * 0.010)
    state = np.concatenate([[5.0, 0.0, 1.1], MEAN[:4]])
    truth = transition(state, 80 * model.time_step, 0.0, model.gravity, LONGEST_STEP)[0]
    np.testing.assert_allclose(model.predict(state, 80)[-1], truth, rtol=0, atol=1e-7)


def test_noise_that_grows_along_the_way_is_learned():
    # 1296 positions: the logarithm of the variance of three axes at an end is known to 2 sqrt(2 / 3 / 1296), 5 %.
    rng, model = np.random.default_rng(6), known()
    flights, _ = throws(rng, 12)
    noisier = []
    for flight in flights:
        extra = np.sqrt(9.0 ** np.linspace(1.0, 0.0, len(flight.time)) - 1.0) * NOISE
        noisier.append(Flight(flight.time, flight.position + extra[:, None] * rng.standard_normal((len(extra), 3))))
    model = fit_ball_model(noisier, BallModelConfig(kind="spin", acceleration_density=1e-6))
    for end, factor in ((0, 9.0), (-1, 1.0)):
        variance = np.mean([np.diag(model.measurement_covariance(f.position[end])) for f in flights], axis=0)
        np.testing.assert_allclose(variance, factor * NOISE**2, rtol=0.25)
    # Beyond what was seen it stays as it was at the end.
    far = flights[0].position[-1] + 10.0 * (flights[0].position[-1] - flights[0].position[0])
    assert np.diag(model.measurement_covariance(far)) == pytest.approx(NOISE**2, rel=0.3)
    kalman = model.make_filter(np.concatenate([flights[0].position[0], MEAN]), np.eye(10))
    before = kalman.R[0, 0]
    model.advance(kalman, flights[0].time[-1])
    assert before / kalman.R[0, 0] == pytest.approx(9.0, rel=0.3)


@given(center=st.floats(-7.0, 1.0), width=st.floats(0.1, 10.0))
def test_process_noise_lies_where_the_likelihood_is_highest(center, width):
    # A parabola over the logarithm: its own vertex, or the nearest candidate beyond the last one.
    grid = (1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0)
    likelihood = {density: -width * (np.log(density) - center) ** 2 for density in grid}
    best = max(grid, key=lambda density: likelihood[density])
    assert _vertex(best, likelihood) == pytest.approx(np.clip(np.exp(center), grid[0], grid[-1]), rel=1e-6)


def test_flat_or_short_likelihoods_keep_the_candidate():
    assert _vertex(1.0, {1.0: 0.0, 2.0: -1.0}) == 1.0
    assert _vertex(4.0, {1.0: 0.0, 2.0: -1.0, 4.0: 1.0}) == 4.0


@pytest.mark.parametrize("kind", ["drag", "spin"])
@pytest.mark.parametrize("duration", [0.0083, 0.4, -0.05])
def test_sensitivity_is_the_finite_difference(kind, duration):
    state = np.concatenate([[5.0, 0.0, 1.1], MEAN])[: {"drag": 7, "spin": 10}[kind]]
    _, F, _ = transition(state, duration, 0.0, GRAVITY, LONGEST_STEP)
    for i in range(len(state)):
        step = np.zeros(len(state))
        step[i] = 1e-5
        above, below = (
            transition(state + sign * step, duration, 0.0, GRAVITY, LONGEST_STEP)[0] for sign in (1.0, -1.0)
        )
        # Central differences leave 1e-16 / 1e-5 of rounding and 1e-10 of curvature.
        np.testing.assert_allclose(F[:, i], (above - below) / 2e-5, rtol=0, atol=1e-8)


@settings(deadline=None, max_examples=30)
@given(first=st.floats(0.001, 0.4), second=st.floats(0.001, 0.4))
def test_propagation_composes(first, second):
    model = known(density=1e-2)
    state, covariance = np.concatenate([[5.0, 0.0, 1.1], MEAN]), np.diag(np.concatenate([np.full(3, 1e-5), SPREAD**2]))
    once = model.propagate(state, covariance, first + second)
    twice = model.propagate(*model.propagate(state, covariance, first), second)
    # The paths differ by RK4's error; the noise of a step takes its velocity for constant over at most 10 ms.
    np.testing.assert_allclose(once[0], twice[0], rtol=0, atol=1e-7)
    np.testing.assert_allclose(once[1], twice[1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("duration", [0.5 * LONGEST_STEP, 0.3, -0.1])
def test_noise_without_drag_is_that_of_a_white_acceleration(duration):
    # Q of x'' = w is density times |t|³/3, t |t|/2 and |t|: back in time, too high and too slow go together.
    density, state = 2.0, np.concatenate([[5.0, 0.0, 1.1], MEAN[:3], [0.0]])
    noise = transition(state, duration, density, GRAVITY, LONGEST_STEP)[2]
    t = abs(duration)
    expected = density * np.kron([[t**3 / 3.0, t * duration / 2.0], [t * duration / 2.0, t]], np.eye(3))
    np.testing.assert_allclose(noise[:6, :6], expected, rtol=1e-9, atol=1e-12)


def test_covariance_prediction_is_the_propagated_one():
    model = known()
    state, covariance = np.concatenate([[5.0, 0.0, 1.1], MEAN]), np.diag(np.concatenate([np.full(3, 1e-5), SPREAD**2]))
    rows = model.predict_covariance(state, covariance, 60)
    np.testing.assert_allclose(rows[-1], model.propagate(state, covariance, 60 * 0.0083)[1], rtol=1e-5, atol=1e-9)


def test_population_of_drag_and_spin_is_recovered(fitted):
    # The mean of 12 flights scatters by SPREAD / sqrt(12), and 4 sd of that are met by all seven components.
    model, starts = fitted
    sample_mean, sample_std = starts[:, 3:].mean(axis=0), starts[:, 3:].std(axis=0, ddof=1)
    assert np.all(np.abs(model.prior_mean - MEAN) < 4.0 * SPREAD / np.sqrt(12.0))
    # Against the very balls that flew there is only the noise of the fits left.
    assert np.all(np.abs(model.prior_mean - sample_mean)[:4] < [0.02, 0.02, 0.02, 0.004])
    student = np.sqrt((1.0 + 1.0 / 12.0) * 11.0 / 9.0)
    np.testing.assert_allclose(model.prior_std[:4], student * sample_std[:4], rtol=0.2)


def test_noise_of_a_right_model_is_that_of_the_cameras(fitted):
    # 12 flights of 108 samples: the root of their mean square has a relative standard deviation of 2 %.
    np.testing.assert_allclose(fitted[0].measurement_std, NOISE, rtol=0.08)


def test_right_model_chooses_the_least_process_noise(fitted):
    # Nearer to the least candidate than to the next one, 1e-3.
    assert 1e-6 <= fitted[0].acceleration_density <= np.sqrt(1e-6 * 1e-3)


def test_spin_of_a_ball_is_found_in_its_flight():
    # ω across the path is seen through ½ ω v t²: 5 mm of prior and noise at 0.9 s leave about 0.01 /s.
    rng, model = np.random.default_rng(1), known()
    flights, starts = throws(rng, 8)
    for flight, start in zip(flights, starts, strict=True):
        states, covariances = filter_flight(model, flight)
        velocity = start[3:6] / np.linalg.norm(start[3:6])
        across = np.eye(3) - np.outer(velocity, velocity)
        error, deviation = states[-1][6:] - start[6:], np.sqrt(np.diag(covariances[-1])[6:])
        assert np.all(np.abs(error) < 4.5 * deviation)
        assert np.linalg.norm(across @ error[1:]) < 0.5 * np.linalg.norm(across @ (start[7:] - MEAN[4:])) + 0.1
        assert deviation[0] < 0.5 * SPREAD[3]


@pytest.mark.parametrize("kind", ["drag", "spin"])
def test_filter_is_consistent_where_the_model_is_right(kind):
    # NEES of independent flights is χ²; the sum lies outside of the bounds once in 10,000.
    rng, count = np.random.default_rng(2), 60
    model = known(kind)
    flights, starts = throws(rng, count, spin=kind == "spin")
    final, ahead = 0.0, 0.0
    for flight, start in zip(flights, starts, strict=True):
        states, covariances = filter_flight(model, flight)
        truth = transition(start[: 3 + len(model.prior_mean)], flight.time[-1], 0.0, GRAVITY, LONGEST_STEP)[0]
        error = states[-1] - truth
        final += error @ np.linalg.solve(covariances[-1], error)
        miss, spread = prediction_errors(model, flight, 0.5, 0.1)
        ahead += miss[-1] @ np.linalg.solve(spread[-1], miss[-1])
    size = 3 + len(model.prior_mean)
    assert chi2.ppf(0.5e-4, size * count) < final < chi2.ppf(1.0 - 0.5e-4, size * count)
    assert chi2.ppf(0.5e-4, 3 * count) < ahead < chi2.ppf(1.0 - 0.5e-4, 3 * count)


def test_launch_prior_is_dropped_where_the_ball_contradicts_it():
    # A ball that flies the other way, as after a hit: the estimate is that of the samples alone.
    model = known()
    start = np.array([1.0, 0.0, 1.0, 4.0, 0.0, 3.0, 0.13, 0.3, -0.5, 0.2])
    time = np.arange(12) / RATE
    path = fly(start[:6], time, magnus(start[6], start[7:]))
    state, covariance, misfit = model.initial_state(time, path[:, :3])
    np.testing.assert_allclose(state[3:6], path[-1, 3:], atol=0.02)
    assert np.sqrt(covariance[3, 3]) > 0.02
    assert misfit < 1.0


@pytest.mark.parametrize("wider", [1.0, 3.0, 10.0])
def test_start_is_honest_about_launches_unlike_those_before(wider):
    # Six samples leave 0.06 m/s, so that launches scattered by 0.05 m/s are told by prior and samples alike. The mean
    # of 300 squares is 1 ± 0.08 if the prior is right; at no spread of the launches may the start be twice too sure.
    rng, tight = np.random.default_rng(24), np.concatenate([np.full(3, 0.05), SPREAD[3:]])
    model, square = replace(known(), prior_std=tight), []
    time = np.arange(6) / RATE
    for _ in range(100):
        latent = MEAN + tight * np.concatenate([np.full(3, wider), np.ones(4)]) * rng.standard_normal(7)
        path = fly(np.concatenate([[5.0, 0.0, 1.1], latent[:3]]), time, magnus(latent[3], latent[4:]))
        state, covariance, _ = model.initial_state(time, path[:, :3] + NOISE * rng.standard_normal((6, 3)))
        error = state[3:6] - path[-1, 3:]
        square.append(error @ np.linalg.solve(covariance[3:6, 3:6], error))
    assert np.mean(square) / 3.0 < (1.0 + 4 * 0.08 if wider == 1.0 else 2.0)


def test_ball_without_spin_is_predicted_as_if_it_were_known_to_have_none():
    # The least spread of the spin, 1e-3 /s, moves a ball of 7 m/s by 1 mm in half a second; errors add in squares.
    flights, _ = throws(np.random.default_rng(25), 20, spin=False)
    errors = {}
    for kind in ("drag", "spin"):
        model = fit_ball_model(flights[:10], BallModelConfig(kind=kind, acceleration_density=1e-6))
        ahead = [prediction_errors(model, flight, 0.5)[0] for flight in flights[10:]]
        errors[kind] = np.mean(np.linalg.norm(np.concatenate(ahead), axis=1))
    assert errors["spin"] < np.hypot(errors["drag"], 0.001)


def test_launch_prior_sharpens_the_first_estimate():
    rng, model = np.random.default_rng(3), known()
    flights, starts = throws(rng, 40)
    with_prior, without = [], []
    for flight, start in zip(flights, starts, strict=True):
        truth = transition(start, flight.time[5], 0.0, GRAVITY, LONGEST_STEP)[0]
        state, _, _ = model.initial_state(flight.time[:6], flight.position[:6])
        line = LinearBallModel(
            np.eye(6) + np.eye(6, k=3) * 0.0083,
            np.array([0, 0, -3.4e-4, 0, 0, -0.0814]),
            0.0083,
            DENSITY,
            np.full(3, NOISE),
            np.zeros(3),
        ).initial_state(flight.time[:6], flight.position[:6])[0]
        with_prior.append(np.linalg.norm((state - truth)[3:6]))
        without.append(np.linalg.norm(line[3:] - truth[3:6]))
    # Six samples alone leave 0.1 m/s per axis, a third of the spread of the launcher.
    assert np.mean(with_prior) < 0.9 * np.mean(without)


def test_offline_filter_is_the_filter_of_the_tracker():
    flight, model = throws(np.random.default_rng(4), 1)[0][0], known()
    states, covariances = filter_flight(model, flight)
    kalman = model.make_filter(states[3], covariances[3])
    for i in range(4, len(flight.time)):
        model.advance(kalman, flight.time[i] - flight.time[i - 1])
        kalman.update(flight.position[i])
    np.testing.assert_allclose(kalman.x, states[-1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(kalman.P, covariances[-1], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("kind", ["drag", "spin"])
def test_stored_model_is_restored_bit_by_bit(kind):
    model = known(kind, bias=0.001)
    restored = restore_ball_model(json.loads(json.dumps(model.to_dict())))
    state = np.concatenate([[5.0, 0.0, 1.1], model.prior_mean, np.zeros(3)])
    assert restored.to_dict() == model.to_dict()
    np.testing.assert_array_equal(restored.predict(state, 96), model.predict(state, 96))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"kind": "knuckle"}, "of kind 'knuckle', known are linear, drag, spin"),
        ({"prior_mean": [0.0] * 5}, "has 7 components"),
        ({"prior_std": [0.0] * 7}, "fit and save it again"),
        ({"measurement_std": [float("nan")] * 3}, "fit and save it again"),
    ],
)
def test_damaged_model_is_refused(damage, message):
    with pytest.raises(TableFileError, match=message) as caught:
        restore_ball_model({**known().to_dict(), **damage})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("without", ["gravity", "noise_slope", "bias_std"])
def test_model_of_an_older_version_is_refused_in_one_line(without):
    stored = known().to_dict()
    del stored[without]
    with pytest.raises(TableFileError, match=f"another version; fit and save it again: '{without}' is missing$"):
        restore_ball_model(stored)


@pytest.mark.parametrize("kind", ["drag", "spin"])
def test_tracker_follows_a_spinning_ball_through_ghosts_and_dropouts(kind):
    for seed in range(5):
        rng = np.random.default_rng(10 + seed)
        flight, start = (found[0] for found in throws(rng, 1, spin=kind == "spin"))
        tracker = BallTracker(known(kind))
        for i, (time, seen) in enumerate(zip(flight.time, flight.position, strict=True)):
            ghosts = rng.uniform([0.0, -2.0, 0.0], [6.0, 2.0, 3.0], (rng.integers(0, 3), 3))
            blind = 40 <= i < 55
            markers = ghosts if blind else rng.permutation(np.vstack([ghosts, seen]))
            estimate = tracker.update(make_frame(1_000_000 + round(1e6 * time), markers))
            if i >= 12:
                assert estimate.in_flight
                truth = transition(start, time, 0.0, GRAVITY, LONGEST_STEP)[0]
                assert np.linalg.norm(estimate.state[:3] - truth[:3]) < 0.02
        assert estimate.to_message().covariance == estimate.covariance[:6, :6].tolist()
