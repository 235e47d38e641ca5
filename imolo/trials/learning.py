"""Learn from the logs of the learning trials: how balls fly, how the robot moves, and the table."""

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np

from imolo.ball.fit import fit_ball_model
from imolo.ball.model import BallModel
from imolo.config.experiment import ExperimentConfig, MethodConfig
from imolo.messaging.log import read_log
from imolo.method.forward_model import TrainingData
from imolo.method.motion import Theta
from imolo.method.prior import fit_forward_model, origin_of
from imolo.method.table import LookupTable
from imolo.trials.recordings import SHOWN, ball_flight, hand_samples, merge


def spread_motions(config: ExperimentConfig, count: int) -> tuple[Theta, ...]:
    """Return motions that fill the range of the tables evenly: its corners, then a Halton sequence.

    Args:
        config: Of the experiment, for the grids of its methods and its seed.
        count: Number of motions.
    """
    from scipy.stats import qmc

    bounds = np.array([method.grid.bounds(config.motion) for method in config.methods.values()])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    # The first parameter changes fastest.
    corners = np.array(list(product((0.0, 1.0), repeat=len(low))))[:, ::-1]
    inside = qmc.Halton(len(low), rng=np.random.default_rng(config.seed)).random(max(count - len(corners), 0))
    share = np.concatenate((corners, inside))[:count]
    return tuple(config.motion.rounded(theta) for theta in (low + share * (high - low)).tolist())


def learn_ball(method: MethodConfig, logs: Sequence[Path]) -> BallModel:
    """Fit the ball model of a method to the throws (Sec. V-C).

    Raises:
        TrainingDataError: There are too few throws, or one shows no flight.
    """
    return fit_ball_model([ball_flight(read_log(path, SHOWN)) for path in logs], method.ball_model)


def learn_motions(config: ExperimentConfig, logs: Sequence[Path]) -> TrainingData:
    """Collect the samples (s, t, theta) of the training trials (Sec. VII-B).

    Raises:
        TrainingDataError: There are no trials, or one of them does not show the hand.
    """
    return merge([hand_samples(read_log(path, SHOWN), config) for path in logs])


def build_table(
    config: ExperimentConfig, method: MethodConfig, data: TrainingData, ball_model: BallModel
) -> LookupTable:
    """Fit the forward model of a method and build its table; the ball model is stored as part of its origin.

    Raises:
        TrainingDataError: The data cannot be learned from.
        ConfigError: The estimator is unknown, or the grid is impossible.
        TableFileError: The prior cannot be read, or is of another robot or other motions.
    """
    model = fit_forward_model(method.forward_model, data, config.robot.name, config.motion)
    prior = method.forward_model.prior
    return LookupTable.build(
        model,
        method.grid,
        np.random.default_rng(config.seed),
        robot=config.robot.name,
        origin={
            "backend": config.backend.name,
            "seed": config.seed,
            "config": config.digest(),
            "ball_model": ball_model.to_dict(),
            **({} if prior is None else {"prior": origin_of(Path(prior))}),
        },
    )
