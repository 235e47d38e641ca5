"""The linear model of the flying ball, x(t + Δt) = A x(t) + B (paper Sec. V-C)."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from imolo.ball.model import DAMAGED, ON, BallFilter, Kind, PredictionError, kalman_filter, white_acceleration
from imolo.config.model import Model, NonNegative, Positive
from imolo.config.reading import explain
from imolo.errors import TableFileError, TrainingDataError

Array = NDArray[np.float64]
Structure = Literal["diagonal", "full"]
_State = Annotated[tuple[float, ...], Field(min_length=6, max_length=6)]


@dataclass(frozen=True, eq=False)
class LinearBallModel:
    """x(t + Δt) = A x(t) + B with its noise, x = (position [m], velocity [m/s]) (Sec. V-C).

    Times that are no multiple of Δt are served by the one continuous system ẋ = F x + g that passes through the same
    states: the logarithm of A and B. It makes 120 Hz frames (8.333 ms), lost frames and Δt = 8.3 ms agree exactly.

    Attributes:
        A: State transition over `time_step`, shape (6, 6).
        B: Offset over `time_step` [m, m/s], shape (6,).
        time_step: Δt [s].
        acceleration_density: Process noise, spectral density of a white acceleration [m²/s³].
        measurement_std: Standard deviation of a measured coordinate [m], shape (3,).
        residual_rms: Deviation of the throws from whole fitted ones per axis: noise and misfit [m], shape (3,).
        structure: Structure of the fitted velocity rates.
        errors: Leave-one-out prediction errors; empty for a model that was not fitted.

    Raises:
        TrainingDataError: A is no step of a smooth motion: an eigenvalue is not near 1.
    """

    kind: ClassVar[Kind] = "linear"

    A: Array
    B: Array
    time_step: float
    acceleration_density: float
    measurement_std: Array
    residual_rms: Array
    structure: Structure = "full"
    errors: tuple[PredictionError, ...] = ()
    _generator: Array = field(init=False, repr=False)
    _affine: dict[int, Array] = field(init=False, repr=False, default_factory=dict)
    _transitions: dict[int, tuple[Array, Array, Array]] = field(init=False, repr=False, default_factory=dict)
    _powers: list[Array] = field(init=False, repr=False, default_factory=list)

    def __post_init__(self) -> None:
        affine = np.eye(7)
        affine[:6, :6], affine[:6, 6] = self.A, self.B
        object.__setattr__(self, "_generator", logarithm(affine) / self.time_step)

    def transition(self, duration: float) -> tuple[Array, Array, Array]:
        """Return A, B and the process noise over any duration, to the microsecond.

        Args:
            duration: Time to bridge, may be negative [s].

        Returns:
            A, shape (6, 6); B, shape (6,); Q, the covariance of x that has accrued, shape (6, 6).
        """
        key = round(duration * 1e6)
        found = self._transitions.get(key)
        if found is None:
            if len(self._transitions) >= 4096:
                self._transitions.clear()
                self._affine.clear()
            affine = self._affine.get(key)
            if affine is None:
                affine = self._affine[key] = exponential(self._generator * (key * 1e-6))
            found = (affine[:6, :6], affine[:6, 6], white_acceleration(self.acceleration_density, abs(key) * 1e-6))
            self._transitions[key] = found
        return found

    def with_density(self, density: float) -> "LinearBallModel":
        """Return the same model with another process noise [m²/s³]; both share the exponentials worked out so far."""
        model = replace(self, acceleration_density=density)
        object.__setattr__(model, "_affine", self._affine)
        return model

    def predict(self, state: Array, steps: int) -> Array:
        """Predict the coming states by iterating x ← A x + B (Sec. V-C).

        Args:
            state: Current state [m, m/s], shape (6,).
            steps: Number of time steps.

        Returns:
            States Δt, 2Δt, ... steps·Δt later [m, m/s], shape (steps, 6).
        """
        powers, offsets, _ = self._stacks(steps)
        predicted: Array = (powers[: 6 * steps] @ state).reshape(steps, 6) + offsets[:steps]
        return predicted

    def propagate(self, state: Array, covariance: Array, duration: float) -> tuple[Array, Array]:
        """Return state, shape (6,), and covariance, shape (6, 6), `duration` [s] later."""
        A, B, Q = self.transition(duration)
        return A @ state + B, A @ covariance @ A.T + Q

    def predict_covariance(self, state: Array, covariance: Array, steps: int) -> Array:
        """Predict the covariances that belong to `predict`.

        Args:
            state: Current state; a linear model's covariances do not depend on it.
            covariance: Covariance of the current state, shape (6, 6).
            steps: Number of time steps.

        Returns:
            Covariances Δt, 2Δt, ... steps·Δt later, shape (steps, 6, 6).
        """
        powers, _, noise = self._stacks(steps)
        stacked = powers[: 6 * steps].reshape(steps, 6, 6)
        predicted: Array = stacked @ covariance @ stacked.transpose(0, 2, 1) + noise[:steps]
        return predicted

    def position_covariance(self, state: Array, covariance: Array, steps: int) -> Array:
        """Return the covariances of the positions of `predict` [m²], shape (steps, 3, 3)."""
        powers, _, noise = self._stacks(steps)
        rows = powers[: 6 * steps].reshape(steps, 6, 6)[:, :3]
        predicted: Array = rows @ covariance @ rows.transpose(0, 2, 1) + noise[:steps, :3, :3]
        return predicted

    def _stacks(self, steps: int) -> list[Array]:
        """Return A^n, (6N, 6), ΣA^i B, (N, 6), and ΣA^i Q A^iᵀ, (N, 6, 6), for n = 1 ... N with N >= steps."""
        if not self._powers or len(self._powers[1]) < steps:
            power, offset, noise = np.eye(6), np.zeros(6), np.zeros((6, 6))
            step_noise = white_acceleration(self.acceleration_density, self.time_step)
            rows = []
            for _ in range(max(256, steps)):
                power, offset, noise = self.A @ power, self.A @ offset + self.B, self.A @ noise @ self.A.T + step_noise
                rows.append((power, offset, noise))
            self._powers[:] = [np.concatenate([r[0] for r in rows]), *(np.array([r[i] for r in rows]) for i in (1, 2))]
        return self._powers

    def initial_state(self, time: Array, position: Array) -> tuple[Array, Array, float]:
        """Estimate the state at the last of a few samples by least squares.

        Args:
            time: Time of the samples [s], shape (N,), N >= 2.
            position: Measured positions [m], shape (N, 3).

        Returns:
            State, shape (6,); its covariance, shape (6, 6); sum of the squared normalised residuals, which is
            χ² distributed with 3N - 6 degrees of freedom if the samples are of a free flight.
        """
        bridges = [self.transition(t - time[-1]) for t in time]
        weight = np.tile(1.0 / self.measurement_std, len(time))
        design = np.concatenate([A[:3] for A, _, _ in bridges]) * weight[:, None]
        target = (position - np.array([B[:3] for _, B, _ in bridges])).ravel() * weight
        covariance = np.linalg.inv(design.T @ design)
        state = covariance @ (design.T @ target)
        residual = target - design @ state
        return state, covariance + self.transition(time[-1] - time[0])[2], float(residual @ residual)

    def measurement_covariance(self, position: Array) -> Array:
        """Return the covariance of a measured position [m²], shape (3, 3), which is the same everywhere."""
        return np.diag(self.measurement_std**2)

    def make_filter(self, state: Array, covariance: Array) -> BallFilter:
        """Return a Kalman filter of the ball (Sec. V-C) that starts from a state, shape (6,), and its covariance."""
        return kalman_filter(state, covariance, np.diag(self.measurement_std**2))

    def advance(self, kalman: BallFilter, duration: float) -> None:
        """Let a filter predict `duration` [s] ahead; B enters as its control input (Sec. V-C)."""
        A, B, Q = self.transition(duration)
        kalman.predict(u=ON, B=B[:, None], F=A, Q=Q)

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain numbers and lists, fit for JSON; `from_dict` restores it bit by bit."""
        values = {name: getattr(self, name) for name in _StoredModel.model_fields}
        plain = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
        return _StoredModel.model_validate(plain).model_dump(mode="json")

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> "LinearBallModel":
        """Restore a model from `to_dict`.

        Raises:
            TableFileError: A key is missing or unknown, or a value has the wrong shape or is not finite.
        """
        try:
            values = _StoredModel.model_validate(stored)
            return cls(
                A=np.array(values.A),
                B=np.array(values.B),
                time_step=values.time_step,
                acceleration_density=values.acceleration_density,
                measurement_std=np.array(values.measurement_std),
                residual_rms=np.array(values.residual_rms),
                structure=values.structure,
                errors=values.errors,
            )
        except ValidationError as error:
            raise TableFileError(explain(error, _StoredModel, DAMAGED)) from error
        except TrainingDataError as error:
            raise TableFileError(f"{DAMAGED}: {error}") from error


# SciPy's expm and logm share even these 7 x 7 matrices among threads: 20 µs become 20 ms on a busy machine.


def exponential(matrix: Array) -> Array:
    """Return the matrix exponential by its series, after halving the argument to a norm of at most one half."""
    halvings = max(0, int(np.ceil(np.log2(np.abs(matrix).sum(axis=0).max() + 1e-300))) + 1)
    scaled, identity = matrix / 2.0**halvings, np.eye(len(matrix))
    result = identity
    for k in range(14, 0, -1):
        result = identity + scaled @ result / k
    for _ in range(halvings):
        result = result @ result
    return result


def logarithm(matrix: Array) -> Array:
    """Return the logarithm of one step of a smooth motion by its series.

    Raises:
        TrainingDataError: An eigenvalue is not within one half of 1.
    """
    farthest = float(np.abs(np.linalg.eigvals(matrix) - 1.0).max())
    if not farthest < 0.5:
        raise TrainingDataError(
            f"an eigenvalue of the ball model's A is {farthest:.3g} away from 1, too far for one step of a smooth"
            " motion; fit it again"
        )
    identity = np.eye(len(matrix))
    difference, result = matrix - identity, np.zeros_like(matrix)
    for k in range(60, 0, -1):
        result = difference @ (identity / k - result)
    return result


class _StoredModel(Model):
    """The form of a stored model."""

    kind: Literal["linear"]
    A: Annotated[tuple[_State, ...], Field(min_length=6, max_length=6)]
    B: _State
    time_step: Positive
    acceleration_density: Positive
    measurement_std: tuple[Positive, Positive, Positive]
    residual_rms: tuple[NonNegative, NonNegative, NonNegative]
    structure: Structure
    errors: tuple[PredictionError, ...]
