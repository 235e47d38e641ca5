"""Tell noise that is new in each sample from errors that last, as where a tracker's calibration bends the path."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TIMES = (0.02, 0.03, 0.05, 0.1)  # [s] candidates: from a few samples to a few tenths of a flight
DEGREE = 3  # of the polynomial in time that a fit may have taken out of its residuals
PARAMETERS = 4  # variances of three axes and a time: each has to add 1 to the logarithm of the likelihood (Akaike)


@dataclass(frozen=True, eq=False)
class CorrelatedNoise:
    """White noise, and an error that decays as exp(-t / time): a first-order Gauss-Markov process.

    Attributes:
        white: Variance of the noise of each axis, shape (3,).
        lasting: Variance of the lasting error of each axis, shape (3,); 0 where there is none.
        time: Its correlation time [s].
    """

    white: Array
    lasting: Array
    time: float

    @classmethod
    def fit(cls, times: Sequence[Array], residuals: Sequence[Array]) -> "CorrelatedNoise":
        """Estimate both by restricted maximum likelihood over `TIMES`, the variances by their moments (MINQUE).

        What a polynomial could take out of the residuals is left aside, since the fit of a flight has taken it out.

        Args:
            times: Of the samples of each flight [s], shape (N,).
            residuals: Of equal variance along a flight, shape (N, 3) each.
        """
        kept = [_beyond_polynomials(time) for time in times]
        projected = [basis.T @ residual for basis, residual in zip(kept, residuals, strict=True)]
        freedom = sum(len(one) for one in projected)
        white = np.sum([np.sum(one**2, axis=0) for one in projected], axis=0) / freedom
        best = cls(white, np.zeros(3), TIMES[0])
        most = -0.5 * freedom * float(np.sum(np.log(white) + 1.0)) + PARAMETERS
        for correlation_time in TIMES:
            spectra = [
                _spectrum(basis.T @ np.exp(-np.abs(time[:, None] - time) / correlation_time) @ basis, one)
                for time, basis, one in zip(times, kept, projected, strict=True)
            ]
            gain = np.concatenate([one[0] for one in spectra])
            square = np.concatenate([one[1] for one in spectra])
            found = _moments(gain, square, white)
            variance = found[0] + gain[:, None] * found[1]
            likelihood = -0.5 * float(np.sum(np.log(variance) + square / variance))
            if likelihood > most:
                most, best = likelihood, cls(found[0], found[1], correlation_time)
        return best


def _beyond_polynomials(time: Array) -> Array:
    """Return an orthonormal basis of what no polynomial in time can follow, shape (N, N - DEGREE - 1)."""
    elapsed = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
    basis = np.linalg.qr(np.vander(elapsed, DEGREE + 1), mode="complete")[0]
    return np.asarray(basis[:, DEGREE + 1 :])


def _spectrum(correlation: Array, residual: Array) -> tuple[Array, Array]:
    """Return the eigenvalues of a correlation, shape (N,), and the squares of the residuals along them, (N, 3)."""
    gain, direction = np.linalg.eigh(correlation)
    return np.maximum(gain, 0.0), (direction.T @ residual) ** 2


def _moments(gain: Array, square: Array, white: Array) -> tuple[Array, Array]:
    """Return white and lasting variances, shape (3,) each, whose expected squares match in sum and weighted sum."""
    normal = np.array([[len(gain), gain.sum()], [gain.sum(), gain @ gain]])
    alone, lasting = np.linalg.solve(normal, np.array([square.sum(axis=0), gain @ square]))
    # A white part of nothing would leave a filter without noise; a lasting one of less than nothing is none.
    alone = np.where(lasting > 0.0, np.maximum(alone, 0.01 * white), white)
    return alone, np.maximum(lasting, 0.0)
