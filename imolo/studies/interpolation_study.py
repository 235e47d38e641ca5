"""Fig. 7 on a backend: record a pool of motions, let the tables choose, and execute what they chose."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from threadpoolctl import threadpool_limits

from imolo.campaigns.campaign import leave_interrupts_to_the_parent
from imolo.campaigns.motion_recorder import Recording, Window, record_motions, without_chance
from imolo.campaigns.results import ResultsFolder, installed_versions
from imolo.config.experiment import ExperimentConfig
from imolo.errors import ConfigError
from imolo.method.motion import MotionTemplate, Theta
from imolo.method.regressors import quiet_fits
from imolo.method.table_grid import TableGrid
from imolo.studies.interpolation import (
    Answer,
    Interpolation,
    Problem,
    answer,
    draw_problem,
    draw_theta,
    judge,
)

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], object]


class InterpolationStudy(BaseModel):
    """Fig. 7 for several backends.

    Attributes:
        seed: Of the draws.
        repetitions: For each number of trials.
        pool: Number of random motions that queries and training trials are drawn from.
        versions: Of Python and the packages that were used.
        configs: Hash of the config by backend, chance switched off.
        results: By backend.
    """

    model_config = ConfigDict(frozen=True)

    seed: int
    repetitions: int
    pool: int
    versions: dict[str, str]
    configs: dict[str, str]
    results: dict[str, Interpolation]


def study(
    configs: Sequence[ExperimentConfig],
    trials: Sequence[int],
    repetitions: int,
    pool: int,
    folder: ResultsFolder,
    jobs: int,
    progress: Progress = lambda *_: None,
) -> InterpolationStudy:
    """Make Fig. 7 for every backend and write interpolation.json.

    Args:
        configs: One per backend; disturbance and camera noise are switched off.
        trials: Numbers of training trials N_t.
        repetitions: For each of them.
        pool: Number of random motions to record; more than the most trials.
        folder: Where to write configs, logs and numbers.
        jobs: Number of processes.
        progress: Told what is done.

    Raises:
        ConfigError: The pool is too small, or a backend is named twice.
        ImoloError: A trial failed; what was recorded until then stays.
    """
    named = {config.backend.name: without_chance(config) for config in configs}
    if len(named) != len(configs):
        raise ConfigError(f"a backend is named twice: {', '.join(config.backend.name for config in configs)}")
    if pool <= max(trials):
        raise ConfigError(
            f"a pool of {pool} motions has no {max(trials)} trials and a query; give --pool {max(trials) + 1} or more"
        )
    folder.prepare()
    for config in named.values():
        folder.save_config(config)
    result = InterpolationStudy(
        seed=configs[0].seed,
        repetitions=repetitions,
        pool=pool,
        versions=installed_versions(named),
        configs={name: config.digest() for name, config in named.items()},
        results={
            name: _study_one(config, trials, repetitions, pool, folder, jobs, progress)
            for name, config in named.items()
        },
    )
    folder.save_json("interpolation.json", result)
    return result


def _study_one(
    config: ExperimentConfig,
    trials: Sequence[int],
    repetitions: int,
    pool_size: int,
    folder: ResultsFolder,
    jobs: int,
    progress: Progress,
) -> Interpolation:
    name, seed = config.backend.name, config.seed
    window = Window(config.training.sampled_from, config.training.sampled_to)

    def record(kind: str, until: Mapping[Theta, float]) -> list[Recording]:
        if not until:
            return []
        logs = folder.path / "logs" / name / f"interpolation_{kind}"
        label = f"{name}: motions, {kind}"
        return record_motions(config, list(until.items()), logs, jobs, lambda *count: progress(label, *count))

    # That of Sec. VII-B; the paper names none for Sec. VI.
    motion, grid = config.motion, next(iter(config.methods.values())).grid
    motions = draw_theta(motion, grid, pool_size, np.random.default_rng(np.random.SeedSequence([seed, pool_size])))
    pool = record("pool", {theta: motion.swing_of(theta) + window.stop for theta in motions})
    problems = [draw_problem(pool, motion, window, n, r, seed) for n in trials for r in range(repetitions)]
    label = f"{name}: tables"
    progress(label, 0, len(problems))
    answers: dict[int, Answer] = {}
    found = Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(_answer)(number, problem, pool, motion, window, grid) for number, problem in enumerate(problems)
    )
    for number, one in found:
        answers[number] = one
        progress(label, len(answers), len(problems))
    ordered = [answers[number] for number in range(len(problems))]
    recorded = {recording.theta: recording for recording in pool}
    until: dict[Theta, float] = {}
    for problem, one in zip(problems, ordered, strict=True):
        for choice in one.choices.values():
            known = recorded.get(choice.theta)
            # Nothing is left to chance, so a motion that is executed again goes as it was recorded.
            if known is None or not known.covers(problem.time):
                until[choice.theta] = max(until.get(choice.theta, 0.0), problem.time)
    recorded.update({recording.theta: recording for recording in record("chosen", until)})
    return judge(problems, ordered, lambda theta, time: recorded[theta].hand(time))


def _answer(
    number: int,
    problem: Problem,
    pool: Sequence[Recording],
    motion: MotionTemplate,
    window: Window,
    grid: TableGrid,
) -> tuple[int, Answer]:
    leave_interrupts_to_the_parent()
    # One thread, so that the sums do not depend on the number of cores.
    with threadpool_limits(limits=1), quiet_fits():
        return number, answer(problem, pool, motion, window, grid)
