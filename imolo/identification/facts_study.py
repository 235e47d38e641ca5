"""A study whose data are published facts about a robot: sets of settings that meet them, and how far these differ."""

import hashlib
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from imolo.campaigns.kept_trials import environment, plugin_code
from imolo.campaigns.motion_recorder import without_chance
from imolo.campaigns.results import ResultsFolder
from imolo.campaigns.workers import run_on_cores, run_on_dask
from imolo.config.experiment import ExperimentConfig, ParallelConfig
from imolo.config.loading import make_config
from imolo.config.model import Model, Positive
from imolo.config.yaml_file import dump_yaml
from imolo.errors import ConfigError, ImoloError, did_you_mean
from imolo.identification.evaluation import Progress
from imolo.identification.facts import Measured, Motion, aimed_at, measure, unseen_motions
from imolo.identification.parameters import (
    Parameter,
    ParameterConfig,
    Settings,
    apply,
    declared,
    from_units,
    patch,
    resolve,
    to_units,
)
from imolo.machine.files import read_bounded, write_whole
from imolo.trials.rollout import Rollout

Array = NDArray[np.float64]

FIRST_STEP = 0.15  # of the range: standard deviation of CMA-ES's first generation
FAILED = 1e4  # loss of a robot that could not be played
APART = 0.1  # of the range: two members of an ensemble differ by this in some setting
MOST_BYTES = 1_000_000


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


class _Played(BaseModel):
    """One robot."""

    settings: dict[str, float]
    values: dict[str, float]
    reach: tuple[float, float, float]


class FactsBench:
    """Plays robots, each once, and keeps what was measured of them."""

    def __init__(
        self, study: FactsStudy, config: ExperimentConfig, folder: Path, jobs: int, parallel: ParallelConfig
    ) -> None:
        """Prepare; `config` is that of the robot as it is."""
        self._study, self._config, self._folder = study, config, folder
        self._jobs, self._parallel = jobs, parallel
        self._unseen = unseen_motions(config, study.unseen, study.seed)
        asked = {"unseen": study.unseen, "balls": study.balls, "aim": study.aim_at_reach, "seed": study.seed}
        self._origin = json.dumps([environment(), plugin_code(config), config.digest(), asked], sort_keys=True)

    def play(self, settings: Settings) -> _Played:
        """Play one robot and measure it.

        Raises:
            ImoloError: The config refuses the settings, or the robot cannot be played.
        """
        key = self._origin + json.dumps(dict(settings), sort_keys=True)
        file = self._folder / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}.json"
        try:
            return _Played.model_validate_json(read_bounded(file, MOST_BYTES))
        except (OSError, ValueError):
            pass
        config = apply(self._config, settings)
        quiet = without_chance(config)
        motions = [Motion(quiet, theta) for theta in (*config.training.motions, *self._unseen)]
        measured: Measured = measure(
            config, self._unseen, self._roll_out(motions), self._study.balls, self._study.aim_at_reach
        )
        x, y, z = measured.reach.tolist()
        played = _Played(settings=dict(settings), values=dict(measured.values), reach=(x, y, z))
        self._folder.mkdir(parents=True, exist_ok=True)
        write_whole(file, played.model_dump_json() + "\n")
        return played

    def _roll_out(self, motions: Sequence[Motion]) -> list[Rollout]:
        found: dict[int, Rollout] = {}
        if self._parallel.backend == "dask":
            found.update(run_on_dask(Motion.play, motions, self._parallel))
        elif self._jobs == 1:
            found.update(enumerate(motion.play() for motion in motions))
        else:
            found.update(run_on_cores(Motion.play, motions, self._jobs, self._parallel.retries, lambda _: True))
        return [found[index] for index in range(len(motions))]


def fit_to_facts(
    study: FactsStudy,
    source: Path,
    folder: ResultsFolder,
    jobs: int,
    parallel: ParallelConfig,
    progress: Progress = lambda *_: None,
) -> FactsResult:
    """Search settings that meet the facts by CMA-ES, and keep an ensemble of those that meet them equally well.

    Writes facts.json, best.yaml and ensemble.yaml, parts of a config, to the folder.

    Raises:
        ImoloError: The study cannot be used, or the robot as it is cannot be played.
    """
    folder.prepare()
    config = make_config(study.config, f"{source}: config")
    options = declared(config)
    parameters = [resolve(config, path, said, options) for path, said in study.parameters.items()]
    bench = FactsBench(study, config, folder.path / "evaluations", jobs, parallel)
    label = f"{config.backend.name}: robots"
    progress(label, 0, study.evaluations)
    start = bench.play({one.path: one.start for one in parameters})
    played = [start]
    _search(study, parameters, bench, played, lambda: progress(label, len(played), study.evaluations))
    losses = np.array([loss(study, one) for one in played])
    members = _ensemble(study, parameters, played, losses)
    result = _result(study, source, config, parameters, played, losses, members)
    folder.save_json("facts.json", result)
    with folder.file("best.yaml") as file:
        file.write(dump_yaml(_patch(study, config, members[0])).encode())
    with folder.file("ensemble.yaml") as file:
        file.write(dump_yaml({"members": [_patch(study, config, one) for one in members]}).encode())
    return result


def loss(study: FactsStudy, played: _Played) -> float:
    """Return the sum of the squared misses of the facts that the search sees."""
    seen = [fact for fact in study.facts.values() if not fact.held_out]
    return float(sum(fact.miss(fact.value(played.values)) ** 2 for fact in seen))


def _search(
    study: FactsStudy, parameters: Sequence[Parameter], bench: FactsBench, played: list[_Played], tell: Any
) -> None:
    import cma

    start = to_units(parameters, played[0].settings)
    options = {"bounds": [0.0, 1.0], "seed": study.seed + 1, "maxfevals": study.evaluations, "verbose": -9}
    strategy = cma.CMAEvolutionStrategy(start.tolist(), FIRST_STEP, options)
    while not strategy.stop() and len(played) + strategy.popsize <= study.evaluations:
        asked = strategy.ask()
        values = []
        for units in asked:
            try:
                one = bench.play(from_units(parameters, np.array(units)))
            except ImoloError:  # a robot that falls apart in mid-search is a bad one
                values.append(FAILED)
                continue
            played.append(one)
            values.append(loss(study, one) + sum(p.surprise(one.settings[p.path]) for p in parameters))
            tell()
        strategy.tell(asked, values)


def _ensemble(
    study: FactsStudy, parameters: Sequence[Parameter], played: Sequence[_Played], losses: Array
) -> list[_Played]:
    """Return the best robot and others that are as good, each far from those taken before."""
    order = np.argsort(losses, kind="stable")
    good = [int(index) for index in order if losses[index] <= losses[order[0]] + study.as_well]
    places = np.array([to_units(parameters, played[index].settings) for index in good])
    taken = [0]
    while len(taken) < min(study.ensemble, len(good)):
        distance = np.abs(places[:, None] - places[taken][None]).max(axis=2).min(axis=1)
        farthest = int(distance.argmax())
        if distance[farthest] < APART:
            break
        taken.append(farthest)
    return [played[good[index]] for index in taken]


def _patch(study: FactsStudy, config: ExperimentConfig, played: _Played) -> dict[str, Any]:
    settings: dict[str, Any] = patch(played.settings, config)
    if study.aim_at_reach:
        aimed = aimed_at(config, np.array(played.reach)).simulation.thrower.aim_center
        settings.setdefault("simulation", {}).setdefault("thrower", {})["aim_center"] = list(aimed)
    return settings


def _result(
    study: FactsStudy,
    source: Path,
    config: ExperimentConfig,
    parameters: Sequence[Parameter],
    played: Sequence[_Played],
    losses: Array,
    members: Sequence[_Played],
) -> FactsResult:
    best = members[0]

    def over(values: Sequence[float]) -> tuple[float, float]:
        return min(values), max(values)

    facts = []
    for name, fact in study.facts.items():
        low, high = over([fact.value(one.values) for one in members])
        value = fact.value(best.values)
        facts.append(
            FactFound(
                name=name,
                source=fact.source,
                at_least=fact.at_least if math.isfinite(fact.at_least) else None,
                at_most=fact.at_most if math.isfinite(fact.at_most) else None,
                start=fact.value(played[0].values),
                best=value,
                low=low,
                high=high,
                miss=fact.miss(value),
                held_out=fact.held_out,
            )
        )
    settings = []
    for one in parameters:
        low, high = over([member.settings[one.path] for member in members])
        settings.append(
            SettingFound(
                path=one.path,
                start=one.start,
                best=best.settings[one.path],
                low=low,
                high=high,
                searched=(one.low, one.high),
            )
        )
    return FactsResult(
        title=study.title or source.stem,
        backend=config.backend.name,
        evaluations=len(played),
        start_loss=float(losses[0]),
        best_loss=float(losses.min()),
        facts=tuple(facts),
        settings=tuple(settings),
        members=tuple(one.settings for one in members),
    )
