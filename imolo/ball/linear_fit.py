"""Fit the linear ball model to recorded throws (paper Sec. V-C)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import factorial

from imolo.ball.flight import LEAST_NOISE, Flight
from imolo.ball.linear import LinearBallModel, Structure, exponential
from imolo.ball.model import BallModelConfig

Array = NDArray[np.float64]

SERIES_TERMS = 40  # of exp(C t) in the fit; at a rate of 10 /s exact to 1e-9 m over 1 s
SHRINKAGE = 1e-4  # [m·s] keeps rates near zero that two or three flights say nothing of; well below 1 mm otherwise


def fit_linear(flights: Sequence[Flight], structure: Structure, config: BallModelConfig) -> LinearBallModel:
    """Fit A, B and the measurement noise; the process noise is left at the first candidate.

    Raises:
        TrainingDataError: The samples are so noisy that the step from one to the next is not that of a smooth motion.
    """
    trajectories = _TrajectoryFit(flights)
    rates = _whole_flights(trajectories, structure)
    constant, errors = trajectories.solve(rates)
    generator = np.zeros((7, 7))
    generator[:3, 3:6], generator[3:6, 3:6], generator[3:6, 6] = np.eye(3), rates, constant
    affine = exponential(generator * config.time_step)
    return LinearBallModel(
        A=affine[:6, :6],
        B=affine[:6, 6],
        time_step=config.time_step,
        acceleration_density=config.acceleration_density or config.density_grid[0],
        measurement_std=noise_of(errors),
        residual_rms=np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)),
        structure=structure,
    )


def _whole_flights(trajectories: "_TrajectoryFit", structure: Structure) -> Array:
    """Return the rates C [1/s], shape (3, 3), of v̇ = C v + d that whole flights fit best."""
    from scipy.optimize import least_squares

    entries = np.diag_indices(3) if structure == "diagonal" else np.indices((3, 3)).reshape(2, 9)

    def rates(parameters: Array) -> Array:
        matrix = np.zeros((3, 3))
        matrix[entries[0], entries[1]] = parameters
        return matrix

    def residuals(parameters: Array) -> Array:
        misfit = np.concatenate(trajectories.solve(rates(parameters))[1]).ravel()
        return np.concatenate((misfit, SHRINKAGE * parameters))

    solution = least_squares(residuals, np.zeros(len(entries[0])), method="lm", xtol=1e-12)
    return rates(solution.x)


class _TrajectoryFit:
    """Least squares of whole trajectories, whose initial states are eliminated (variable projection).

    The motion v̇ = C v + d has p(t) = p0 + S(t) v0 + G(t) d with S = ∫ exp(C t) dt and G = ∫ S dt: linear in all but
    the velocity rates C. Velocities are never differenced: 2 mm of noise at 120 Hz would make them 0.3 m/s uncertain.
    """

    def __init__(self, flights: Sequence[Flight]) -> None:
        order = np.arange(1, SERIES_TERMS + 1)
        elapsed = [(flight.time - flight.time[0])[:, None] for flight in flights]
        self.velocity_series = [t**order / factorial(order) for t in elapsed]
        self.constant_series = [t ** (order + 1) / factorial(order + 1) for t in elapsed]
        self.positions = [flight.position.ravel() for flight in flights]

    def solve(self, rates: Array) -> tuple[Array, list[Array]]:
        """Return the best d [m/s²], shape (3,), for the rates C [1/s], shape (3, 3), and residuals [m], (N, 3) each."""
        powers = [np.eye(3)]
        while len(powers) < SERIES_TERMS:
            powers.append(powers[-1] @ rates)
        stack = np.reshape(powers, (SERIES_TERMS, 9))
        columns, targets = [], []
        for first, second, position in zip(self.velocity_series, self.constant_series, self.positions, strict=True):
            own = np.hstack([np.tile(np.eye(3), (len(first), 1)), (first @ stack).reshape(-1, 3)])
            basis, _ = np.linalg.qr(own)
            shared = (second @ stack).reshape(-1, 3)
            columns.append(shared - basis @ (basis.T @ shared))
            targets.append(position - basis @ (basis.T @ position))
        # Sums over flights: BLAS would share one large product among threads, which is slow on a busy machine.
        pairs = list(zip(columns, targets, strict=True))
        normal, right = sum(c.T @ c for c in columns), sum(c.T @ t for c, t in pairs)
        constant = np.linalg.lstsq(normal, right, rcond=None)[0]
        return constant, [(t - c @ constant).reshape(-1, 3) for c, t in pairs]


def noise_of(residuals: Sequence[Array]) -> Array:
    """Return the measurement noise [m], shape (3,), from the differences of successive residuals, (N, 3) each.

    The misfit of a model hardly changes from sample to sample, so the differences are free of it.
    """
    differences = np.concatenate([np.diff(residual, axis=0) for residual in residuals])
    noise: Array = np.maximum(np.sqrt(np.mean(differences**2, axis=0) / 2.0), LEAST_NOISE)
    return noise
