"""A made-up hand and small tables of it."""

from typing import Literal

import numpy as np
from liberobot import MOTION, TRAINING_MOTIONS
from numpy.typing import NDArray

from imolo.method.forward_model import ForwardModel, ForwardModelConfig
from imolo.method.table import LookupTable
from imolo.method.table_grid import GridAxis, TableGrid

Array = NDArray[np.float64]

ROUGH = TableGrid(
    parameters={
        "t_w": GridAxis(start=0.21, stop=0.41, step=0.01),
        "k": GridAxis(start=-1.0, stop=1.0, step=0.125),
    },
    time_since_swing=GridAxis(start=0.14, stop=0.21, step=0.01),
    spacing=0.02,
    time_tolerance=0.02,
)


def hand(theta: Array, time: Array) -> Array:
    """A swing of 14 rad/s about a shoulder that flies forward and up; k leads it sideways."""
    k, t_w = theta.T
    angle = 14.0 * (time - t_w)
    return np.column_stack((1.1 * time + 0.3 * np.sin(angle), 0.35 * k * time, 1.0 + 0.5 * time - 0.4 * np.cos(angle)))


def fitted(config: ForwardModelConfig) -> ForwardModel:
    since = np.linspace(0.135, 0.215, 11)
    theta = np.repeat(TRAINING_MOTIONS, len(since), axis=0)
    time = theta[:, 1] + np.tile(since, len(TRAINING_MOTIONS))
    return ForwardModel(config, MOTION).fit(theta, time, hand(theta, time))


SHARP = fitted(ForwardModelConfig(parameters={"C": 100.0, "epsilon": 0.001, "gamma": 3.0}, inputs="standardized"))


def rough_table(unique: Literal["voxel", "voxel_time", "all"] = "all", seed: int = 0) -> LookupTable:
    grid = ROUGH.model_copy(update={"unique": unique})
    origin = {"engine": "none", "seed": 3, "versions": {"numpy": "2"}}
    return LookupTable.build(SHARP, grid, np.random.default_rng(seed), robot="testbot", origin=origin)


TABLE = rough_table()
