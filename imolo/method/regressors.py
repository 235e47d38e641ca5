"""Any scikit-learn regressor by name, and a fast evaluation of those that sum kernels."""

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from imolo.errors import ConfigError, did_you_mean
from imolo.method.likelihood import LikelihoodSearch

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

# scikit-learn is imported by what fits: a planner, which has a table, does without. All of it takes seconds, so that
# these are not looked for.
PROCESS = "GaussianProcessRegressor"
USUAL = {"SVR": "sklearn.svm", PROCESS: "sklearn.gaussian_process", "MLPRegressor": "sklearn.neural_network"}

AT_A_BOUND = "is close to the specified"  # in scikit-learn's words for a kernel's parameter
CHUNK = 512  # points: a chunk times 161 centres is .7 MB and stays in the cache of a core


@cache
def _libraries() -> ThreadpoolController:
    # It knows those alone that are loaded when it is made.
    import sklearn.utils  # noqa: F401

    return ThreadpoolController()


def one_thread() -> Any:
    """Return a context in which BLAS and OpenMP use one thread, and so sum in the same order everywhere.

    Products this small lose more to the threads than they gain: six times on a busy machine.
    """
    return _libraries().limit(limits=1)


def _regressor_class(name: str) -> type[Any]:
    if name in USUAL:
        return getattr(import_module(USUAL[name]), name)  # type: ignore[no-any-return]
    from sklearn.utils import all_estimators

    classes: dict[str, type[Any]] = dict(all_estimators(type_filter="regressor"))
    if name not in classes:
        raise ConfigError(
            f"unknown estimator {name!r}{did_you_mean(name, classes)}; give the class name of a scikit-learn regressor"
        )
    return classes[name]


def make_regressor(name: str, parameters: Mapping[str, Any], num_inputs: int, kernel: str = "rbf") -> Any:
    """Create an unfitted regressor of several outputs: one estimator per output where the class has but one.

    A Gaussian process gets one length scale per input, a signal and a noise variance, common to all outputs: 15 trials
    are too few to tell three sets of them apart, and the error between the trials is a third smaller.

    Args:
        name: Class name in scikit-learn.
        parameters: Its constructor's arguments.
        num_inputs: Number of inputs.
        kernel: Of a Gaussian process: "rbf", or "matern" for Matérn 3/2.

    Raises:
        ConfigError: There is no such regressor, or it has no such parameter.
    """
    from sklearn.multioutput import MultiOutputRegressor
    from sklearn.utils import get_tags

    try:
        estimator = _regressor_class(name)()
    except TypeError as error:
        raise ConfigError(f"estimator {name} wraps other estimators; give a regressor that stands alone") from error
    known = estimator.get_params()
    for parameter in parameters:
        if parameter not in known:
            raise ConfigError(f"estimator {name} has no parameter {parameter!r}{did_you_mean(parameter, known)}")
    if name == PROCESS:
        estimator.set_params(kernel=_one_length_scale_per_input(num_inputs, kernel))
    estimator.set_params(**parameters)
    return estimator if get_tags(estimator).target_tags.multi_output else MultiOutputRegressor(estimator)


def _one_length_scale_per_input(num_inputs: int, kernel: str) -> Any:
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

    # For standardised inputs and outputs: from a tenth of the spread of the data to nearly constant.
    signal = ConstantKernel(1.0, (1e-3, 1e4))
    scales = np.ones(num_inputs), (1e-1, 1e3)
    shape = Matern(*scales, nu=1.5) if kernel == "matern" else RBF(*scales)
    noise = WhiteKernel(1e-3, (1e-8, 1.0))
    return signal * shape + noise


def set_noise(process: Any, noise: Array, inputs: Array, outputs: Array) -> None:
    """Tell a Gaussian process what noise is known of the samples that it is to be fitted to, and how to search.

    Args:
        process: From `make_regressor`.
        noise: Variance, shape (N,).
        inputs: Shape (N, D).
        outputs: Shape (N, O).
    """
    process.set_params(alpha=noise)
    if process.optimizer is not None and not process.normalize_y:
        process.set_params(optimizer=LikelihoodSearch(inputs, outputs, noise, _is_matern(process.kernel)))


def fit_quietly(regressor: Any, inputs: Array, outputs: Array, name: str) -> None:
    """Fit a regressor and log that an optimizer stopped early, rather than warn.

    Args:
        regressor: From `make_regressor`.
        inputs: Shape (N, D).
        outputs: Shape (N, O).
        name: Class name, for the messages.

    Raises:
        ConfigError: scikit-learn refuses a parameter or the number of samples.
    """
    from sklearn.exceptions import ConvergenceWarning

    with one_thread(), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConvergenceWarning)
        try:
            regressor.fit(inputs, outputs)
            regressor.predict(inputs[:1])  # some find too few samples only here
        except (ValueError, TypeError) as error:
            reason = " ".join(str(error).split())
            raise ConfigError(f"estimator {name} cannot be fitted to {len(inputs)} samples: {reason}") from error
    for warning in caught:
        text = " ".join(str(warning.message).split())
        # Where nothing is disturbed there is no noise to be found, and its least value is the right one.
        logger.log(logging.INFO if AT_A_BOUND in text else logging.WARNING, "fit of %s: %s", name, text)


@contextmanager
def quiet_fits() -> Iterator[None]:
    """Log nothing of fits: hundreds to motions without noise find next to none, and rightly so."""
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


@dataclass(frozen=True)
class KernelSum:
    """Outputs that are sums of one kernel about centres: offset + sum_j weight_j K(|(x - centre_j) scale|²).

    scikit-learn's own SVR.predict takes ten times as long for the same numbers.

    Attributes:
        centre: Shape (M, D).
        scale: Shape (D,).
        weight: Shape (M, O).
        offset: Shape (O,).
        matern: Whether K(d²) is (1 + d) exp(-d), Matérn 3/2, rather than the Gaussian exp(-d²).
    """

    centre: Array
    scale: Array
    weight: Array
    offset: Array
    matern: bool = False

    def evaluate(self, inputs: Array) -> Array:
        """Return the outputs, shape (N, O), at inputs, shape (N, D)."""
        grid = None if self.matern else _grid_over_first_input(inputs)
        if grid is None:
            parts = [self._kernel(inputs[part]) @ self.weight for part in chunks(len(inputs))]
            return np.concatenate(parts) + self.offset
        # A Gaussian of all inputs is one of the first times one of the others, of each of which there are few.
        slow, values, fast = grid.shape[:3]
        first = self._kernel(grid[0, :, 0], slice(1))
        others = self._kernel(grid[:, 0].reshape(slow * fast, -1), slice(1, None))
        sums = np.stack([(first * weight) @ others.T for weight in self.weight.T], axis=-1)
        return sums.reshape(values, slow, fast, -1).swapaxes(0, 1).reshape(len(inputs), -1) + self.offset

    def _kernel(self, inputs: Array, columns: slice = slice(None)) -> Array:
        # |a - b|² = |a|² - 2 a.b + |b|² lets BLAS do the work; subtracting the mean keeps the cancellation small.
        mean, scale = self.centre[:, columns].mean(axis=0), self.scale[columns]
        a, b = ((points[:, columns] - mean) * scale for points in (inputs, self.centre))
        ones, others = np.ones((len(a), 1)), np.ones((len(b), 1))
        left = np.hstack((a, np.einsum("nd,nd->n", a, a)[:, None], ones))
        square: Array = left @ np.hstack((-2.0 * b, others, np.einsum("md,md->m", b, b)[:, None])).T
        if not self.matern:
            np.negative(square, out=square)
            np.exp(square, out=square)
            return square
        distance = np.sqrt(np.maximum(square, 0.0, out=square), out=square)
        result: Array = np.exp(-distance)
        distance += 1.0
        result *= distance
        return result


def _grid_over_first_input(inputs: Array) -> Array | None:
    """Return inputs, shape (N, D), as they vary slower than, with, and faster than the first of them: (A, B, C, D).

    None where they are no grid of the first and the others.
    """
    changed = inputs[:, 0] != inputs[0, 0]
    fast = int(np.argmax(changed)) or len(inputs)
    period = fast + int(np.argmin(np.append(changed[fast:], False)))
    if len(inputs) % period or period % fast or period == fast:
        return None
    grid = inputs.reshape(-1, period // fast, fast, inputs.shape[1])
    first, others = grid[..., 0], grid[..., 1:]
    return grid if (first == first[:1, :, :1]).all() and (others == others[:, :1]).all() else None


def chunks(count: int) -> Iterator[slice]:
    """Return slices that cover `count` rows."""
    return (slice(start, start + CHUNK) for start in range(0, count, CHUNK))


def kernel_sum(regressor: Any, inputs: Array) -> KernelSum | None:
    """Return a fitted regressor as a sum of kernels, or None where it is none.

    Args:
        regressor: From `make_regressor`, fitted.
        inputs: The inputs it was fitted to, shape (N, D).
    """
    from sklearn.multioutput import MultiOutputRegressor

    # JSON has no kernels, so the kernel of a configured process is the one made here.
    if type(regressor).__name__ == PROCESS and not regressor.normalize_y:
        signal, shape = regressor.kernel_.k1.k1, regressor.kernel_.k1.k2
        matern = _is_matern(regressor.kernel_)
        return KernelSum(
            centre=inputs,
            scale=np.sqrt(3.0 if matern else 0.5) / shape.length_scale,
            weight=signal.constant_value * regressor.alpha_,
            offset=np.zeros(regressor.alpha_.shape[1]),
            matern=matern,
        )
    estimators = getattr(regressor, "estimators_", None)
    if not isinstance(regressor, MultiOutputRegressor) or not estimators:
        return None
    if not all(_has_numeric_rbf(estimator) for estimator in estimators):
        return None
    weight = np.zeros((len(inputs), len(estimators)))
    for output, estimator in enumerate(estimators):
        weight[estimator.support_, output] = estimator.dual_coef_[0]
    used = np.flatnonzero(np.abs(weight).sum(axis=1))
    if len(used) == 0:  # every sample lies inside the epsilon tube: a constant
        used = np.array([0])
    return KernelSum(
        centre=inputs[used],
        scale=np.full(inputs.shape[1], np.sqrt(estimators[0].gamma)),
        weight=weight[used],
        offset=np.array([estimator.intercept_[0] for estimator in estimators]),
    )


def _is_matern(kernel: Any) -> bool:
    return type(kernel.k1.k2).__name__ == "Matern"  # as `make_regressor` makes it


def _has_numeric_rbf(estimator: Any) -> bool:
    return (
        type(estimator).__name__ in ("SVR", "NuSVR")
        and estimator.kernel == "rbf"
        and isinstance(estimator.gamma, float | int)
    )
