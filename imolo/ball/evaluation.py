"""Rate ball models on recorded flights by leave-one-out: error and calibration against the lead time."""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from threadpoolctl import threadpool_limits

from imolo.ball.fit import FEWEST_FLIGHTS, fit_ball_model
from imolo.ball.flight import Flight
from imolo.ball.model import BallModelConfig, Kind, chi_square_quantile
from imolo.ball.prediction import prediction_errors
from imolo.errors import TrainingDataError

Array = NDArray[np.float64]

PROTOCOLS = ("last point", "every sample")
ELLIPSOID = 0.95  # share of the measurements that should lie inside the predicted ellipsoid


class Rating(BaseModel):
    """How well one model predicts at one lead time.

    Attributes:
        model: Kind of the model.
        protocol: "last point": the last sample of each flight from all samples older than the lead time. "every
            sample": each sample so, once `settling_time` of the flight had been seen.
        horizon: Lead time [s].
        mean: Of the distance between prediction and measurement [m].
        sd: Standard deviation of it [m].
        quantiles: 5, 25, 50, 75 and 95 % of it [m].
        nees: Mean of the squared error normalised by the predicted covariance, over its three dimensions; 1 if right.
        inside: Share of the measurements in the 95 % ellipsoid of the prediction.
        count: Number of predictions.
    """

    model_config = ConfigDict(frozen=True)

    model: Kind
    protocol: str
    horizon: float
    mean: float
    sd: float
    quantiles: tuple[float, float, float, float, float]
    nees: float
    inside: float
    count: int


class Evaluation(BaseModel):
    """Models rated on flights.

    Attributes:
        source: Where the flights are from.
        flights: Names of the flights.
        left_out: Flights that could not be used, with the reason.
        ratings: By model, protocol and lead time; lead times that no flight is long enough for are missing.
        distances: Distance [m] at each flight's last point by model and lead time, None where a flight is too short.
    """

    model_config = ConfigDict(frozen=True)

    source: str
    flights: tuple[str, ...]
    left_out: dict[str, str]
    ratings: tuple[Rating, ...]
    distances: dict[str, dict[str, tuple[float | None, ...]]]


_Squares = dict[tuple[str, float], tuple[Array, Array]]


def leave_one_out(
    source: str,
    flights: dict[str, Flight],
    left_out: dict[str, str],
    configs: Sequence[BallModelConfig],
    horizons: Sequence[float],
    jobs: int = 1,
    on_done: Callable[[str, int, int], object] = lambda what, done, total: None,
) -> Evaluation:
    """Predict each flight with models that were fitted to all others.

    Args:
        source: Where the flights are from.
        flights: Free flights by name, at least four.
        left_out: Reasons of the flights that are not among them.
        configs: The models to rate.
        horizons: Lead times [s].
        jobs: Number of processes.
        on_done: Told the kind of model, the folds that are done, and all of them.

    Raises:
        TrainingDataError: There are too few flights, or one cannot be used.
    """
    names, tracks = tuple(flights), list(flights.values())
    if len(tracks) <= FEWEST_FLIGHTS:
        reasons = "".join(f"; {name!r} was left out: {reason}" for name, reason in left_out.items())
        raise TrainingDataError(
            f"{source} has {len(tracks)} usable flights, leave-one-out needs {FEWEST_FLIGHTS + 1}; record more{reasons}"
        )
    ratings: list[Rating] = []
    distances: dict[str, dict[str, tuple[float | None, ...]]] = {}
    for config in configs:
        on_done(config.kind, 0, len(tracks))
        ended = Parallel(n_jobs=jobs, return_as="generator")(
            delayed(_fold)(tracks, i, config, horizons) for i in range(len(tracks))
        )
        folds: list[_Squares] = []
        for fold in ended:
            folds.append(fold)
            on_done(config.kind, len(folds), len(tracks))
        for protocol, horizon in product(PROTOCOLS, horizons):
            ratings += _rate(config.kind, protocol, horizon, [fold[protocol, horizon] for fold in folds])
        distances[config.kind] = {
            f"{horizon:g}": tuple(next(iter(fold["last point", horizon][0].tolist()), None) for fold in folds)
            for horizon in horizons
        }
    return Evaluation(source=source, flights=names, left_out=left_out, ratings=tuple(ratings), distances=distances)


def _fold(flights: Sequence[Flight], tested: int, config: BallModelConfig, horizons: Sequence[float]) -> _Squares:
    """Return distances [m] and squared normalised errors of one flight, by protocol and lead time."""
    flight = flights[tested]
    # One thread, so that the sums do not depend on the number of cores.
    with threadpool_limits(limits=1):
        model = fit_ball_model([*flights[:tested], *flights[tested + 1 :]], config)
        rated: _Squares = {}
        for horizon in horizons:
            rated["every sample", horizon] = _squares(*prediction_errors(model, flight, horizon, config.settling_time))
            error, covariance = prediction_errors(model, flight, horizon, settling_time=0.0)
            rated["last point", horizon] = _squares(error[-1:], covariance[-1:])
    return rated


def _squares(error: Array, covariance: Array) -> tuple[Array, Array]:
    squared: Array = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    return np.linalg.norm(error, axis=1), squared


def _rate(kind: Kind, protocol: str, horizon: float, folds: Sequence[tuple[Array, Array]]) -> list[Rating]:
    distance, squared = (np.concatenate([fold[i] for fold in folds]) for i in (0, 1))
    if not len(distance):
        return []
    low, lower, median, upper, high = np.quantile(distance, (0.05, 0.25, 0.5, 0.75, 0.95)).tolist()
    return [
        Rating(
            model=kind,
            protocol=protocol,
            horizon=horizon,
            mean=float(distance.mean()),
            sd=float(distance.std()),
            quantiles=(low, lower, median, upper, high),
            nees=float(squared.mean() / 3.0),
            inside=float(np.mean(squared <= chi_square_quantile(ELLIPSOID, 3))),
            count=len(distance),
        )
    ]
