"""Fit a ball model to about ten throws and rate it by leave-one-out (paper Sec. V-C)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imolo.ball.aerodynamic import AerodynamicBallModel
from imolo.ball.aerodynamic_fit import AerodynamicFit
from imolo.ball.flight import FEWEST_SAMPLES, Flight
from imolo.ball.linear import LinearBallModel, Structure
from imolo.ball.linear_fit import fit_linear
from imolo.ball.model import KINDS, BallModel, BallModelConfig, PredictionError
from imolo.ball.prediction import prediction_errors
from imolo.errors import TableFileError, TrainingDataError

Array = NDArray[np.float64]
_Fit = Callable[[Sequence[Flight]], LinearBallModel | AerodynamicBallModel]

FEWEST_FLIGHTS = 3  # leave-one-out over two flights would fit to one


def fit_ball_model(flights: Sequence[Flight], config: BallModelConfig | None = None) -> BallModel:
    """Fit a ball model to recorded throws and set structure and process noise by leave-one-out (Sec. V-C).

    Structure and process noise maximise the log-likelihood of the left-out positions `selection_horizon` ahead, of drag
    and spin also of those a third and two thirds of it ahead. The plain error would prefer a filter that trusts the
    model so much that its gate then loses the real ball.

    Args:
        flights: About ten throws, at least three.
        config: Which model, and how to fit it.

    Returns:
        The model of all throws, with the leave-one-out errors of its kind.

    Raises:
        TrainingDataError: Too few flights, or one is too short, not finite or not in order.
    """
    config = config or BallModelConfig()
    _check(flights, config)
    fits = _ways_to_fit(flights, config)
    densities = (config.acceleration_density,) if config.acceleration_density else config.density_grid
    folds = {name: [fit([*flights[:i], *flights[i + 1 :]]) for i in range(len(flights))] for name, fit in fits.items()}
    choices = list(product(fits, densities))

    def left_out(name: str, density: float) -> list[LinearBallModel | AerodynamicBallModel]:
        return [fold.with_density(density) for fold in folds[name]]

    name, density = choices[0]
    if len(choices) > 1:
        horizons = _selection_horizons(flights, config)
        likelihood = {choice: _log_likelihood(left_out(*choice), flights, horizons, config) for choice in choices}
        name, density = max(choices, key=lambda choice: likelihood[choice])
        if config.kind != "linear":
            density = _vertex(density, {other: likelihood[name, other] for other in densities})
    errors = _left_out_errors(left_out(name, density), flights, config)
    return replace(fits[name](flights), acceleration_density=density, errors=errors)


def restore_ball_model(stored: Mapping[str, Any]) -> BallModel:
    """Restore a model of any kind from its `to_dict`.

    Raises:
        TableFileError: The kind is unknown, or the model is damaged.
    """
    kind = stored.get("kind")
    if kind not in KINDS:
        raise TableFileError(
            f"the stored ball model is of kind {kind!r}, known are {', '.join(KINDS)}; fit and save it again"
        )
    return LinearBallModel.from_dict(stored) if kind == "linear" else AerodynamicBallModel.from_dict(stored)


def _ways_to_fit(flights: Sequence[Flight], config: BallModelConfig) -> dict[str, _Fit]:
    """Return what may be fitted to some of the flights, by name; the process noise is chosen later."""
    if config.kind != "linear":
        return {config.kind: AerodynamicFit(config.kind, flights, config)}
    structures: tuple[Structure, ...] = ("diagonal", "full") if config.structure == "auto" else (config.structure,)
    return {structure: partial(fit_linear, structure=structure, config=config) for structure in structures}


def _selection_horizons(flights: Sequence[Flight], config: BallModelConfig) -> tuple[float, ...]:
    """Return the lead times [s] that decide: of the linear model one, since no noise makes it right at several."""
    longest = max(float(np.ptp(flight.time)) for flight in flights)
    fits_in = longest >= config.selection_horizon + config.settling_time
    horizon = config.selection_horizon if fits_in else 0.5 * longest
    return (horizon,) if config.kind == "linear" else (horizon / 3.0, horizon / 1.5, horizon)


def _vertex(best: float, likelihood: Mapping[float, float]) -> float:
    """Return where the parabola over log(density) through the best candidate and its neighbours is highest."""
    ordered = sorted(likelihood)
    if len(ordered) < 3:
        return best
    at = min(max(ordered.index(best), 1), len(ordered) - 2)
    near = ordered[at - 1 : at + 2]
    curvature, slope, _ = np.polyfit(np.log(near) - np.log(best), [likelihood[density] for density in near], 2)
    if curvature >= 0.0:
        return best
    return float(np.clip(best * np.exp(-0.5 * slope / curvature), near[0], near[2]))


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


def _log_likelihood(
    models: Sequence[BallModel], flights: Sequence[Flight], horizons: Sequence[float], config: BallModelConfig
) -> float:
    """Return the log-likelihood of the positions at lead times [s], summed, each flight under its own model."""
    total = 0.0
    for (model, flight), horizon in product(zip(models, flights, strict=True), horizons):
        error, covariance = prediction_errors(model, flight, horizon, config.settling_time)
        distance = np.einsum("ni,nij,nj->", error, np.linalg.inv(covariance), error)
        total -= 0.5 * float(distance + np.linalg.slogdet(covariance)[1].sum())
    return total


def _left_out_errors(
    models: Sequence[BallModel], flights: Sequence[Flight], config: BallModelConfig
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
