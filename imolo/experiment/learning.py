"""Learn from the logs of the learning trials: how balls fly, how the robot moves, and the table."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imolo.ball.fit import fit_ball_model
from imolo.ball.model import BallModel
from imolo.config.experiment import ExperimentConfig, MethodConfig
from imolo.experiment.recordings import ball_flight, hand_samples, merge
from imolo.log import read_log
from imolo.method.forward_model import ForwardModel, TrainingData
from imolo.method.table import LookupTable


def learn_ball(method: MethodConfig, logs: Sequence[Path]) -> BallModel:
    """Fit the ball model of a method to the throws (Sec. V-C).

    Raises:
        TrainingDataError: There are too few throws, or one shows no flight.
    """
    return fit_ball_model([ball_flight(read_log(path)) for path in logs], method.ball_model)


def learn_motions(config: ExperimentConfig, logs: Sequence[Path]) -> TrainingData:
    """Collect the samples (s, t, theta) of the training trials (Sec. VII-B).

    Raises:
        TrainingDataError: There are no trials, or one of them does not show the hand.
    """
    return merge([hand_samples(read_log(path), config.robot, config.training) for path in logs])


def build_table(
    config: ExperimentConfig, method: MethodConfig, data: TrainingData, ball_model: BallModel
) -> LookupTable:
    """Fit the forward model of a method and build its table; the ball model is stored as part of its origin.

    Raises:
        TrainingDataError: The data cannot be learned from.
        ConfigError: The estimator is unknown, or the grid is impossible.
    """
    model = ForwardModel(method.forward_model).fit(data.theta, data.time, data.position)
    return LookupTable.build(
        model,
        method.grid,
        np.random.default_rng(config.seed),
        template=config.motion,
        robot=config.robot.name,
        origin={
            "backend": config.backend.name,
            "seed": config.seed,
            "config": config.digest(),
            "ball_model": ball_model.to_dict(),
        },
    )
