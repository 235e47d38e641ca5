import json
from dataclasses import replace

import numpy as np
import pytest
from ball_flights import GRAVITY, RATE, drag, fly, record, release
from hypothesis import given, settings
from hypothesis import strategies as st

from imolo.ball.fit import fit_ball_model
from imolo.ball.flight import Flight, free_flight
from imolo.ball.linear import LinearBallModel, exponential
from imolo.ball.model import BallModelConfig
from imolo.ball.prediction import filter_flight, prediction_errors
from imolo.errors import TableFileError, TrainingDataError

NOISE = 0.002  # [m]
DIAGONAL = np.diag([-1.3, -0.8, -0.9])
COUPLED = np.array([[-1.4, 0.1, -0.4], [0.0, -0.8, 0.1], [-0.5, 0.0, -0.9]])
CONSTANT = np.array([-2.0, 0.1, -9.9])


def linear(rates):
    return lambda velocity: rates @ velocity + CONSTANT


def euler(rates, time_step, substeps=20_000):
    """A and B of v̇ = C v + d by many small steps; the error is of the order of time_step² / substeps."""
    small, dt = np.eye(7), time_step / substeps
    small[:3, 3:6], small[3:6, 3:6], small[3:6, 6] = dt * np.eye(3), np.eye(3) + dt * rates, dt * CONSTANT
    whole = np.linalg.matrix_power(small, substeps)
    return whole[:6, :6], whole[:6, 6]


def ballistic(model):
    """The same model without drag: p' = p + Δt v + ½ Δt² g, v' = v + Δt g."""
    dt = model.time_step
    A = np.eye(6)
    A[:3, 3:] = dt * np.eye(3)
    return replace(model, A=A, B=np.concatenate([0.5 * dt**2 * GRAVITY, dt * GRAVITY]))


@pytest.fixture(scope="module")
def flights():
    return record(np.random.default_rng(0), count=10, noise=NOISE, missing=0.03)


@pytest.fixture(scope="module")
def model(flights):
    return fit_ball_model(flights)


@pytest.mark.parametrize(("structure", "rates"), [("diagonal", DIAGONAL), ("full", DIAGONAL), ("full", COUPLED)])
def test_linear_system_is_recovered_without_noise(structure, rates):
    throws = record(np.random.default_rng(1), 4, noise=0.0, acceleration=linear(rates), missing=0.2)
    config = BallModelConfig(structure=structure, acceleration_density=1e-3)
    fitted = fit_ball_model(throws, config)
    A, B = euler(rates, config.time_step)
    np.testing.assert_allclose(fitted.A, A, rtol=0, atol=1e-6)
    np.testing.assert_allclose(fitted.B, B, rtol=0, atol=1e-6)


def test_coupled_axes_choose_the_full_structure():
    throws = record(np.random.default_rng(2), 4, noise=NOISE, acceleration=linear(COUPLED))
    assert fit_ball_model(throws, BallModelConfig(density_grid=(1e-3, 1e-2))).structure == "full"


def test_reported_error_is_that_of_leave_one_out_by_hand(flights):
    few = flights[:4]
    fixed = BallModelConfig(structure="diagonal", acceleration_density=3e-3)
    folds = [fit_ball_model([f for f in few if f is not left_out], fixed) for left_out in few]
    reported = fit_ball_model(few, fixed).errors
    assert [error.horizon for error in reported] == [0.25, 0.50, 0.75]
    for error in reported:
        by_hand, at_end = [], []
        for fold, left_out in zip(folds, few, strict=True):
            states, time = filter_flight(fold, left_out)[0], left_out.time
            for target, measured in zip(time, left_out.position, strict=True):
                latest = target - error.horizon + 1e-6
                if latest >= time[0] + fixed.settling_time:
                    k = np.flatnonzero(time <= latest)[-1]
                    A, B, _ = fold.transition(target - time[k])
                    by_hand.append(np.linalg.norm((A @ states[k] + B)[:3] - measured))
            at_end.append(by_hand[-1])
        assert error.count == len(by_hand)
        assert error.mean == pytest.approx(np.mean(by_hand), rel=1e-9)
        assert error.std == pytest.approx(np.std(by_hand), rel=1e-9)
        assert error.mean_at_end == pytest.approx(np.mean(at_end), rel=1e-9)


def test_measurement_noise_is_told_from_the_misfit_of_the_model(flights, model):
    # A variance from n differences of neighbours has a relative standard deviation of sqrt(3 / n), its root half that.
    count = sum(len(flight.time) for flight in flights)
    np.testing.assert_allclose(model.measurement_std, NOISE, rtol=5 * 0.5 * np.sqrt(3.0 / count))
    assert model.residual_rms[0] > 2.0 * NOISE


def test_linear_model_halves_the_error_of_a_drag_free_prediction(model):
    unseen = record(np.random.default_rng(3), 5, noise=NOISE)
    error, without_drag = (
        np.mean([np.linalg.norm(prediction_errors(m, f, 0.50)[0], axis=1).mean() for f in unseen])
        for m in (model, ballistic(model))
    )
    assert error < 0.5 * without_drag


def test_covariance_of_predictions_covers_their_errors(model):
    # The misfit is no white noise, so the mean square of 3 normalised errors is 3 only within a small factor.
    unseen = record(np.random.default_rng(4), 10, noise=NOISE)
    squares = []
    for flight in unseen:
        error, covariance = prediction_errors(model, flight, 0.50)
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error).mean())
    assert 3.0 / 3.0 < np.mean(squares) < 3.0 * 3.0


def test_fit_is_deterministic(flights):
    config = BallModelConfig(density_grid=(1e-3, 1e-2))
    assert fit_ball_model(flights[:4], config).to_dict() == fit_ball_model(flights[:4], config).to_dict()


@settings(deadline=None)
@given(steps=st.integers(1, 300), seed=st.integers(0, 2**32 - 1))
def test_prediction_is_the_iterated_model(model, steps, seed):
    state = np.random.default_rng(seed).uniform(-8.0, 8.0, 6)
    predicted = model.predict(state, steps)
    assert predicted.shape == (steps, 6)
    iterated = []
    for _ in range(steps):
        state = model.A @ state + model.B
        iterated.append(state)
    np.testing.assert_allclose(predicted, iterated, rtol=0, atol=1e-11)


def test_covariance_prediction_is_the_iterated_one(model):
    covariance = np.diag([1e-6, 2e-6, 3e-6, 1e-3, 2e-3, 3e-3])
    noise = model.transition(model.time_step)[2]
    predicted = model.predict_covariance(np.zeros(6), covariance, 90)
    for row in predicted:
        covariance = model.A @ covariance @ model.A.T + noise
        np.testing.assert_allclose(row, covariance, rtol=1e-9, atol=1e-15)


@settings(deadline=None)
@given(first=st.integers(-100_000, 750_000), second=st.integers(-100_000, 750_000))
def test_transitions_compose(model, first, second):
    (A1, B1, _), (A2, B2, _) = model.transition(first * 1e-6), model.transition(second * 1e-6)
    A, B, _ = model.transition((first + second) * 1e-6)
    np.testing.assert_allclose(A2 @ A1, A, rtol=0, atol=1e-11)
    np.testing.assert_allclose(A2 @ B1 + B2, B, rtol=0, atol=1e-11)


def test_transition_over_a_time_step_is_the_model(model):
    A, B, _ = model.transition(model.time_step)
    np.testing.assert_allclose(A, model.A, rtol=0, atol=1e-12)
    np.testing.assert_allclose(B, model.B, rtol=0, atol=1e-12)


@pytest.mark.parametrize("x", [-0.5, -0.1, 0.1, 0.25, 0.5])
def test_exponential_is_right_to_the_last_bits(x):
    # Fourteen terms leave 0.5^15 / 15! = 2e-17; thirteen would leave three roundings, more change nothing.
    assert exponential(np.array([[x]]))[0, 0] == pytest.approx(np.exp(x), rel=1.5 * np.finfo(float).eps, abs=0.0)


@pytest.mark.parametrize("x", [-20.0, -3.0, 0.51, 0.75, 1.0, 3.0, 20.0])
def test_exponential_of_a_large_argument_loses_a_bit_with_every_halving(x):
    # Squaring doubles the relative error; the argument is halved to one half at most.
    bound = 2.0 * np.finfo(float).eps * 2.0 * abs(x) * 2.0
    assert exponential(np.array([[x]]))[0, 0] == pytest.approx(np.exp(x), rel=bound, abs=0.0)


@pytest.mark.parametrize(
    ("away", "accepted"), [(0.49, True), (-0.49, True), (0.5, False), (0.51, False), (-0.51, False)]
)
def test_step_is_taken_for_smooth_within_one_half_of_one(away, accepted):
    # There the logarithm's series of 60 terms is right to 0.49^61 / 61; both must give the step back.
    A, rest = np.eye(6), (np.zeros(6), 0.0083, 1e-3, np.full(3, NOISE), np.zeros(3))
    A[5, 5] += away
    if accepted:
        np.testing.assert_allclose(LinearBallModel(A, *rest).transition(0.0083)[0], A, rtol=0, atol=1e-14)
    else:
        with pytest.raises(TrainingDataError, match=f"{abs(away):.3g} away from 1"):
            LinearBallModel(A, *rest)


def test_stored_model_is_restored_bit_by_bit(model):
    restored = LinearBallModel.from_dict(json.loads(json.dumps(model.to_dict())))
    assert restored.to_dict() == model.to_dict()
    state = np.array([5.0, 0.1, 1.1, -5.0, 0.2, 4.0])
    np.testing.assert_array_equal(restored.predict(state, 120), model.predict(state, 120))


@pytest.mark.parametrize(
    "damage",
    [{"A": [[1.0]]}, {"A": np.zeros((6, 6)).tolist()}, {"time_step": float("nan")}, {"B": [1.0] * 5}, {"drag": 0.1}],
)
def test_damaged_model_is_refused(model, damage):
    with pytest.raises(TableFileError, match="fit and save it again") as caught:
        LinearBallModel.from_dict({**model.to_dict(), **damage})
    assert "\n" not in str(caught.value)


def changed(flight, index, value):
    position = flight.position.copy()
    position[index, 1] = value
    return Flight(flight.time, position)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: f[:2], "2 flights are too few"),
        (lambda f: [f[0], changed(f[1], 7, np.nan), f[2]], "flight 1 has values that are not finite"),
        (lambda f: [f[0], f[1], Flight(f[2].time[:8], f[2].position[:8])], "flight 2 is too short: 8 samples"),
        (lambda f: [f[0], Flight(f[1].time[::-1], f[1].position), f[2]], "time of flight 1 does not increase"),
        (lambda f: [Flight(f[0].time, f[0].position[:-1]), *f[1:3]], "flight 0 has time"),
    ],
)
def test_unusable_flights_are_named(flights, spoil, message):
    with pytest.raises(TrainingDataError, match=message):
        fit_ball_model(spoil(flights))


def track(rng, noise, ending, rest=60, missing=0.05):
    """A ball that rests in the thrower's hand, flies for 0.9 s and then meets something; times of its free flight."""
    start = release(rng)
    flight = fly(start, np.arange(0.0, 0.9, 1.0 / RATE))
    after = flight[-1] * np.concatenate([np.ones(3), {"bounce": [0.6, 0.6, -0.6], "hit": [-0.5, 0.8, 0.3]}[ending]])
    onwards = fly(after, np.arange(0.0, 0.35, 1.0 / RATE))[1:]
    position = np.concatenate([np.tile(start[:3], (rest, 1)), flight[:, :3], onwards[:, :3]])
    time = np.arange(len(position)) / RATE
    seen = rng.random(len(time)) >= missing
    noisy = position + noise * rng.standard_normal(position.shape)
    return time[seen], noisy[seen], (time[rest], time[rest + len(flight) - 1])


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.002])
@pytest.mark.parametrize("ending", ["bounce", "hit"])
def test_free_flight_lies_between_release_and_contact(noise, ending):
    for seed in range(5):
        time, position, (released, contact) = track(np.random.default_rng(seed), noise, ending)
        flight = free_flight(time, position)
        assert released <= flight.time[0] < released + 0.1
        assert contact - 0.1 < flight.time[-1] <= contact


def test_ball_at_rest_has_no_free_flight():
    position = np.array([5.0, 0.0, 1.1]) + NOISE * np.random.default_rng(0).standard_normal((200, 3))
    with pytest.raises(TrainingDataError, match="no free flight"):
        free_flight(np.arange(200) / RATE, position)


def test_drag_of_the_test_ball_is_that_of_the_foam_ball():
    assert drag(np.array([-8.0, 0.0, 0.0]))[0] == pytest.approx(
        0.5 * 1.2 * 0.45 * np.pi * 0.045**2 * 64.0 / 0.010, rel=2e-3
    )
