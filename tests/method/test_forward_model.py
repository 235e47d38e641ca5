"""Claims about the forward model s = f(theta, t)."""

import logging
from itertools import product
from typing import Literal

import numpy as np
import pytest
from liberobot import MOTION, TRAINING_MOTIONS
from numpy.typing import NDArray
from pydantic import ValidationError
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.svm import SVR

from imolo.errors import ConfigError, NotTrainedError, TrainingDataError
from imolo.method.forward_model import GPR, MLP, PAPER_SVR, ForwardModel, ForwardModelConfig, TrainingData
from imolo.method.regressors import fit_quietly, make_regressor, set_noise

Array = NDArray[np.float64]
NOISE = 0.003  # [m]


def hand(theta: Array, time: Array) -> Array:
    """A swing of 14 rad/s about a shoulder that flies forward and up; k leads it sideways."""
    k, t_w = theta.T
    angle = 14.0 * (time - t_w) + 0.3 * k * t_w
    return np.column_stack((1.1 * time + 0.3 * np.sin(angle), 0.35 * k * time, 1.0 + 0.5 * time - 0.4 * np.cos(angle)))


def paper_samples(noise: float = NOISE) -> TrainingData:
    """The hand in the frames of Sec. VII-B: 15 motions, 120 Hz, 0.13 s < t - t_w < 0.22 s."""
    frames = np.arange(0.0, 1.2, 1.0 / 120.0)
    theta = np.repeat(TRAINING_MOTIONS, len(frames), axis=0)
    time = np.tile(frames, len(TRAINING_MOTIONS))
    seen = (time - theta[:, 1] > 0.13) & (time - theta[:, 1] < 0.22)
    theta, time = theta[seen], time[seen]
    return TrainingData(theta, time, hand(theta, time) + np.random.default_rng(0).normal(0.0, noise, (len(time), 3)))


SAMPLES = paper_samples()


def fitted(config: ForwardModelConfig, samples: TrainingData = SAMPLES) -> ForwardModel:
    return ForwardModel(config, MOTION).fit(samples.theta, samples.time, samples.position)


def queries(count: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    theta = np.column_stack((rng.uniform(-1.0, 1.0, count), rng.uniform(0.21, 0.41, count)))
    return theta, theta[:, 1] + rng.uniform(0.14, 0.21, count)


def root_mean_square(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def standardized(values: Array, like: Array) -> Array:
    return (values - like.mean(axis=0)) / like.std(axis=0)


def test_default_is_the_support_vector_regression_of_the_paper() -> None:
    theta, time = queries(5000)
    inputs = np.column_stack((SAMPLES.theta, SAMPLES.time))
    model = fitted(ForwardModelConfig())
    for axis in range(3):
        reference = SVR(C=0.1427, epsilon=0.0143, gamma=1.0).fit(inputs, SAMPLES.position[:, axis])
        expected = reference.predict(np.column_stack((theta, time)))
        np.testing.assert_allclose(model.predict(theta, time)[:, axis], expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("parameters", [{"gamma": 2.5, "C": 10.0, "epsilon": 0.001}, {"gamma": "scale"}])
def test_other_support_vector_machines_predict_as_scikit_learn_does(parameters: dict[str, float | str]) -> None:
    theta, time = queries(3000)
    inputs, outputs = np.column_stack((SAMPLES.theta, SAMPLES.time)), SAMPLES.position
    reference = make_regressor("SVR", parameters, 3).fit(inputs, outputs)
    predicted = fitted(ForwardModelConfig(estimator="SVR", parameters=parameters)).predict(theta, time)
    np.testing.assert_allclose(predicted, reference.predict(np.column_stack((theta, time))), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("kernel", ["rbf", "matern"])
def test_gaussian_process_predicts_as_scikit_learn_does(kernel: Literal["rbf", "matern"]) -> None:
    theta, time = queries(3000)
    inputs, outputs = np.column_stack((SAMPLES.theta, SAMPLES.time)), SAMPLES.position
    reference = make_regressor(GPR.estimator, GPR.parameters, 3, kernel)
    samples = standardized(inputs, inputs), standardized(outputs, outputs)
    set_noise(reference, np.full(len(inputs), reference.alpha), *samples)  # that both find the same kernel
    fit_quietly(reference, *samples, GPR.estimator)
    predicted = standardized(fitted(GPR.model_copy(update={"kernel": kernel})).predict(theta, time), outputs)
    expected = reference.predict(standardized(np.column_stack((theta, time)), inputs))
    # Both round each of the summed terms and each exponent, some ten times.
    rounding = 10.0 * np.finfo(float).eps * reference.kernel_.k1.k1.constant_value
    for axis in range(3):
        bound = rounding * np.abs(reference.alpha_[:, axis]).sum()
        np.testing.assert_allclose(predicted[:, axis], expected[:, axis], rtol=0.0, atol=bound)


@pytest.mark.parametrize("slowest", [0, 1])
def test_motions_of_a_grid_are_predicted_as_each_one_alone(slowest: int) -> None:
    values = [np.linspace(-1.0, 1.0, 5), np.linspace(0.25, 0.35, 4)]
    rows = np.array(list(product(values[slowest], values[1 - slowest], (0.15, 0.2))))
    theta, time = rows[:, [slowest, 1 - slowest]], rows[:, 1 - slowest] + rows[:, 2]
    model = fitted(PAPER_SVR)
    single = np.concatenate([model.predict(theta[[row]], time[[row]]) for row in range(len(rows))])
    np.testing.assert_allclose(model.predict(theta, time), single, rtol=0.0, atol=1e-12)


def test_gaussian_process_predicts_a_smooth_motion_better_than_it_was_measured() -> None:
    theta, time = queries(2000)
    assert root_mean_square(fitted(GPR).predict(theta, time) - hand(theta, time)) < NOISE


def test_neural_network_predicts_a_smooth_motion_about_as_well_as_it_was_measured() -> None:
    theta, time = queries(2000)
    assert root_mean_square(fitted(MLP).predict(theta, time) - hand(theta, time)) < 2.0 * NOISE


def test_process_is_unsure_where_nothing_was_tried_and_knows_the_noise_where_it_was() -> None:
    model = fitted(GPR)
    near = model.predict_std(SAMPLES.theta, SAMPLES.time)
    far = model.predict_std([[3.0, 0.9]], [1.6])
    assert near.shape == (len(SAMPLES.time), 3)
    assert 0.8 * NOISE < np.median(near) < 1.5 * NOISE
    assert (far > 3.0 * near.max(axis=0)).all()


def test_regression_without_standard_deviation_is_named() -> None:
    with pytest.raises(ConfigError, match="SVR predicts no standard deviation"):
        fitted(PAPER_SVR).predict_std(SAMPLES.theta, SAMPLES.time)


@pytest.mark.parametrize(
    "name", ["KNeighborsRegressor", "LinearRegression", "MultiTaskLasso", "NuSVR", "BayesianRidge"]
)
def test_any_regressor_of_scikit_learn_can_be_named(name: str) -> None:
    theta, time = queries(10)
    predicted = fitted(ForwardModelConfig(estimator=name)).predict(theta, time)
    assert predicted.shape == (10, 3)
    assert np.isfinite(predicted).all()


@pytest.mark.parametrize("config", [PAPER_SVR, GPR, MLP])
def test_time_since_the_swing_is_the_third_input_less_t_w(config: ForwardModelConfig) -> None:
    theta, time = queries(50)
    since_swing = fitted(config.model_copy(update={"time": "since_swing"}))
    moved = TrainingData(SAMPLES.theta, SAMPLES.time - SAMPLES.theta[:, 1], SAMPLES.position)
    expected = fitted(config, moved).predict(theta, time - theta[:, 1])
    np.testing.assert_array_equal(since_swing.predict(theta, time), expected)


@pytest.mark.parametrize("config", [PAPER_SVR, GPR, MLP])
def test_same_samples_give_the_same_model(config: ForwardModelConfig) -> None:
    theta, time = queries(50)
    model = fitted(config)
    first = model.predict(theta, time)
    np.testing.assert_array_equal(first, fitted(config).predict(theta, time))
    model.fit(SAMPLES.theta, SAMPLES.time, SAMPLES.position)
    np.testing.assert_array_equal(first, model.predict(theta, time))


def test_samples_that_all_lie_in_the_tube_give_a_constant() -> None:
    position = np.tile([0.4, 0.0, 1.2], (len(SAMPLES.time), 1))
    predicted = fitted(PAPER_SVR, TrainingData(SAMPLES.theta, SAMPLES.time, position)).predict(*queries(5))
    np.testing.assert_allclose(predicted, position[:5], rtol=0.0, atol=0.0143)


@pytest.mark.parametrize("config", [GPR, MLP])
def test_one_sample_is_enough(config: ForwardModelConfig) -> None:
    model = ForwardModel(config, MOTION).fit([[0.0, 0.3]], [0.45], [[0.4, 0.0, 1.2]])
    np.testing.assert_allclose(model.predict([[0.0, 0.3]], [0.45]), [[0.4, 0.0, 1.2]], atol=1e-3)


@pytest.mark.parametrize(
    ("theta", "time", "position", "named"),
    [
        (np.empty((0, 2)), np.empty(0), np.empty((0, 3)), "no training samples"),
        (np.zeros((2, 2)), np.zeros(3), np.zeros((2, 3)), "time has 3 samples, theta 2"),
        (np.zeros((2, 3)), np.zeros(2), np.zeros((2, 3)), r"theta has shape \(2, 3\); give \(N, 2\)"),
        (np.zeros(2), np.zeros(2), np.zeros((2, 3)), r"theta has shape \(2,\); give \(N, n\)"),
        (np.zeros((2, 2)), np.zeros(2), np.zeros((2, 2)), r"position has shape \(2, 2\); give \(N, 3\)"),
        (np.zeros((2, 2)), np.zeros((2, 1)), np.zeros((2, 3)), r"time has shape \(2, 1\); give \(N,\)"),
        (np.zeros((2, 2)), np.zeros(2), np.array([[0.0, 0.0, 0.0], [0.0, np.nan, 0.0]]), "position of sample 1"),
        (np.array([[0.0, np.inf]]), np.zeros(1), np.zeros((1, 3)), "theta of sample 0"),
    ],
)
def test_useless_training_data_is_named(theta: Array, time: Array, position: Array, named: str) -> None:
    with pytest.raises(TrainingDataError, match=named):
        ForwardModel(PAPER_SVR, MOTION).fit(theta, time, position)


def test_predicting_before_fitting_is_an_error() -> None:
    for method in (ForwardModel(PAPER_SVR, MOTION).predict, ForwardModel(GPR, MOTION).predict_std):
        with pytest.raises(NotTrainedError, match="call fit first"):
            method([[0.0, 0.3]], [0.4])


@pytest.mark.parametrize(
    ("config", "named"),
    [
        ({"estimator": "SVM"}, "unknown estimator 'SVM'; did you mean 'SVR'"),
        ({"estimator": "SVR", "parameters": {"epsilom": 1.0}}, "no parameter 'epsilom'; did you mean 'epsilon'"),
        ({"estimator": "StackingRegressor"}, "wraps other estimators"),
        ({"estimator": "SVR", "parameters": {"C": -1.0}}, "SVR cannot be fitted"),
        ({"estimator": "KNeighborsRegressor", "parameters": {"n_neighbors": 500}}, "to 163 samples"),
    ],
)
def test_impossible_configuration_is_named(config: dict[str, object], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        fitted(ForwardModelConfig.model_validate(config))


@pytest.mark.parametrize("change", [{"kernal": "rbf"}, {"kernel": "linear"}, {"inputs": "normal"}, {"time": "now"}])
def test_unknown_key_or_option_is_refused(change: dict[str, str]) -> None:
    with pytest.raises(ValidationError):
        ForwardModelConfig.model_validate(change)


@pytest.mark.parametrize("config", [PAPER_SVR, GPR, MLP, ForwardModelConfig(estimator="LinearRegression")])
def test_configuration_survives_json(config: ForwardModelConfig) -> None:
    assert ForwardModelConfig.model_validate_json(config.model_dump_json()) == config


def test_another_estimator_does_not_inherit_the_parameters_of_the_paper() -> None:
    assert ForwardModelConfig(estimator="LinearRegression").parameters == {}
    assert ForwardModelConfig(inputs="standardized").parameters == PAPER_SVR.parameters


def test_fit_that_stops_early_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, logger="imolo"):
        fitted(MLP.model_copy(update={"parameters": {**MLP.parameters, "max_iter": 1}}))
    assert "fit of MLPRegressor" in caplog.text


def test_noise_that_is_not_there_is_nothing_to_warn_of(caplog: pytest.LogCaptureFixture) -> None:
    x = np.linspace(0.0, 6.0, 30)[:, np.newaxis]
    regressor = GaussianProcessRegressor(RBF() + WhiteKernel(1.0, (0.1, 10.0)))
    with caplog.at_level(logging.INFO, logger="imolo"):
        fit_quietly(regressor, x, np.sin(x), "GaussianProcessRegressor")
    assert "close to the specified lower bound" in caplog.text
    assert all(record.levelno == logging.INFO for record in caplog.records)


def test_training_data_cannot_be_changed_from_outside() -> None:
    theta = np.array([[0.0, 0.3]])
    samples = TrainingData(theta, np.array([0.4]), np.zeros((1, 3)))
    theta[0, 0] = 1.0
    assert samples.theta[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        samples.time[0] = 0.0
