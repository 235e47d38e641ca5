"""What tracker, planner and evaluation need to know of a flying ball, whatever its equation of motion."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from imolo.config.model import Model, NonNegative, Positive

Array = NDArray[np.float64]
Kind = Literal["linear", "drag", "spin"]
KINDS: tuple[Kind, ...] = ("linear", "drag", "spin")
DAMAGED = "the stored ball model is damaged or of another version; fit and save it again"


class BallModelConfig(Model):
    """Which ball model, and how it is fitted."""

    kind: Kind = Field(
        "linear", description="x ← A x + B (Sec. V-C), or gravity and quadratic drag, or these and Magnus lift"
    )
    time_step: Annotated[float, Field(gt=0.0, le=0.05)] = Field(0.0083, description="Δt [s], Sec. VII-B")
    structure: Literal["auto", "diagonal", "full"] = Field(
        "auto",
        description="of the linear model: v' = diag(a) v + b, v' = M v + b, or what predicts left-out throws better",
    )
    horizons: tuple[Positive, ...] = Field((0.25, 0.50, 0.75), description="lead times of the report [s], Sec. VII-C")
    selection_horizon: Positive = Field(
        0.50,
        description="lead time that structure and process noise are chosen at [s], if not linear with its thirds; half "
        "the longest flight if none is that long",
    )
    settling_time: NonNegative = Field(
        0.10, description="observation of a throw before its first rated prediction [s], assumed"
    )
    min_duration: Positive = Field(0.30, description="shortest accepted flight [s], assumed")
    acceleration_density: Positive | None = Field(
        None, description="process noise: spectral density of a white acceleration [m²/s³]; none: from the data"
    )
    density_grid: Annotated[tuple[Positive, ...], Field(min_length=1)] = Field(
        (1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0, 3.0),
        description="candidates for acceleration_density [m²/s³]",
    )


class PredictionError(Model):
    """Distance from the predicted to the measured ball at one lead time, on throws left out of the fit."""

    horizon: float = Field(description="lead time [s]")
    mean: float = Field(description="over all predictions of all throws [m]")
    std: float = Field(description="standard deviation of the distance [m]")
    mean_at_end: float = Field(description="over the last sample of each throw, where Sec. VII-C rates it [m]")
    count: int = Field(description="number of predictions")


class BallFilter(Protocol):
    """A running Kalman filter of measured positions: filterpy's.

    Attributes:
        x: State, shape (n,): position [m], velocity [m/s], then what the model adds.
        P: Its covariance, shape (n, n).
        R: Covariance of a measured position [m²], shape (3, 3).
    """

    x: Array
    P: Array
    R: Array

    def update(self, z: Array) -> None:
        """Correct the state by a measured position [m], shape (3,)."""

    def predict(self, u: Array, B: Array, F: Array, Q: Array) -> None:
        """Carry on by x ← F x + B u with the covariance Q of what is added."""


def kalman_filter(state: Array, covariance: Array, measurement_covariance: Array) -> BallFilter:
    """Return a filter of measured positions that starts from a state, shape (n,), and its covariance, shape (n, n)."""
    from filterpy.kalman import KalmanFilter  # which imports scipy.stats for a second

    kalman = KalmanFilter(dim_x=len(state), dim_z=3, dim_u=1)
    kalman.x, kalman.P, kalman.R = state.copy(), covariance.copy(), measurement_covariance
    kalman.H = np.eye(3, len(state))
    return kalman  # type: ignore[no-any-return]


class BallModel(Protocol):
    """The motion of a flying ball, x = (position, velocity, ...) of n >= 6 components, and its noise."""

    @property
    def kind(self) -> Kind:
        """Name in a config and in a stored model."""

    @property
    def time_step(self) -> float:
        """Step of `predict` [s]."""

    @property
    def acceleration_density(self) -> float:
        """Process noise: spectral density of a white acceleration [m²/s³]."""

    @property
    def errors(self) -> tuple[PredictionError, ...]:
        """Leave-one-out prediction errors; empty for a model that was not fitted."""

    def measurement_covariance(self, position: Array) -> Array:
        """Return the covariance of a position [m], shape (3,), that is measured there [m²], shape (3, 3)."""

    def initial_state(self, time: Array, position: Array) -> tuple[Array, Array, float]:
        """Estimate the state at the last of a few samples.

        Args:
            time: Time of the samples [s], shape (N,), N >= 2.
            position: Measured positions [m], shape (N, 3).

        Returns:
            State, shape (n,); its covariance, shape (n, n); sum of the squared normalised residuals, which is
            χ² distributed with 3N - 6 degrees of freedom if the samples are of a free flight.
        """

    def make_filter(self, state: Array, covariance: Array) -> BallFilter:
        """Return a filter that starts from a state, shape (n,), and its covariance, shape (n, n)."""

    def advance(self, kalman: BallFilter, duration: float) -> None:
        """Let a filter of `make_filter` predict `duration` [s] ahead."""

    def propagate(self, state: Array, covariance: Array, duration: float) -> tuple[Array, Array]:
        """Return state, shape (n,), and covariance, shape (n, n), `duration` [s] later."""

    def predict(self, state: Array, steps: int) -> Array:
        """Return the states 1, 2, ... `steps` time steps later, shape (steps, n)."""

    def predict_covariance(self, state: Array, covariance: Array, steps: int) -> Array:
        """Return the covariances that belong to `predict`, shape (steps, n, n)."""

    def position_covariance(self, state: Array, covariance: Array, steps: int) -> Array:
        """Return the covariances of the positions of `predict` [m²], shape (steps, 3, 3), fast enough for a planner."""

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain numbers and lists with its kind, fit for JSON."""

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Self:
        """Restore a model from `to_dict`.

        Raises:
            TableFileError: A key is missing or unknown, or a value has the wrong shape or is not finite.
        """


def chi_square_quantile(probability: float, freedom: int) -> float:
    """Return what a χ² distributed number stays below with this probability; importing scipy.stats takes a second."""
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(0.5 * freedom, probability))


ON = np.ones(1)
"""The control input of a filter that switches its offset B on."""


def white_acceleration(density: float, duration: float) -> Array:
    """Return the covariance, shape (6, 6), that a white acceleration of this density [m²/s³] adds in `duration` [s]."""
    noise, axes = np.zeros((6, 6)), np.arange(3)
    noise[axes, axes] = density * (duration**3 / 3.0)
    noise[axes, axes + 3] = noise[axes + 3, axes] = density * (duration**2 / 2.0)
    noise[axes + 3, axes + 3] = density * duration
    return noise
