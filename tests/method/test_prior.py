"""Claims about a forward model that corrects what was learned on another body."""

import json
from pathlib import Path

import numpy as np
import pytest
from liberobot import MOTION
from numpy.typing import NDArray

from imolo.errors import ConfigError, TableFileError
from imolo.method.forward_model import GPR, PAPER_SVR, ForwardModel, ForwardModelConfig, TrainingData
from imolo.method.hand_uncertainty import HandUncertainty
from imolo.method.prior import MOST_SAMPLES, fit_forward_model, load_prior
from imolo.method.regressors import fit_quietly, make_regressor
from imolo.method.table import LookupTable
from imolo.method.table_grid import GridAxis, TableGrid

Array = NDArray[np.float64]

GRID = TableGrid(
    parameters={
        "k": GridAxis(start=-1.0, stop=1.0, step=0.5),
        "t_w": GridAxis(start=0.21, stop=0.41, step=0.05),
    },
    time_since_swing=GridAxis(start=0.14, stop=0.21, step=0.03),
)
SWING = ForwardModelConfig(**{**GPR.model_dump(), "parameters": {"random_state": 0}, "time": "since_swing"})


def bent(theta: Array, time: Array) -> Array:
    """A hand that waves too quickly with k and t_w for a few trials to show [m]."""
    k, t_w = theta.T
    since = time - t_w
    return np.column_stack(
        (t_w + since, 0.3 * k + 0.05 * np.sin(6.0 * k), 1.0 + 5.0 * since + 0.05 * np.sin(40.0 * t_w))
    )


def shifted(theta: Array, time: Array) -> Array:
    """The same hand on another body [m]."""
    return bent(theta, time) + np.column_stack(
        (0.02 + 0.01 * theta[:, 0], np.full(len(time), -0.015), 0.1 * (time - 0.4))
    )


def motions(count: int, seed: int) -> tuple[Array, Array]:
    """Draw motions of three samples each: theta, shape (3N, 2), and time, shape (3N,)."""
    rng = np.random.default_rng(seed)
    theta = np.repeat(np.column_stack((rng.uniform(-1.0, 1.0, count), rng.uniform(0.21, 0.41, count))), 3, axis=0)
    return theta, theta[:, 1] + np.tile((0.14, 0.17, 0.2), count)


DENSE, FEW, OTHERS = motions(60, 0), motions(8, 1), motions(60, 2)
PRIOR = ForwardModel(SWING, MOTION).fit(*DENSE, bent(*DENSE))
FEW_SAMPLES = TrainingData(*FEW, shifted(*FEW))


def error(model: ForwardModel) -> float:
    return float(np.linalg.norm(model.predict(*OTHERS) - shifted(*OTHERS), axis=1).mean())


@pytest.fixture(scope="module")
def table_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("prior") / "first.npz"
    origin = {"backend": "first", "seed": 3, "config": "abc"}
    LookupTable.build(PRIOR, GRID, np.random.default_rng(0), robot="liberobot", origin=origin).save(path)
    return path


def test_few_trials_upon_a_prior_beat_the_prior_and_the_trials_alone() -> None:
    together = error(ForwardModel(SWING, MOTION, PRIOR).fit(*FEW, shifted(*FEW)))
    assert together < 0.3 * error(PRIOR)
    assert together < 0.3 * error(ForwardModel(SWING, MOTION).fit(*FEW, shifted(*FEW)))


def test_correction_is_a_process_of_the_residuals_in_which_an_unsure_prior_is_noise() -> None:
    corrected = ForwardModel(SWING, MOTION, PRIOR).fit(*FEW, shifted(*FEW))
    residual = shifted(*FEW) - PRIOR.predict(*FEW)
    inputs, queries = (np.column_stack((theta, time - theta[:, 1])) for theta, time in (FEW, OTHERS))
    mean, spread = inputs.mean(axis=0), inputs.std(axis=0)
    of_same_motion = np.array([(FEW[0] == theta).all(axis=1).sum() for theta in FEW[0]])
    noise = np.mean((PRIOR.predict_std(*FEW) / residual.std(axis=0)) ** 2, axis=1) * of_same_motion + 1e-10
    process = make_regressor("GaussianProcessRegressor", {"random_state": 0, "alpha": noise}, 3)
    targets = (residual - residual.mean(axis=0)) / residual.std(axis=0)
    fit_quietly(process, (inputs - mean) / spread, targets, "GaussianProcessRegressor")
    expected, std = process.predict((queries - mean) / spread, return_std=True)
    expected = PRIOR.predict(*OTHERS) + expected * residual.std(axis=0) + residual.mean(axis=0)
    std = np.sqrt((std * residual.std(axis=0)) ** 2 + PRIOR.predict_std(*OTHERS) ** 2)
    np.testing.assert_allclose(corrected.predict(*OTHERS), expected, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(corrected.predict_std(*OTHERS), std, rtol=1e-6)


def test_prior_without_a_standard_deviation_can_be_corrected() -> None:
    prior = ForwardModel(PAPER_SVR, MOTION).fit(*DENSE, bent(*DENSE))
    corrected = ForwardModel(SWING, MOTION, prior).fit(*FEW, shifted(*FEW))
    assert error(corrected) < error(prior)
    assert (corrected.predict_std(*OTHERS) > 0.0).all()


def test_motions_that_are_left_out_are_predicted_upon_the_same_prior() -> None:
    corrected = HandUncertainty(ForwardModel(SWING, MOTION, PRIOR).fit(*FEW, shifted(*FEW)))
    alone = HandUncertainty(ForwardModel(SWING, MOTION).fit(*FEW, shifted(*FEW)))
    assert np.linalg.norm(corrected.floor) < 0.5 * np.linalg.norm(alone.floor)


def test_table_of_a_corrected_model_gives_the_same_model_again(table_file: Path, tmp_path: Path) -> None:
    config = SWING.model_copy(update={"prior": str(table_file)})
    model = fit_forward_model(config, FEW_SAMPLES, "liberobot", MOTION)
    assert error(model) < 0.3 * error(PRIOR)
    LookupTable.build(model, GRID, np.random.default_rng(0), robot="liberobot").save(tmp_path / "second.npz")
    again = LookupTable.load(tmp_path / "second.npz").refit()
    np.testing.assert_array_equal(again.predict(*OTHERS), model.predict(*OTHERS))


def test_prior_may_have_a_prior(table_file: Path, tmp_path: Path) -> None:
    config = SWING.model_copy(update={"prior": str(table_file)})
    model = fit_forward_model(config, FEW_SAMPLES, "liberobot", MOTION)
    LookupTable.build(model, GRID, np.random.default_rng(0), robot="liberobot").save(tmp_path / "second.npz")
    third = load_prior(tmp_path / "second.npz", "liberobot", MOTION)
    np.testing.assert_array_equal(third.predict(*OTHERS), model.predict(*OTHERS))


def test_prior_of_another_robot_is_refused(table_file: Path) -> None:
    with pytest.raises(TableFileError, match="is for robot 'liberobot', not 'other'"):
        load_prior(table_file, "other", MOTION)


def test_prior_of_other_motions_is_refused(table_file: Path) -> None:
    first, *others = MOTION.phases
    first = first.model_copy(update={"target": (0.6e5, *first.target[1:])})
    stronger = MOTION.model_copy(update={"phases": (first, *others)})
    with pytest.raises(TableFileError, match="learned in 'first', is of other motions"):
        load_prior(table_file, "liberobot", stronger)


def test_prior_that_is_not_there_is_named(tmp_path: Path) -> None:
    config = SWING.model_copy(update={"prior": str(tmp_path / "none.npz")})
    with pytest.raises(TableFileError, match=r"none\.npz cannot be read"):
        fit_forward_model(config, FEW_SAMPLES, "liberobot", MOTION)


def test_prior_of_a_config_is_never_left_out() -> None:
    with pytest.raises(ConfigError, match=r"the prior some\.npz"):
        ForwardModel(SWING.model_copy(update={"prior": "some.npz"}), MOTION)


def test_prior_is_stored_as_json() -> None:
    config = SWING.model_copy(update={"prior": "some.npz"})
    assert ForwardModelConfig.model_validate(json.loads(json.dumps(config.model_dump()))) == config


def test_prior_is_thinned_evenly() -> None:
    count = 2 * MOST_SAMPLES + 1
    data = TrainingData(np.zeros((count, 2)), np.arange(count, dtype=float), np.zeros((count, 3)))
    thin = data.thinned(MOST_SAMPLES)
    assert len(thin.time) <= MOST_SAMPLES
    assert (np.diff(thin.time) == 3.0).all()
    assert data.thinned(count).time.tolist() == data.time.tolist()
