"""Fit the linear ball model to about ten throws and rate it by leave-one-out (paper Sec. V-C)."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.optimize import least_squares
from scipy.special import factorial

from imolo.ball.flight import FEWEST_SAMPLES, Flight
from imolo.ball.model import LinearBallModel, PredictionError, Structure, exponential
from imolo.config.model import Model, NonNegative, Positive
from imolo.errors import TrainingDataError

Array = NDArray[np.float64]

LEAST_NOISE = 1e-4  # [m] assumed: below what any mocap resolves; keeps the filter regular on noise-free data
SERIES_TERMS = 40  # of exp(C t) in the fit; at a rate of 10 /s exact to 1e-9 m over 1 s
START_SAMPLES = 4  # start the filter of a recorded flight: 12 numbers for 6 unknowns
SHRINKAGE = 1e-4  # [m·s] keeps rates near zero that two or three flights say nothing of; well below 1 mm otherwise
FEWEST_FLIGHTS = 3  # leave-one-out over two flights would fit to one


class BallModelConfig(Model):
    """How the ball model is fitted."""

    time_step: Annotated[float, Field(gt=0.0, le=0.05)] = Field(0.0083, description="Δt [s], Sec. VII-B")
    structure: Literal["auto", "diagonal", "full"] = Field(
        "auto", description="v' = diag(a) v + b, v' = M v + b, or the one that predicts left-out throws better"
    )
    horizons: tuple[Positive, ...] = Field((0.25, 0.50, 0.75), description="lead times of the report [s], Sec. VII-C")
    selection_horizon: Positive = Field(
        0.50, description="lead time that structure and process noise are chosen at [s]"
    )
    settling_time: NonNegative = Field(
        0.10, description="observation of a throw before its first rated prediction [s], assumed"
    )
    min_duration: Positive = Field(0.30, description="shortest accepted flight [s], assumed")
    acceleration_density: Positive | None = Field(
        None, description="process noise: spectral density of a white acceleration [m²/s³]; none: from the data"
    )
    density_grid: Annotated[tuple[Positive, ...], Field(min_length=1)] = Field(
        (1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0, 3.0), description="candidates for acceleration_density [m²/s³]"
    )


def fit_ball_model(flights: Sequence[Flight], config: BallModelConfig | None = None) -> LinearBallModel:
    """Fit A and B to recorded throws and set structure and noise by leave-one-out (Sec. V-C).

    Structure and process noise maximise the log-likelihood of the left-out positions `selection_horizon` ahead. The
    plain error would prefer a filter that trusts the model so much that its gate then loses the real ball.

    Args:
        flights: About ten throws, at least three.
        config: How to fit.

    Returns:
        The model of all throws, with the leave-one-out errors of its kind.

    Raises:
        TrainingDataError: Too few flights, or one is too short, not finite or not in order.
    """
    config = config or BallModelConfig()
    _check(flights, config)
    structures: tuple[Structure, ...] = ("diagonal", "full") if config.structure == "auto" else (config.structure,)
    densities = (config.acceleration_density,) if config.acceleration_density else config.density_grid
    folds = {s: [_fit([*flights[:i], *flights[i + 1 :]], s, config) for i in range(len(flights))] for s in structures}
    kinds = list(product(structures, densities))

    def left_out(kind: tuple[Structure, float]) -> list[LinearBallModel]:
        return [replace(fold, acceleration_density=kind[1]) for fold in folds[kind[0]]]

    best = kinds[0]
    if len(kinds) > 1:
        best = max(kinds, key=lambda kind: _log_likelihood(left_out(kind), flights, config))
    errors = _left_out_errors(left_out(best), flights, config)
    return replace(_fit(flights, best[0], config), acceleration_density=best[1], errors=errors)


def _check(flights: Sequence[Flight], config: BallModelConfig) -> None:
    if len(flights) < FEWEST_FLIGHTS:
        raise TrainingDataError(
            f"{len(flights)} flights are too few for leave-one-out; record at least {FEWEST_FLIGHTS}, the paper has 10"
        )
    for i, flight in enumerate(flights):
        count = len(flight.time)
        if flight.position.shape != (count, 3) or flight.time.shape != (count,):
            shapes = f"time {flight.time.shape} and position {flight.position.shape}"
            raise TrainingDataError(f"flight {i} has {shapes}; they must be (N,) and (N, 3)")
        if not (np.isfinite(flight.time).all() and np.isfinite(flight.position).all()):
            raise TrainingDataError(f"flight {i} has values that are not finite; leave the missing samples out")
        if (np.diff(flight.time) <= 0.0).any():
            raise TrainingDataError(
                f"the time of flight {i} does not increase; sort its samples and drop repeated ones"
            )
        duration = float(np.ptp(flight.time)) if count else 0.0
        if count < FEWEST_SAMPLES or duration < config.min_duration:
            raise TrainingDataError(
                f"flight {i} is too short: {count} samples in {duration:.3f} s, needed {FEWEST_SAMPLES} in"
                f" {config.min_duration} s; leave it out or throw it again"
            )
    needed = config.selection_horizon + config.settling_time
    longest = max(float(np.ptp(flight.time)) for flight in flights)
    if longest < needed:
        raise TrainingDataError(
            f"the longest flight, {longest:.3f} s, is shorter than selection_horizon + settling_time = {needed:.3f} s;"
            " lower selection_horizon or record longer throws"
        )


def _log_likelihood(models: Sequence[LinearBallModel], flights: Sequence[Flight], config: BallModelConfig) -> float:
    """Return the log-likelihood of the positions `selection_horizon` ahead, each flight under its own model."""
    total = 0.0
    for model, flight in zip(models, flights, strict=True):
        error, covariance = prediction_errors(model, flight, config.selection_horizon, config.settling_time)
        distance = np.einsum("ni,nij,nj->", error, np.linalg.inv(covariance), error)
        total -= 0.5 * float(distance + np.linalg.slogdet(covariance)[1].sum())
    return total


def _left_out_errors(
    models: Sequence[LinearBallModel], flights: Sequence[Flight], config: BallModelConfig
) -> tuple[PredictionError, ...]:
    """Return the errors at the horizons that some flight is long enough for, each flight under its own model."""
    report = []
    for horizon in config.horizons:
        pairs = zip(models, flights, strict=True)
        errors = [prediction_errors(model, flight, horizon, config.settling_time)[0] for model, flight in pairs]
        distances = [np.linalg.norm(error, axis=1) for error in errors if len(error)]
        if distances:
            pooled = np.concatenate(distances)
            at_end = float(np.mean([distance[-1] for distance in distances]))
            report.append(
                PredictionError(
                    horizon=horizon,
                    mean=float(pooled.mean()),
                    std=float(pooled.std()),
                    mean_at_end=at_end,
                    count=len(pooled),
                )
            )
    return tuple(report)


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


def _fit(flights: Sequence[Flight], structure: Structure, config: BallModelConfig) -> LinearBallModel:
    """Fit A, B and the measurement noise; the process noise is left at the first candidate."""
    trajectories = _TrajectoryFit(flights)
    entries = np.diag_indices(3) if structure == "diagonal" else np.indices((3, 3)).reshape(2, 9)

    def rates(parameters: Array) -> Array:
        matrix = np.zeros((3, 3))
        matrix[entries[0], entries[1]] = parameters
        return matrix

    def residuals(parameters: Array) -> Array:
        misfit = np.concatenate(trajectories.solve(rates(parameters))[1]).ravel()
        return np.concatenate((misfit, SHRINKAGE * parameters))

    solution = least_squares(residuals, np.zeros(len(entries[0])), method="lm", xtol=1e-12)
    constant, errors = trajectories.solve(rates(solution.x))
    generator = np.zeros((7, 7))
    generator[:3, 3:6], generator[3:6, 3:6], generator[3:6, 6] = np.eye(3), rates(solution.x), constant
    affine = exponential(generator * config.time_step)
    return LinearBallModel(
        A=affine[:6, :6],
        B=affine[:6, 6],
        time_step=config.time_step,
        acceleration_density=config.acceleration_density or config.density_grid[0],
        measurement_std=_noise(errors),
        residual_rms=np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)),
        structure=structure,
    )


def _noise(residuals: Sequence[Array]) -> Array:
    """Return the measurement noise [m], shape (3,), from the differences of successive residuals, (N, 3) each.

    The misfit of the linear model hardly changes from sample to sample, so the differences are free of it.
    """
    differences = np.concatenate([np.diff(residual, axis=0) for residual in residuals])
    noise: Array = np.maximum(np.sqrt(np.mean(differences**2, axis=0) / 2.0), LEAST_NOISE)
    return noise


def filter_flight(model: LinearBallModel, flight: Flight) -> tuple[Array, Array]:
    """Run the Kalman filter over a recorded flight.

    Returns:
        States, shape (N, 6), and covariances, shape (N, 6, 6), after each sample; NaN before the filter has started.
    """
    states, covariances = np.full((len(flight.time), 6), np.nan), np.full((len(flight.time), 6, 6), np.nan)
    start = START_SAMPLES - 1
    state, covariance, _ = model.initial_state(flight.time[: start + 1], flight.position[: start + 1])
    states[start], covariances[start] = state, covariance
    kalman = model.make_filter(state, covariance)
    for i in range(start + 1, len(flight.time)):
        model.advance(kalman, flight.time[i] - flight.time[i - 1])
        kalman.update(flight.position[i])
        states[i], covariances[i] = kalman.x, kalman.P
    return states, covariances


def prediction_errors(
    model: LinearBallModel, flight: Flight, horizon: float, settling_time: float = 0.10
) -> tuple[Array, Array]:
    """Compare a flight with what the filter predicted `horizon` earlier (Sec. VII-C).

    Every sample is a target once the filter had seen `settling_time` of the flight at the moment of prediction; the
    prediction starts at the last sample that is at least `horizon` older than its target.

    Args:
        model: Model of filter and prediction.
        flight: Flight that the model was not fitted to.
        horizon: Lead time [s].
        settling_time: Observation before the first prediction [s].

    Returns:
        Predicted minus measured position [m], shape (M, 3), M may be 0; its predicted covariance, shape (M, 3, 3).
    """
    states, covariances = filter_flight(model, flight)
    time = flight.time
    tolerance = 1e-6  # [s] the resolution of message time
    earliest = max(time[0] + settling_time, time[START_SAMPLES - 1])
    errors, spreads = [], []
    for j in np.flatnonzero(time - horizon >= earliest - tolerance):
        i = np.searchsorted(time, time[j] - horizon + tolerance, side="right") - 1
        A, B, Q = model.transition(time[j] - time[i])
        errors.append((A @ states[i] + B)[:3] - flight.position[j])
        spreads.append((A @ covariances[i] @ A.T + Q)[:3, :3] + np.diag(model.measurement_std**2))
    return np.reshape(errors, (-1, 3)), np.reshape(spreads, (-1, 3, 3))
