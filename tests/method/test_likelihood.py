"""The search for a kernel is scikit-learn's, with a likelihood of our own."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from imolo.method.likelihood import LikelihoodSearch
from imolo.method.regressors import PROCESS, make_regressor, set_noise

Array = NDArray[np.float64]
KERNELS = ["rbf", "matern"]
EPSILON = np.finfo(np.float64).eps


def samples() -> tuple[Array, Array]:
    """Return inputs and two outputs of a smooth motion with some noise."""
    rng = np.random.default_rng(0)
    inputs = rng.normal(size=(40, 3))
    smooth = np.column_stack((np.sin(inputs[:, 0] + inputs[:, 2]), inputs[:, 1] ** 2))
    return inputs, smooth + 0.05 * rng.normal(size=smooth.shape)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("noise", [1e-10, np.linspace(0.0, 0.1, 40)])
def test_the_likelihood_and_its_slope_are_scikit_learns(kernel: str, noise: float | Array) -> None:
    inputs, targets = samples()
    process = make_regressor(PROCESS, {"optimizer": None, "alpha": noise}, 3, kernel).fit(inputs, targets)
    search = LikelihoodSearch(inputs, targets, np.asarray(noise), kernel == "matern")
    for logarithms in np.random.default_rng(1).uniform(-1.0, 1.0, (5, 5)):
        value, slope = process.log_marginal_likelihood(logarithms, eval_gradient=True)
        unlikelihood, gradient = search.unlikelihood(logarithms)
        # Rounding grows with the condition of the covariance, at most its trace over the least noise asked here.
        rounding = EPSILON * 40 * np.exp(logarithms[0] - logarithms[-1]) * 40
        assert unlikelihood == pytest.approx(-value, rel=rounding)
        np.testing.assert_allclose(gradient, -slope, rtol=0.0, atol=rounding * np.abs(slope).max())


@pytest.mark.filterwarnings("ignore:The optimal value found:sklearn.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_process_is_fitted_with_the_kernel_that_scikit_learn_finds(kernel: str) -> None:
    inputs, targets = samples()
    ours, theirs = (make_regressor(PROCESS, {"n_restarts_optimizer": 2, "random_state": 0}, 3, kernel) for _ in "ab")
    set_noise(ours, np.full(40, ours.alpha), inputs, targets)
    ours.fit(inputs, targets)
    theirs.fit(inputs, targets)
    # Both stop where a step gains less than 2.2e-9 of the likelihood (SciPy's `ftol`), near the same maximum.
    found, likelihood = ours.kernel_.theta, theirs.log_marginal_likelihood_value_
    assert theirs.log_marginal_likelihood(found) == pytest.approx(likelihood, rel=1e-8)


def test_a_covariance_that_is_not_one_is_unlikely() -> None:
    inputs, targets = samples()
    value, slope = LikelihoodSearch(inputs, targets, np.array(-10.0), matern=False).unlikelihood(np.zeros(5))
    assert value == math.inf
    assert not slope.any()
