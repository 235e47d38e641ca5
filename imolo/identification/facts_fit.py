"""Search settings that meet published facts, and keep an ensemble of those that meet them equally well."""

import hashlib
import json
import logging
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from imolo.campaigns.kept_trials import environment, plugin_code
from imolo.campaigns.motion_recorder import without_chance
from imolo.campaigns.results import ResultsFolder
from imolo.campaigns.workers import run_on_cores, run_on_dask
from imolo.config.experiment import ExperimentConfig, ParallelConfig
from imolo.config.loading import make_config
from imolo.config.yaml_file import dump_yaml
from imolo.errors import ImoloError
from imolo.identification.evaluation import Progress
from imolo.identification.facts import Measured, Motion, aimed_at, measure, unseen_motions
from imolo.identification.facts_study import FactFound, FactsResult, FactsStudy, SettingFound
from imolo.identification.parameters import (
    Parameter,
    Settings,
    apply,
    declared,
    from_units,
    patch,
    read_setting,
    resolve,
    to_units,
)
from imolo.machine.files import read_bounded, write_whole
from imolo.trials.rollout import Rollout

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

FIRST_STEP = 0.15  # of the range: standard deviation of CMA-ES's first generation
FAILED = 1e4  # loss of a robot that could not be played
APART = 0.1  # of the range: two members of an ensemble differ by this in some setting
SEARCHED = 0.6  # of the robots are played in search of the best one, the others in search of different ones as good
LONGEST_STEP = 0.5  # of the range, away from a robot that meets the facts
MOST_BYTES = 1_000_000


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
    as_it_is = {one.path: read_setting(config, one.path) for one in parameters}
    start = {one.path: one.start for one in parameters}
    played = [bench.play(settings) for settings in ([as_it_is] if start == as_it_is else [as_it_is, start])]
    search = _Search(study, parameters, bench, played, lambda: progress(label, len(played), study.evaluations))
    for_best = round(SEARCHED * study.evaluations)
    search.find_best(for_best)
    search.find_others(study.evaluations - for_best)
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


class _Search:
    """Plays robots whose settings it chooses, and appends them to those that were played."""

    def __init__(
        self,
        study: FactsStudy,
        parameters: Sequence[Parameter],
        bench: FactsBench,
        played: list[_Played],
        tell: Callable[[], object],
    ) -> None:
        self._study, self._parameters, self._bench, self._played = study, parameters, bench, played
        self._tell = tell
        self._failed = False

    def find_best(self, most: int) -> None:
        """Search the best robot by CMA-ES, playing `most` robots."""
        import cma

        start = np.array([one.to_unit(one.start) for one in self._parameters])
        options = {"bounds": [0.0, 1.0], "seed": self._study.seed + 1, "maxfevals": most, "verbose": -9}
        strategy = cma.CMAEvolutionStrategy(start.tolist(), FIRST_STEP, options)
        asked = 0
        while not strategy.stop() and asked + strategy.popsize <= most:
            places = strategy.ask()
            asked += len(places)
            strategy.tell(places, [self._try(np.array(place)) for place in places])

    def find_others(self, count: int) -> None:
        """Walk away from robots that meet the facts, along one setting or all of them, to find others that do.

        A search that has converged says nothing of what it left: its last robots are nearly one and the same.
        """
        rng = np.random.default_rng(self._study.seed)
        for _ in range(count):
            losses = np.array([loss(self._study, one) for one in self._played])
            good = np.flatnonzero(losses <= losses.min() + self._study.as_well)
            origin = to_units(self._parameters, self._played[int(rng.choice(good))].settings)
            direction = rng.uniform(-1.0, 1.0, len(self._parameters))
            if rng.random() < 0.5:
                direction *= np.arange(len(direction)) == rng.integers(len(direction))
            step = rng.uniform(APART, LONGEST_STEP) * direction / np.abs(direction).max()
            self._try(np.clip(origin + step, 0.0, 1.0))

    def _try(self, place: Array) -> float:
        """Play a robot, keep it if it can be played, and return what CMA-ES is told of it."""
        try:
            one = self._bench.play(from_units(self._parameters, place))
        except ImoloError as error:  # a robot that falls apart in mid-search is a bad one
            if not self._failed:
                logger.warning("%s; the search goes on without this robot and others like it", error)
            self._failed = True
            return FAILED
        self._played.append(one)
        self._tell()
        return loss(self._study, one) + sum(p.surprise(one.settings[p.path]) for p in self._parameters)


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
    if "methods" in study.config:  # which table was asked for the balls
        settings["methods"] = study.config["methods"]
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
                start=played[0].settings[one.path],
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
