"""How many trials does a body need? Hand error against number of trials, for models with and without a prior.

Every motion of a backend is executed once: the dense ones that make it a prior for others, the trials (Table III, then
others drawn at random), those that an active choice may pick from, and those that all models are tested on.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import islice
from typing import Generic, TypeVar

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from threadpoolctl import threadpool_limits

from imolo.campaigns.campaign import leave_interrupts_to_the_parent
from imolo.campaigns.comparison import Progress
from imolo.campaigns.motion_recorder import Recording, Window, record_motions, without_chance
from imolo.campaigns.results import ResultsFolder, installed_versions
from imolo.config.experiment import ExperimentConfig
from imolo.errors import ConfigError
from imolo.method.active import least_certain
from imolo.method.forward_model import GPR, PAPER_SVR, ForwardModel
from imolo.method.motion import MotionTemplate, Theta
from imolo.method.prior import MOST_SAMPLES
from imolo.method.regressors import quiet_fits
from imolo.studies.interpolation import draw_theta
from imolo.trials.learning import spread_motions
from imolo.trials.metrics import Statistic

Array = NDArray[np.float64]
Item = TypeVar("Item")

MODEL = GPR.model_copy(update={"kernel": "matern", "time": "since_swing"})
PAPER, PLAIN, ACTIVE = "paper's SVR", "GPR", "GPR, active"
START = 5  # trials before the first active choice: the corners and one inside
REPEATED, REPEATS = 6, 8  # motions, and how often each is executed to see how well the backend repeats itself
UNDISTURBED, CONFIGURED = "undisturbed", "as configured"


def upon(prior: str, *, active: bool = False) -> str:
    """Return the name of the model that corrects a prior."""
    return f"upon {prior}, active" if active else f"upon {prior}"


class Sizes(BaseModel):
    """How many motions are executed beside the trials.

    Attributes:
        dense: For a prior.
        candidates: That an active choice may pick from.
        tests: That the models are tested on.
    """

    model_config = ConfigDict(frozen=True)

    dense: int
    candidates: int
    tests: int


class Point(BaseModel):
    """One model after some trials.

    Attributes:
        backend: That the trials were made on.
        setting: "undisturbed", or "as configured".
        model: Its name.
        prior: Backend of the prior, if any.
        trials: Their number; 0 is the prior alone.
        error: Distance between the predicted hand and the recorded one, mean over the samples of a motion, of all
            test motions [m].
        nees: Squared error over its predicted variance, mean over samples and axes; 1 is honest. None without variance.
    """

    model_config = ConfigDict(frozen=True)

    backend: str
    setting: str
    model: str
    prior: str | None
    trials: int
    error: Statistic
    nees: float | None


class Floor(BaseModel):
    """How well a backend repeats a motion as configured: what no model can predict.

    Attributes:
        backend: Its name.
        error: Distance of the hand to its mean over the executions of the same motion [m].
    """

    model_config = ConfigDict(frozen=True)

    backend: str
    error: Statistic


class SampleEfficiency(BaseModel):
    """Hand error against number of trials.

    Attributes:
        seed: Of all chance.
        sizes: How many motions were executed beside the trials.
        versions: Of Python and the packages that were used.
        configs: Hash of the config by backend.
        points: All models after all numbers of trials.
        floors: How well each backend repeats itself.
    """

    model_config = ConfigDict(frozen=True)

    seed: int
    sizes: Sizes
    versions: dict[str, str]
    configs: dict[str, str]
    points: tuple[Point, ...]
    floors: tuple[Floor, ...]

    def floor(self, backend: str, setting: str) -> float | None:
        """Return the mean distance of the hand to its mean over repetitions [m]; 0 where nothing is left to chance."""
        return 0.0 if setting == UNDISTURBED else next(f.error.mean for f in self.floors if f.backend == backend)

    def curve(self, backend: str, setting: str, model: str) -> list[Point]:
        """Return the points of one model in order of the trials."""
        key = (backend, setting, model)
        return sorted(
            (p for p in self.points if (p.backend, p.setting, p.model) == key), key=lambda point: point.trials
        )


@dataclass(frozen=True)
class Motions(Generic[Item]):
    """What is executed on every backend: motions, or their recordings.

    Attributes:
        dense: For the prior.
        trials: In the order in which they are made.
        candidates: That an active choice may pick from.
        tests: That the models are tested on.
        repeated: Each several times.
    """

    dense: Sequence[Item]
    trials: Sequence[Item]
    candidates: Sequence[Item]
    tests: Sequence[Item]
    repeated: Sequence[Item]


def choose_motions(config: ExperimentConfig, most: int, sizes: Sizes) -> Motions[Theta]:
    """Return what is executed; the same for every backend.

    Args:
        config: For its seed, and the trials of its training.
        most: Largest number of trials.
        sizes: How many of the others.
    """
    rng = np.random.default_rng(np.random.SeedSequence([config.seed, 7]))
    grid = next(iter(config.methods.values())).grid
    drawn = draw_theta(config.motion, grid, most + sizes.candidates + sizes.tests, rng)
    return Motions(
        dense=spread_motions(config, sizes.dense),
        trials=(*config.training.motions, *drawn[:most])[:most],
        candidates=drawn[most : most + sizes.candidates],
        tests=drawn[most + sizes.candidates :],
        repeated=[theta for theta in drawn[:REPEATED] for _ in range(REPEATS)],
    )


def study(
    configs: Sequence[ExperimentConfig],
    trials: Sequence[int],
    sizes: Sizes,
    folder: ResultsFolder,
    jobs: int,
    progress: Progress = lambda *_: None,
) -> SampleEfficiency:
    """Record the motions of every backend, undisturbed and as configured, fit all models and write trials.json.

    Args:
        configs: One per backend.
        trials: Numbers of trials.
        sizes: How many motions are executed beside them.
        folder: Where to write configs, logs and numbers.
        jobs: Number of processes.
        progress: Told what is done.

    Raises:
        ConfigError: A number of trials cannot be served, or a backend is named twice.
        ImoloError: A trial failed; what was recorded until then stays.
    """
    named = {config.backend.name: config for config in configs}
    if len(named) != len(configs):
        raise ConfigError(f"a backend is named twice: {', '.join(config.backend.name for config in configs)}")
    if min(trials) < START:
        raise ConfigError(f"{min(trials)} trials are too few to choose the next one; give {START} or more")
    if sizes.candidates < max(trials) - START:
        raise ConfigError(
            f"{sizes.candidates} candidates cannot serve {max(trials)} trials; give {max(trials) - START} or more"
        )
    folder.prepare()
    for config in configs:
        folder.save_config(config)
    motions = choose_motions(configs[0], max(trials), sizes)
    window = Window(configs[0].training.sampled_from, configs[0].training.sampled_to)
    points: list[Point] = []
    for setting in (UNDISTURBED, CONFIGURED):
        if setting == UNDISTURBED:
            told = {name: without_chance(config) for name, config in named.items()}
            executed = replace(motions, repeated=())  # a motion that is executed again goes as it went
        else:
            told, executed = named, motions
        records = {name: _record(config, executed, setting, folder, jobs, progress) for name, config in told.items()}
        points += _fit_all(records, configs[0].motion, setting, trials, window, jobs, progress)
    floors = tuple(
        Floor(backend=name, error=repeatability(record.repeated, configs[0].motion, window))
        for name, record in records.items()
    )
    result = SampleEfficiency(
        seed=configs[0].seed,
        sizes=sizes,
        versions=installed_versions(named),
        configs={name: config.digest() for name, config in named.items()},
        points=tuple(points),
        floors=floors,
    )
    folder.save_json("trials.json", result)
    return result


def active_trials(
    model: ForwardModel,
    start: Sequence[Recording],
    candidates: Sequence[Recording],
    window: Window,
    searched: Collection[int],
) -> Iterator[tuple[list[Recording], ForwardModel]]:
    """Add one candidate after the other, each time the one that the model is least certain of.

    Args:
        model: Unfitted, perhaps upon a prior.
        start: Trials that are made without a choice.
        candidates: What may be chosen; only the motion is looked at before it is.
        window: When the hand matters.
        searched: Numbers of trials with which a kernel is searched for; with the others the last one is kept.

    Yields:
        The trials so far and the model fitted to them, from the start set on.
    """
    times = np.linspace(window.start, window.stop, 4).tolist()
    done, left = list(start), list(candidates)
    fitted = fit(model, done, window)
    while True:
        yield list(done), fitted
        if not left:
            return
        motions = np.array([recording.theta for recording in left])
        done.append(left.pop(least_certain(fitted, motions, times)))
        if len(done) in searched:
            fitted = fit(model, done, window)
        else:
            data = window.samples(done, model.template)
            fitted = fitted.refitted(data.theta, data.time, data.position)


def fit(model: ForwardModel, recordings: Sequence[Recording], window: Window) -> ForwardModel:
    """Return a model like this one, fitted to the samples of recordings."""
    data = window.samples(recordings, model.template).thinned(MOST_SAMPLES)
    return ForwardModel(model.config, model.template, model.prior).fit(data.theta, data.time, data.position)


def repeatability(recordings: Sequence[Recording], motion: MotionTemplate, window: Window) -> Statistic:
    """Return how far the hand is from its mean over the executions of the same motion, in the middle of the window."""
    motions: dict[Theta, list[Array]] = {}
    for recording in recordings:
        middle = motion.swing_of(recording.theta) + 0.5 * (window.start + window.stop)
        motions.setdefault(recording.theta, []).append(recording.hand(middle))
    distances = []
    for hands in motions.values():
        off = np.array(hands) - np.mean(hands, axis=0)
        # The mean of a few executions is nearer to each of them than the true one.
        distances += (np.linalg.norm(off, axis=1) * np.sqrt(len(hands) / (len(hands) - 1))).tolist()
    return Statistic.of(distances)


def rate(model: ForwardModel, tests: Sequence[Recording], window: Window) -> tuple[Statistic, float | None]:
    """Return the error of a model on recordings, and its squared error over the predicted variance; see `Point`."""
    distances, squares = [], []
    for recording in tests:
        data = window.samples([recording], model.template)
        off = model.predict(data.theta, data.time) - data.position
        distances.append(float(np.linalg.norm(off, axis=1).mean()))
        if model.knows_std:
            squares.append(float(((off / model.predict_std(data.theta, data.time)) ** 2).mean()))
    return Statistic.of(distances), float(np.mean(squares)) if squares else None


def _record(
    config: ExperimentConfig,
    motions: Motions[Theta],
    setting: str,
    folder: ResultsFolder,
    jobs: int,
    progress: Progress,
) -> Motions[Recording]:
    """Execute all motions in one session, so that no two of them meet the same chance."""
    name = config.backend.name
    groups = [getattr(motions, field.name) for field in fields(motions)]
    recordings = iter(
        record_motions(
            config,
            [
                (theta, config.motion.swing_of(theta) + config.training.sampled_to)
                for group in groups
                for theta in group
            ],
            folder.path / "logs" / name / f"trials_{setting.replace(' ', '_')}",
            jobs,
            lambda done, total: progress(f"{name}: motions, {setting}", done, total),
        )
    )
    return Motions(*(list(islice(recordings, len(group))) for group in groups))


def _fit_all(
    records: Mapping[str, Motions[Recording]],
    motion: MotionTemplate,
    setting: str,
    trials: Sequence[int],
    window: Window,
    jobs: int,
    progress: Progress,
) -> list[Point]:
    label = f"models, {setting}"
    plan = [(name, prior) for name in records for prior in (None, *records) if prior != name]
    progress(label, 0, len(plan))
    priors = Parallel(n_jobs=jobs)(delayed(_fit_prior)(record.dense, motion, window) for record in records.values())
    known: dict[str | None, ForwardModel | None] = {None: None, **dict(zip(records, priors, strict=True))}
    curves = Parallel(n_jobs=jobs, return_as="generator", batch_size=1)(
        delayed(_curves)(name, motion, setting, prior, known[prior], records[name], trials, window)
        for name, prior in plan
    )
    points: list[Point] = []
    for number, curve in enumerate(curves, start=1):
        points += curve
        progress(label, number, len(plan))
    return points


def _fit_prior(dense: Sequence[Recording], motion: MotionTemplate, window: Window) -> ForwardModel:
    leave_interrupts_to_the_parent()
    with threadpool_limits(limits=1), quiet_fits():
        return fit(ForwardModel(MODEL, motion), dense, window)


def _curves(
    name: str,
    motion: MotionTemplate,
    setting: str,
    prior: str | None,
    prior_model: ForwardModel | None,
    records: Motions[Recording],
    trials: Sequence[int],
    window: Window,
) -> list[Point]:
    """Return the curves of one backend upon one prior, or those without."""
    leave_interrupts_to_the_parent()
    points: list[Point] = []

    def tell(label: str, count: int, model: ForwardModel) -> None:
        error, nees = rate(model, records.tests, window)
        points.append(
            Point(backend=name, setting=setting, model=label, prior=prior, trials=count, error=error, nees=nees)
        )

    # One thread, so that the sums do not depend on the number of cores.
    with threadpool_limits(limits=1), quiet_fits():
        model = ForwardModel(MODEL, motion, prior_model)
        listed = {PLAIN if prior is None else upon(prior): model}
        if prior_model is None:
            listed[PAPER] = ForwardModel(PAPER_SVR, motion)
        else:
            tell(upon(prior or ""), 0, prior_model)
        for label, unfitted in listed.items():
            for count in trials:
                tell(label, count, fit(unfitted, records.trials[:count], window))
        label = ACTIVE if prior is None else upon(prior, active=True)
        for done, fitted in active_trials(model, records.trials[:START], records.candidates, window, trials):
            if len(done) in trials:
                tell(label, len(done), fitted)
            if len(done) >= max(trials):
                break
    return points
