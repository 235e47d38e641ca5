"""Learn what flights are like - noise, gravity, drag, lift and release - from recorded ones (empirical Bayes)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imolo.ball.aerodynamic import (
    STATE_SIZE,
    UNKNOWN_VELOCITY,
    AerodynamicBallModel,
    AerodynamicKind,
    most_likely_start,
)
from imolo.ball.aerodynamic_kernel import normal_equations
from imolo.ball.correlated_noise import CorrelatedNoise
from imolo.ball.flight import GRAVITY, LEAST_NOISE, Flight
from imolo.ball.model import BallModelConfig

Array = NDArray[np.float64]

# Before anything is known of the ball: an air-filled beach ball has k = 1 /m; a table-tennis ball at 150 turns per
# second, about the most a player gives it, has ω = 3 /s.
VAGUE_DRAG, VAGUE_LIFT = 1.0, 3.0  # standard deviations [1/m], [1/s]
# Its buoyancy and the air that goes along with it take 2 % from the fall of a table-tennis ball and 7 % from that of a
# foam ball; a frame tilted by 2° has 0.3 m/s² along an axis that should be level.
VAGUE_GRAVITY = 0.3  # standard deviation [m/s²]
CONSTANT = 1e-3  # [m/s²] spread of gravity over flights: next to none
# No two flights agree (assumed). An ω of 1e-3 /s moves a ball of 7 m/s by 1 mm in half a second, so that balls
# without spin are followed as by "drag".
LEAST_SPREAD = np.array([0.02, 0.02, 0.02, 1e-3, 1e-3, 1e-3, 1e-3])  # [m/s], [1/m], [1/s]
ITERATIONS = 4  # of Gauss-Newton on a whole flight; one more changes nothing that a camera could see
EM_STEPS = 100  # the means settle within ten
LEAST_SQUARE = 1e-3  # of normalised residuals: below it one of 30,000 with three axes
TYPICAL_NOISE = 1e-3  # [m] weighs measurements against the vague prior, which hardly counts


@dataclass(frozen=True, eq=False)
class _Linearised:
    """One flight about its own best fit.

    Attributes:
        state: At its first sample and gravity, shape (n + 3,).
        information: About them from each axis at unit noise, shape (3, n + 3, n + 3).
        gradient: Of the same, shape (3, n + 3).
        residuals: Of the positions [m], shape (N, 3).
    """

    state: Array
    information: Array
    gradient: Array
    residuals: Array

    def evidence(self, std: Array) -> tuple[Array, Array]:
        """Return what the flight says of velocity of release, k, ω and gravity, the position marginalised.

        Args:
            std: Standard deviation of a measured coordinate [m], shape (3,).

        Returns:
            Information, shape (n, n), which may be singular; information times estimate, shape (n,).
        """
        information = np.tensordot(std**-2.0, self.information, 1)
        projection = std**-2.0 @ self.gradient + information @ self.state
        elimination = np.linalg.solve(information[:3, :3], information[:3, 3:]).T
        return (
            information[3:, 3:] - elimination @ information[:3, 3:],
            projection[3:] - elimination @ projection[:3],
        )


class AerodynamicFit:
    """Fits the model to sets of flights; each flight is linearised once, whatever sets it is in."""

    def __init__(self, kind: AerodynamicKind, flights: Sequence[Flight], config: BallModelConfig) -> None:
        size = STATE_SIZE[kind] - 3
        self._kind = kind
        self._config = config
        self._vague_std = np.array([UNKNOWN_VELOCITY] * 3 + [VAGUE_DRAG] + [VAGUE_LIFT] * 3)[:size]
        self._least = LEAST_SPREAD[:size]
        self._known = {id(flight): (flight, self._linearise(flight)) for flight in flights}
        self._shares = self._correlate(flights)

    def __call__(self, flights: Sequence[Flight]) -> AerodynamicBallModel:
        """Fit noise and priors to some of the flights; the process noise is left at the first candidate.

        The measurement noise is the deviation of whole flights from the equation of motion, whatever its cause. What of
        it is white and what lasts, as where a tracker's calibration bends the path, is told from all flights.
        """
        linearised = [self._known[id(flight)][1] for flight in flights]
        std = _std([one.residuals for one in linearised])
        mean, variance = self._population([one.evidence(std) for one in linearised])
        size = len(self._least)
        noise = _Noise.fit([flight.position for flight in flights], [one.residuals / std for one in linearised])
        return AerodynamicBallModel(
            kind=self._kind,
            time_step=self._config.time_step,
            acceleration_density=self._config.acceleration_density or self._config.density_grid[0],
            measurement_std=np.maximum(noise.factor * std * np.sqrt(self._shares.white), LEAST_NOISE),
            prior_mean=mean[:size],
            prior_std=np.maximum(np.sqrt(variance[:size] * _unseen(len(flights))), self._least),
            gravity=mean[size:],
            noise_center=noise.center,
            noise_slope=noise.slope,
            noise_reach=noise.reach,
            bias_std=noise.factor * std * np.sqrt(self._shares.lasting),
            bias_time=self._shares.time,
        )

    def _linearise(self, flight: Flight) -> _Linearised:
        mean, std = np.zeros_like(self._vague_std), np.full(3, TYPICAL_NOISE)
        state, _, _ = most_likely_start(flight.time, flight.position, std, mean, self._vague_std, GRAVITY, ITERATIONS)
        equations = normal_equations(state, flight.time, flight.position, GRAVITY)
        return _Linearised(np.concatenate([state, GRAVITY]), *equations)

    def _correlate(self, flights: Sequence[Flight]) -> CorrelatedNoise:
        """Return which shares of the variance of a measured position are white and lasting."""
        residuals = [self._known[id(flight)][1].residuals for flight in flights]
        std = _std(residuals)
        unit = [one / std for one in residuals]
        noise = _Noise.fit([flight.position for flight in flights], unit)
        even = [one / noise.at(flight.position)[:, None] for one, flight in zip(unit, flights, strict=True)]
        found = CorrelatedNoise.fit([flight.time for flight in flights], even)
        return found if found.lasting.any() else CorrelatedNoise(np.ones(3), found.lasting, found.time)

    def _population(self, evidence: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
        """Return mean and variance over flights, shape (n,) each, gravity last, by expectation maximisation.

        A flight that says little of a component, as of the spin along its path, does not count for it.
        """
        information = np.array([one[0] for one in evidence])
        projection = np.array([one[1] for one in evidence])
        count, least = len(evidence), np.append(0.1 * self._least, [CONSTANT] * 3)
        vague = np.append(self._vague_std, [VAGUE_GRAVITY] * 3) ** -2.0
        expected = vague * np.append(np.zeros_like(self._least), GRAVITY)
        variance = np.append(self._vague_std, [CONSTANT] * 3) ** 2
        for _ in range(EM_STEPS):
            prior = np.diag(1.0 / variance)
            covariance = np.linalg.inv(information + prior)
            # The mean is the generalised least squares one: that of EM creeps where there is next to no spread.
            pull = prior @ covariance
            weight = count * prior - (pull @ prior).sum(axis=0) + np.diag(vague)
            mean = np.linalg.solve(weight, np.einsum("nij,nj->i", pull, projection) + expected)
            each = np.einsum("nij,nj->ni", covariance, projection + prior @ mean)
            spread = np.sum((each - mean) ** 2, axis=0) / (count - 1) if count > 1 else np.zeros_like(mean)
            variance = np.maximum(spread + np.einsum("nii->i", covariance) / count, least**2)
            variance[-3:] = CONSTANT**2
        return mean, variance


@dataclass(frozen=True, eq=False)
class _Noise:
    """How the noise changes along the flights, as with the distance from the cameras; see `AerodynamicBallModel`.

    Attributes:
        factor: Noise at the center over that of all samples [-].
    """

    factor: float
    center: Array
    slope: Array
    reach: float

    @classmethod
    def fit(cls, positions: Sequence[Array], residuals: Sequence[Array]) -> "_Noise":
        """Fit it to the squares of residuals at unit noise, shape (N, 3) each, along the way that the flights go."""
        from sklearn.linear_model import GammaRegressor

        position = np.concatenate(positions)
        center = position.mean(axis=0)
        direction = np.linalg.svd(position - center, full_matrices=False)[2][0]
        way = (position - center) @ direction
        square = np.maximum(np.mean(np.concatenate(residuals) ** 2, axis=1), LEAST_SQUARE)
        fitted = GammaRegressor(alpha=0.0, solver="newton-cholesky").fit(way[:, None], square)
        change = float(fitted.coef_[0])
        return cls(
            factor=float(np.exp(0.5 * fitted.intercept_)),
            center=center,
            slope=change * direction,
            reach=float(np.abs(change * way).max()),
        )

    def at(self, position: Array) -> Array:
        """Return the noise at positions [m], shape (N, 3), over that of all samples, shape (N,)."""
        return np.asarray(self.factor * np.exp(0.5 * (position - self.center) @ self.slope))


def _std(residuals: Sequence[Array]) -> Array:
    """Return the standard deviation of a measured coordinate [m], shape (3,)."""
    squares = sum(np.sum(one**2, axis=0) for one in residuals)
    # Each axis has given two numbers of every flight to its start.
    freedom = sum(len(one) - 2.0 for one in residuals)
    return np.asarray(np.maximum(np.sqrt(squares / freedom), LEAST_NOISE))


def _unseen(count: int) -> float:
    """Return how much wider the next flight scatters than `count` known ones: the variance of Student's t.

    With three flights and fewer it has none; the factor then says that next to nothing is known.
    """
    freedom = count - 1
    return (1.0 + 1.0 / count) * freedom / max(freedom - 2.0, 0.25)
