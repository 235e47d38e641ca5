"""The flying ball under gravity, quadratic drag and Magnus lift, followed by an extended Kalman filter.

    ṗ = v,   v̇ = g - k |v| v + ω × v,   k̇ = 0,   ω̇ = 0

k = ρ c_D A / (2 m) [1/m] is the drag of the ball; ω [1/s] is its spin times a lift coefficient over its mass, so that
ω × v is the Magnus acceleration (Zhang, Xiong, Zhao and Chen, 2010, for table tennis). Both are unknown in each flight
and part of the state. What the training flights were like is the prior, of the velocity of release with a spread that
is widened until the first samples agree with it. g is what all flights have in common: the air carries a light ball
and goes along with it, and no camera frame is level.

What the cameras see is not quite where the ball is: their calibration bends the path, so that neighbouring samples err
alike. A filter that took such errors for independent would know v, k and ω too well and follow the bend. So the error
b of the cameras is part of the state too, a first-order Gauss-Markov process (Brown and Hwang's coloured noise), and
p is the position as they see it, which is what is measured, predicted and hit:

    ṗ = v + ḃ,   ḃ = -b / τ + white noise
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from imolo.ball.aerodynamic_kernel import (
    LONGEST_STEP,
    filter_step,
    fly,
    noise_at,
    normal_equations,
    position_covariances,
    seen_transition,
    transition,
)
from imolo.ball.flight import GRAVITY
from imolo.ball.model import DAMAGED, ON, BallFilter, PredictionError, chi_square_quantile, kalman_filter
from imolo.config.model import Model, NonNegative, Positive, Vector
from imolo.config.reading import explain
from imolo.errors import TableFileError

Array = NDArray[np.float64]
AerodynamicKind = Literal["drag", "spin"]

STATE_SIZE: dict[AerodynamicKind, int] = {"drag": 7, "spin": 10}
UNKNOWN_VELOCITY = 30.0  # [m/s] standard deviation without a launch prior, assumed: faster than any throw
ITERATIONS = 2  # of Gauss-Newton on the first samples; a third changes nothing that a camera could see
_ARRAYS = ("measurement_std", "prior_mean", "prior_std", "gravity", "noise_center", "noise_slope", "bias_std")
MOST_DOUBLINGS = 20
DOUBLINGS = 4.0 ** np.arange(MOST_DOUBLINGS + 1)[:, np.newaxis, np.newaxis]  # of a standard deviation
LAUNCH_PROBABILITY = 0.95  # of a release as those before it not to widen its prior


@dataclass(frozen=True, eq=False)
class AerodynamicBallModel:
    """The equation of motion above, with noise and priors.

    Attributes:
        kind: "drag" has the state (p, v, k), "spin" (p, v, k, ω); b follows unless `bias_std` is 0.
        time_step: Step of `predict` [s].
        acceleration_density: Process noise, spectral density of a white acceleration [m²/s³].
        measurement_std: Standard deviation of the white noise of a coordinate at `noise_center` [m], shape (3,).
        prior_mean: Of velocity of release [m/s], k [1/m] and perhaps ω [1/s], shape (4,) or (7,).
        prior_std: Their standard deviations for the next flight, of the same shape.
        gravity: What accelerates every flight alike [m/s²], shape (3,).
        noise_center: A position among the flights [m], shape (3,).
        noise_slope: Change of the logarithm of the variances of noise and b with the position [1/m], shape (3,).
        noise_reach: Largest such change that the flights have shown [-].
        bias_std: Standard deviation of b at `noise_center` [m], shape (3,).
        bias_time: Its correlation time τ [s].
        errors: Leave-one-out prediction errors; empty for a model that was not fitted.
    """

    kind: AerodynamicKind
    time_step: float
    acceleration_density: float
    measurement_std: Array
    prior_mean: Array
    prior_std: Array
    gravity: Array = field(default_factory=GRAVITY.copy)
    noise_center: Array = field(default_factory=lambda: np.zeros(3))
    noise_slope: Array = field(default_factory=lambda: np.zeros(3))
    noise_reach: float = 0.0
    bias_std: Array = field(default_factory=lambda: np.zeros(3))
    bias_time: float = 1.0
    errors: tuple[PredictionError, ...] = ()

    def with_density(self, density: float) -> "AerodynamicBallModel":
        """Return the same model with another process noise [m²/s³]."""
        return replace(self, acceleration_density=density)

    def measurement_covariance(self, position: Array) -> Array:
        """Return the covariance of a position [m], shape (3,), that is measured there [m²], shape (3, 3)."""
        return np.diag(self.measurement_std**2 * self._noise_at(position))

    def _noise_at(self, position: Array) -> float:
        """Return the variance of noise and b at a position [m], shape (3,), over that at `noise_center`."""
        at: float = noise_at(position, self.noise_center, self.noise_slope, self.noise_reach)
        return at

    def _transition(self, state: Array, duration: float) -> tuple[Array, Array, Array]:
        """Return the state `duration` [s] later, its sensitivity to the old one, and the covariance that is new."""
        bias_variance = self.bias_std**2 * self._noise_at(state[:3])
        density, gravity = self.acceleration_density, self.gravity
        # Always with the same kinds of arguments: each other one would be compiled for seconds.
        later, F, Q = seen_transition(
            state, float(duration), density, gravity, bias_variance, self.bias_time, LONGEST_STEP
        )
        return later, F, Q

    def initial_state(self, time: Array, position: Array) -> tuple[Array, Array, float]:
        """Estimate the state at the last of a few samples: maximum a posteriori, by Gauss-Newton.

        Args:
            time: Time of the samples [s], shape (N,), N >= 2.
            position: Measured positions [m], shape (N, 3).

        Returns:
            State, shape (n,); its covariance, shape (n, n); sum of the squared normalised residuals, which is
            χ² distributed with 3N - 6 degrees of freedom if the samples are of a free flight.
        """
        spread = self.prior_std.copy()
        spread[:3] = UNKNOWN_VELOCITY
        mean = self.prior_mean.copy()
        mean[:3] = 0.0
        bias_variance = self.bias_std**2 * self._noise_at(position[-1])
        std = np.sqrt(np.diag(self.measurement_covariance(position[-1])) + bias_variance)
        state, covariance, residuals = most_likely_start(time, position, std, mean, spread, self.gravity)
        misfit = float(np.sum((residuals / std) ** 2))
        state, covariance = self._with_launch_prior(state, covariance)
        last, F, Q = transition(state, float(time[-1] - time[0]), self.acceleration_density, self.gravity, LONGEST_STEP)
        covariance = F @ covariance @ F.T + Q
        if self.bias_std.any():
            # A few samples tell where the ball is seen; of b they tell nothing.
            last = np.append(last, np.zeros(3))
            covariance = np.pad(covariance, (0, 3))
            covariance[-3:, -3:] = np.diag(bias_variance)
        return last, covariance, misfit

    def _with_launch_prior(self, state: Array, covariance: Array) -> tuple[Array, Array]:
        """Fuse a start with the velocity of release, whose spread is doubled until the two agree."""
        difference = self.prior_mean[:3] - state[3:6]
        prior = np.diag(self.prior_std[:3] ** 2)
        # All doublings at once: one after the other they take a third of a decision's time.
        solved = np.linalg.solve(covariance[3:6, 3:6] + DOUBLINGS * prior, difference[:, np.newaxis])
        contradicted = solved[..., 0] @ difference > chi_square_quantile(LAUNCH_PROBABILITY, 3)
        prior *= DOUBLINGS[min(int(np.count_nonzero(contradicted)), MOST_DOUBLINGS)]
        gain = np.linalg.solve(covariance[3:6, 3:6] + prior, covariance[3:6]).T
        return state + gain @ difference, covariance - gain @ covariance[3:6]

    def make_filter(self, state: Array, covariance: Array) -> BallFilter:
        """Return a Kalman filter that starts from a state, shape (n,), and its covariance.

        Positions are measured linearly, so that an extended filter differs from it in `advance` alone.
        """
        return kalman_filter(state, covariance, self.measurement_covariance(state[:3]))

    def advance(self, kalman: BallFilter, duration: float) -> None:
        """Let a filter predict `duration` [s] ahead, with the model linearised about its state."""
        F, Q, offset, kalman.R = filter_step(
            *(kalman.x, float(duration), self.acceleration_density, self.gravity, self.measurement_std),
            *(self.bias_std, self.bias_time, self.noise_center, self.noise_slope, self.noise_reach),
        )
        kalman.predict(u=ON, B=offset, F=F, Q=Q)

    def propagate(self, state: Array, covariance: Array, duration: float) -> tuple[Array, Array]:
        """Return state, shape (n,), and covariance, shape (n, n), `duration` [s] later."""
        later, F, Q = self._transition(state, duration)
        return later, F @ covariance @ F.T + Q

    def predict(self, state: Array, steps: int) -> Array:
        """Return the states 1, 2, ... `steps` time steps later, shape (steps, n)."""
        size = STATE_SIZE[self.kind]
        path: Array = fly(state[:size], self.time_step, steps, self.gravity)
        if len(state) == size:
            return path
        fade = np.exp(-self.time_step / self.bias_time * np.arange(1, steps + 1))[:, None]
        path[:, :3] += (fade - 1.0) * state[size:]
        return np.hstack([path, fade * state[size:]])

    def predict_covariance(self, state: Array, covariance: Array, steps: int) -> Array:
        """Return the covariances that belong to `predict`, shape (steps, n, n)."""
        predicted = np.empty((steps, *covariance.shape))
        for i in range(steps):
            state, covariance = self.propagate(state, covariance, self.time_step)
            predicted[i] = covariance
        return predicted

    def position_covariance(self, state: Array, covariance: Array, steps: int) -> Array:
        """Return the covariances of the positions of `predict` [m²], shape (steps, 3, 3), in a tenth of the time."""
        bias_variance = self.bias_std**2 * self._noise_at(state[:3])
        density, gravity = self.acceleration_density, self.gravity
        predicted: Array = position_covariances(
            state, covariance, self.time_step, steps, density, gravity, bias_variance, self.bias_time
        )
        return predicted

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain numbers and lists, fit for JSON; `from_dict` restores it bit by bit."""
        values = {name: getattr(self, name) for name in _StoredModel.model_fields}
        plain = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
        return _StoredModel.model_validate(plain).model_dump(mode="json")

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> "AerodynamicBallModel":
        """Restore a model from `to_dict`.

        Raises:
            TableFileError: A key is missing or unknown, or a value has the wrong shape or is not finite.
        """
        try:
            values = _StoredModel.model_validate(stored)
        except ValidationError as error:
            raise TableFileError(explain(error, _StoredModel, DAMAGED)) from error
        size = STATE_SIZE[values.kind] - 3
        if not len(values.prior_mean) == len(values.prior_std) == size:
            raise TableFileError(f"{DAMAGED}: a prior of kind {values.kind!r} has {size} components")
        fields = {name: getattr(values, name) for name in _StoredModel.model_fields}
        numbers = {name: np.array(value) for name, value in fields.items() if name in _ARRAYS}
        return cls(**{**fields, **numbers})


def most_likely_start(
    time: Array,
    position: Array,
    measurement_std: Array,
    prior_mean: Array,
    prior_std: Array,
    gravity: Array,
    iterations: int = ITERATIONS,
) -> tuple[Array, Array, Array]:
    """Estimate the state at the first sample of a flight, maximum a posteriori, by Gauss-Newton.

    Args:
        time: [s], shape (N,), N >= 2.
        position: Measured [m], shape (N, 3).
        measurement_std: Of a coordinate [m], shape (3,).
        prior_mean: Of velocity, k and perhaps ω, shape (n - 3,).
        prior_std: Their standard deviations, shape (n - 3,); the position has no prior.
        gravity: [m/s²], shape (3,).
        iterations: Of Gauss-Newton.

    Returns:
        State, shape (n,); its covariance, shape (n, n); residuals [m], shape (N, 3).
    """
    elapsed = time - time[0]
    fall = np.outer(0.5 * elapsed**2, gravity)
    line = np.linalg.lstsq(np.stack([np.ones_like(elapsed), elapsed], axis=1), position - fall, rcond=None)[0]
    state = np.concatenate([line[0], line[1], prior_mean[3:]])
    weight = np.concatenate([np.zeros(3), prior_std**-2.0])
    mean, precision = np.concatenate([np.zeros(3), prior_mean]), measurement_std**-2.0
    size, known = len(state), np.diag(weight)

    def information(by_axis: Array) -> Any:
        of_samples = precision[np.newaxis] @ by_axis[:, :size, :size].reshape(3, -1)  # what follows is of gravity
        return of_samples.reshape(size, size) + known

    for _ in range(iterations):
        by_axis, gradient, _ = normal_equations(state, time, position, gravity)
        change = precision @ gradient[:, :size] + weight * (mean - state)
        state = state + np.linalg.solve(information(by_axis), change)
    by_axis, _, residuals = normal_equations(state, time, position, gravity)
    return state, np.linalg.inv(information(by_axis)), residuals


class _StoredModel(Model):
    """The form of a stored model."""

    kind: AerodynamicKind
    time_step: Positive
    acceleration_density: Positive
    measurement_std: tuple[Positive, Positive, Positive]
    prior_mean: Annotated[tuple[float, ...], Field(min_length=4)]
    prior_std: Annotated[tuple[Positive, ...], Field(min_length=4)]
    gravity: Vector
    noise_center: Vector
    noise_slope: Vector
    noise_reach: NonNegative
    bias_std: tuple[NonNegative, NonNegative, NonNegative]
    bias_time: Positive
    errors: tuple[PredictionError, ...]
