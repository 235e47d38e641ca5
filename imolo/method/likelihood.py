"""The kernel under which samples are likeliest, searched for as scikit-learn does, in a quarter of the time."""

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LikelihoodSearch:
    """An `optimizer` of scikit-learn's Gaussian process, for the kernel that `make_regressor` gives it.

    Its own likelihood builds the derivatives of the kernel part by part.

    Attributes:
        inputs: Shape (N, D).
        targets: Shape (N, O).
        noise: Variance that is known of each sample, shape (N,) or ().
        matern: Whether the kernel is Matérn 3/2 rather than Gaussian.
    """

    inputs: Array
    targets: Array
    noise: Array
    matern: bool

    def __call__(self, _: Any, start: Array, bounds: Array) -> tuple[Array, float]:
        """Return the logarithms of variance, length scales and noise that are likeliest, and minus that likelihood.

        Args:
            _: The likelihood of scikit-learn, which says the same.
            start: Where to begin, shape (D + 2,).
            bounds: Shape (D + 2, 2).
        """
        from scipy.optimize import minimize
        from sklearn.exceptions import ConvergenceWarning

        found = minimize(self.unlikelihood, start, method="L-BFGS-B", jac=True, bounds=bounds)
        if not found.success:
            warnings.warn(f"search for a kernel: {found.message}", ConvergenceWarning, stacklevel=2)
        return found.x, found.fun

    @cached_property
    def _squares(self) -> Array:
        """How far apart the inputs are along each axis, squared, shape (D, N, N)."""
        squares: Array = (self.inputs.T[:, :, np.newaxis] - self.inputs.T[:, np.newaxis]) ** 2
        return squares

    def unlikelihood(self, logarithms: Array) -> tuple[float, Array]:
        """Return minus the log marginal likelihood (Rasmussen & Williams 2006, Eqs. 2.30 and 5.9) and its gradient.

        Args:
            logarithms: Of variance, length scales and noise, shape (D + 2,).
        """
        from scipy.linalg import LinAlgError, cholesky, lapack

        variance, *lengths, noise = np.exp(logarithms)
        samples, outputs = self.targets.shape
        shrink = 1.0 / np.square(lengths)
        square = np.tensordot(shrink, self._squares, 1)
        if self.matern:
            distance = np.sqrt(3.0 * square)
            kernel = variance * np.exp(-distance)
            slope = 3.0 * kernel
            kernel += distance * kernel
        else:
            slope = kernel = variance * np.exp(-0.5 * square)
        covariance = kernel + np.diag(np.broadcast_to(noise + self.noise, samples))
        try:
            lower = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError:
            return math.inf, np.zeros_like(logarithms)
        inverse, _ = lapack.dpotri(lower, lower=1)
        inverse += np.tril(inverse, -1).T
        weight = inverse @ self.targets
        volume = outputs * np.log(np.diag(lower)).sum()
        value = 0.5 * np.vdot(self.targets, weight) + volume + 0.5 * samples * outputs * math.log(math.tau)
        change = outputs * inverse - weight @ weight.T
        along = shrink * np.tensordot(self._squares, change * slope, 2)
        gradient = 0.5 * np.array([np.vdot(change, kernel), *along, noise * np.trace(change)])
        return value, gradient
