"""A study: from its file to fits of every engine, judged on what was held out."""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ParallelConfig
from imolo.config.loading import merged
from imolo.config.yaml_file import dump_yaml
from imolo.errors import IdentificationError
from imolo.identification.evaluation import FAILED, Bench, Outcome, Progress
from imolo.identification.judge import Spread, choose, paired, split, spread
from imolo.identification.parameters import Parameter, Settings, patch
from imolo.identification.solve import FLAT, Fit, explore, interval, judged, solve
from imolo.identification.study_config import StudyConfig

logger = logging.getLogger(__name__)

DEFAULT, SIMPLEST, FULL = "default", "simplest", "full"
FEWEST = 5  # recordings on either side
LOOKED_AT = 20  # recordings that show what can be identified
TIMESTEP = "simulation.timestep"


class FoundParameter(BaseModel):
    """One parameter of a fit.

    Attributes:
        path: Of the setting.
        value: The best one.
        low: Lower end of its 90 % interval.
        high: Upper end.
        searched: Lowest and highest value that was allowed.
        flags: What is to be said of it, such as "at its bound".
    """

    model_config = ConfigDict(frozen=True)

    path: str
    value: float
    low: float
    high: float
    searched: tuple[float, float]
    flags: tuple[str, ...]


class CheckedParameter(BaseModel):
    """What a parameter does where the search starts.

    Attributes:
        path: Of the setting.
        start: Its value there.
        effect: Mean change of the recordings' losses over 5 % of its range, relative to the mean loss.
        like: The parameter whose effect is most like its own; None where there is no other.
        likeness: Cosine of the angle between their effects, -1 to 1; at ±1 only one of the two can be told.
        fitted: Whether it does something, and is fitted.
    """

    model_config = ConfigDict(frozen=True)

    path: str
    start: float
    effect: float
    like: str | None
    likeness: float
    fitted: bool


class Candidate(BaseModel):
    """One fit of one engine, from the settings as they are to all parameters.

    Attributes:
        name: "default", "simplest" or "full".
        parameters: What was fitted.
        training_loss: Mean over the training recordings.
        loss: On the recordings held out.
        sizes: Size of the errors there, by quantity [SI].
        gain: Loss less that of the candidate before it, on the same recordings.
        evaluations: How many sets of settings were played for it on the training recordings, intervals and flags
            included.
        seconds: Processor time of these [s].
    """

    model_config = ConfigDict(frozen=True)

    name: str
    parameters: tuple[FoundParameter, ...]
    training_loss: float
    loss: Spread | None
    sizes: dict[str, Spread | None]
    gain: Spread | None
    evaluations: int
    seconds: float


class EngineResult(BaseModel):
    """What came out for one engine.

    Attributes:
        checked: What can be identified, before anything was fitted.
        candidates: In the order of the number of their parameters.
        taken: Which of them; one with more parameters only if it surely wins on the recordings held out.
        patch: The part of a config that sets what was fitted.
        problem: Why some settings could not be played, and how many; empty where all were.
    """

    model_config = ConfigDict(frozen=True)

    checked: tuple[CheckedParameter, ...]
    candidates: tuple[Candidate, ...]
    taken: str
    patch: dict[str, Any]
    problem: str

    @property
    def best(self) -> Candidate:
        """The candidate that was taken."""
        return next(one for one in self.candidates if one.name == self.taken)


class Difference(BaseModel):
    """Two engines on the same recordings.

    Attributes:
        engines: The two.
        sizes: Second less first, by quantity [SI].
    """

    model_config = ConfigDict(frozen=True)

    engines: tuple[str, str]
    sizes: dict[str, Spread | None]


class FindingShown(BaseModel):
    """What the check of the data found; see `Finding`."""

    model_config = ConfigDict(frozen=True)

    what: str
    text: str
    warning: bool
    recordings: tuple[str, ...]


class Identification(BaseModel):
    """The whole result of a study.

    Attributes:
        title: Of the study.
        findings: What the check of the data found.
        quantities: Name, shown unit and factor to it from SI.
        training: Names of the recordings that were fitted.
        held_out: Names of those it was judged on.
        engines: By label.
        failed: Engines that could not play the recordings at all, and why.
        differences: Each pair of engines, with the candidates that were taken.
    """

    model_config = ConfigDict(frozen=True)

    title: str
    findings: tuple[FindingShown, ...]
    quantities: tuple[tuple[str, str, float], ...]
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    engines: dict[str, EngineResult]
    failed: dict[str, str]
    differences: tuple[Difference, ...]


def identify(
    study: StudyConfig,
    source: Path,
    folder: ResultsFolder,
    jobs: int,
    parallel: ParallelConfig,
    progress: Progress = lambda *_: None,
) -> Identification:
    """Run a study: check the data, check what can be identified, solve, judge.

    What was played is kept in the folder, so that the same study goes on where it stopped.

    Args:
        study: What to fit to what.
        source: The study's file, which paths in it are relative to.
        folder: Where to write everything.
        jobs: Number of processes.
        parallel: Where they run.
        progress: Told what is done.

    Raises:
        ImoloError: The recordings or the parameters cannot be used, or no engine can play them.
    """
    folder.prepare()
    experiment = study.experiment(source.parent)
    study.check_parameters(experiment.configs)
    spurious = {name for finding in experiment.findings if finding.unusable for name in finding.recordings}
    names = [recording.name for recording in experiment.recordings]
    left_out = [index for index, name in enumerate(names) if name in spurious]
    training, held_out = split(len(names), study.training, study.held_out, study.seed, left_out, experiment.apart)
    if min(len(training), len(held_out)) < FEWEST:
        raise IdentificationError(
            f"{len(names)} recordings, {len(left_out)} of them left out, make {len(training)} to fit and "
            f"{len(held_out)} to judge; give at least {FEWEST} for each"
        )
    bench = Bench(experiment, folder.path / "evaluations", jobs, parallel, progress)
    results: dict[str, EngineResult] = {}
    played: dict[str, Outcome] = {}
    failed: dict[str, str] = {}
    for engine in experiment.configs:
        try:
            results[engine], played[engine] = _fit_engine(study, bench, engine, training, held_out)
        except IdentificationError as error:
            failed[engine] = str(error)
            logger.warning("%s", error)
            continue
        with folder.file(f"patches/{engine}.yaml") as file:
            file.write(dump_yaml(results[engine].patch).encode())
    if not results:
        raise IdentificationError("; ".join(failed.values()))
    result = Identification(
        title=study.title or source.stem,
        findings=tuple(
            FindingShown(what=one.what, text=one.text, warning=one.warning, recordings=one.recordings)
            for one in experiment.findings
        ),
        quantities=tuple((one.name, one.unit, one.factor) for one in experiment.quantities),
        training=tuple(experiment.names(training)),
        held_out=tuple(experiment.names(held_out)),
        engines=results,
        failed=failed,
        differences=tuple(_differences(played)),
    )
    folder.save_json("identification.json", result)
    return result


def _fit_engine(
    study: StudyConfig, bench: Bench, engine: str, training: list[int], held_out: list[int]
) -> tuple[EngineResult, Outcome]:
    config = bench.experiment.configs[engine]
    simplest, full = study.parameters_of(config)
    fits: dict[str, tuple[Fit, list[Parameter]]] = {}
    costs: dict[str, tuple[int, float]] = {}
    start = bench.play("as it is", engine, [{}], training)[0]
    if start.mean >= FAILED:
        raise IdentificationError(f"{engine} cannot play any recording as it is: {start.problem}")
    fits[DEFAULT], costs[DEFAULT] = (Fit({}, start.mean, 1), []), (1, start.seconds)
    checked = _check(bench, engine, full, training)
    at_work = {one.path for one in checked if one.fitted}
    simplest, full = ([one for one in some if one.path in at_work] for some in (simplest, full))
    for name, parameters in ((SIMPLEST, simplest), (FULL, full)):
        if parameters and (name == SIMPLEST or len(full) > len(simplest)):
            before = bench.evaluations, bench.seconds
            fits[name] = (fit_parameters(study, bench, engine, parameters, training, name), parameters)
            costs[name] = bench.evaluations - before[0], bench.seconds - before[1]
    outcomes = {
        name: bench.play(f"judging {name}", engine, [fit.settings], held_out)[0] for name, (fit, _) in fits.items()
    }
    taken = choose(outcomes)
    candidates: list[Candidate] = []
    fewer: Outcome | None = None
    for name, (fit, parameters) in fits.items():
        outcome = outcomes[name]
        candidates.append(
            Candidate(
                name=name,
                parameters=tuple(_found(one, fit) for one in parameters),
                training_loss=fit.loss,
                loss=spread(outcome.loss),
                sizes={quantity: spread(values) for quantity, values in outcome.size.items()},
                gain=None if fewer is None else paired(fewer.loss, outcome.loss),
                evaluations=costs[name][0],
                seconds=costs[name][1],
            )
        )
        fewer = outcome
    count, first = bench.problems.get(engine, (0, ""))
    result = EngineResult(
        checked=checked,
        candidates=tuple(candidates),
        taken=taken,
        patch=merged({"backend": config.backend.model_dump()}, patch(fits[taken][0].settings, config)),
        problem=f"{count} sets of settings could not be played whole; of the first one {first}" if count else "",
    )
    return result, outcomes[taken]


def _check(bench: Bench, engine: str, parameters: list[Parameter], training: list[int]) -> tuple[CheckedParameter, ...]:
    """See on a few recordings what each parameter does where the search starts."""
    start = {one.path: one.start for one in parameters}
    some = training[:: max(1, len(training) // LOOKED_AT)]
    local = explore(bench, engine, parameters, start, some, "what can be identified", pairs=False)
    found = []
    for index, one in enumerate(parameters):
        others = np.abs(local.likeness[index])
        others[index] = -1.0
        other = int(others.argmax())
        alone = len(parameters) == 1
        fitted = bool(local.swing[index] >= FLAT)
        if not fitted:
            logger.warning("%s: %s does nothing where it starts and stays at %g", engine, one.path, one.start)
        found.append(
            CheckedParameter(
                path=one.path,
                start=one.start,
                effect=local.swing[index],
                like=None if alone else parameters[other].path,
                likeness=0.0 if alone else local.likeness[index, other],
                fitted=fitted,
            )
        )
    return tuple(found)


def fit_parameters(
    study: StudyConfig, bench: Bench, engine: str, parameters: list[Parameter], training: list[int], name: str
) -> Fit:
    """Return the best settings of some parameters in one engine, and what is to be said of them."""
    parameters = study.prepared(bench, engine, parameters, training)
    fit = solve(bench, engine, parameters, training, study.evaluations, study.seed, f"fitting {name}")
    local = explore(bench, engine, parameters, fit.settings, training, f"slopes of {name}")
    timestep = bench.experiment.configs[engine].simulation.timestep
    halved = None
    if study.halve_timestep:
        change: Settings = {TIMESTEP: 0.5 * timestep}
        halved = explore(bench, engine, parameters, fit.settings, training, f"{name} at half the time step", change)
    return judged(fit, parameters, local, halved, len(training))


def _found(parameter: Parameter, fit: Fit) -> FoundParameter:
    low, high = interval(parameter, fit)
    return FoundParameter(
        path=parameter.path,
        value=fit.settings[parameter.path],
        low=low,
        high=high,
        searched=(parameter.low, parameter.high),
        flags=fit.flags.get(parameter.path, ()),
    )


def _differences(played: Mapping[str, Outcome]) -> list[Difference]:
    names = list(played)
    return [
        Difference(
            engines=(first, second),
            sizes={
                quantity: paired(np.asarray(values), np.asarray(played[second].size[quantity]))
                for quantity, values in played[first].size.items()
            },
        )
        for index, first in enumerate(names)
        for second in names[index + 1 :]
    ]
