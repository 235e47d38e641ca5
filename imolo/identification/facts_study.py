"""A study whose data are published facts about a robot: sets of settings that meet them, and how far these differ."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from imolo.config.model import Model, Positive
from imolo.errors import ConfigError, did_you_mean
from imolo.identification.parameters import (
    ParameterConfig,
)

Array = NDArray[np.float64]


class FactConfig(Model):
    """One published fact.

    Attributes:
        measures: What it is about, see `measure`; of several, the one that meets it best.
        at_least: Lowest value that agrees.
        at_most: Highest value that agrees.
        tolerance: A miss of this size counts one.
        source: Where it is published.
        held_out: Whether it is looked at only when all is done.
    """

    measures: Annotated[tuple[str, ...], Field(min_length=1)]
    at_least: float = -math.inf
    at_most: float = math.inf
    tolerance: Positive
    source: str = ""
    held_out: bool = False

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=True)

    @model_validator(mode="after")
    def _says_something(self) -> "FactConfig":
        if not self.at_least <= self.at_most or (math.isinf(self.at_least) and math.isinf(self.at_most)):
            raise ValueError("give at_least, at_most or both, the former not above the latter")
        return self

    def value(self, values: dict[str, float]) -> float:
        """Return the value that meets it best.

        Raises:
            ConfigError: Nothing of that name is measured.
        """
        for name in self.measures:
            if name not in values:
                raise ConfigError(f"unknown measure {name!r}{did_you_mean(name, values)}; known: {', '.join(values)}")
        return min((values[name] for name in self.measures), key=self.miss)

    def miss(self, value: float) -> float:
        """Return by how many tolerances a value misses it; 0 where it agrees."""
        return max(self.at_least - value, value - self.at_most, 0.0) / self.tolerance


class FactsStudy(Model):
    """What a study of published facts says.

    Attributes:
        kind: Which kind of study this is.
        title: Of the report; the name of the file if not given.
        config: Of the robot, as a config's file; its training motions and its first method are what is measured.
        parameters: What is searched, by path of the setting.
        facts: What is to be met, by name.
        unseen: Number of motions that nothing is learned from.
        balls: Number of balls thrown at the table.
        aim_at_reach: Whether the thrower is aimed at the middle of each robot's reach, as an operator would.
        ensemble: How many sets of settings to keep that meet the facts as well as the best one.
        as_well: Loss above that of the best one up to which a set meets them as well; 1 is one tolerance of one fact.
        seed: Of the search and of the unseen motions.
        evaluations: How many robots may be played.
    """

    kind: Literal["facts"]
    title: str = ""
    config: dict[str, Any]
    parameters: Annotated[dict[str, ParameterConfig], Field(min_length=2)]
    facts: Annotated[dict[str, FactConfig], Field(min_length=1)]
    unseen: Annotated[int, Field(ge=4)] = 16
    balls: Annotated[int, Field(ge=1)] = 40
    aim_at_reach: bool = True
    ensemble: Annotated[int, Field(ge=1)] = 12
    as_well: Positive = 1.0
    seed: Annotated[int, Field(ge=0)] = 1
    evaluations: Annotated[int, Field(ge=10)] = 300


class FactFound(BaseModel):
    """How a fact is met.

    Attributes:
        name: Of the fact.
        source: Where it is published.
        at_least: Lowest value that agrees; None where there is none.
        at_most: Highest value that agrees; None where there is none.
        start: Value of the settings as they are.
        best: Of the best set.
        low: Lowest of the ensemble.
        high: Highest of the ensemble.
        miss: Of the best set, in tolerances.
        held_out: Whether the search did not see it.
    """

    model_config = ConfigDict(frozen=True)

    name: str
    source: str
    at_least: float | None
    at_most: float | None
    start: float
    best: float
    low: float
    high: float
    miss: float
    held_out: bool


class SettingFound(BaseModel):
    """A setting and how much the facts leave open of it: the range over the ensemble.

    Attributes:
        path: Of the setting.
        start: As it is.
        best: Of the best set.
        low: Lowest of the ensemble.
        high: Highest of the ensemble.
        searched: Lowest and highest value that was allowed.
    """

    model_config = ConfigDict(frozen=True)

    path: str
    start: float
    best: float
    low: float
    high: float
    searched: tuple[float, float]


class FactsResult(BaseModel):
    """The whole result.

    Attributes:
        title: Of the study.
        backend: In which the robots were played.
        evaluations: How many.
        start_loss: Sum of the squared misses of the settings as they are.
        best_loss: Of the best set.
        facts: How each is met.
        settings: What was found.
        members: Sets of the ensemble, the best first.
    """

    model_config = ConfigDict(frozen=True)

    title: str
    backend: str
    evaluations: int
    start_loss: float
    best_loss: float
    facts: tuple[FactFound, ...]
    settings: tuple[SettingFound, ...]
    members: tuple[dict[str, float], ...]
