"""The comparison: the same motions, balls and methods on several backends (Sec. VII, for each of them)."""

from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import TypeVar

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, NonNegativeFloat, NonNegativeInt
from threadpoolctl import threadpool_limits

from imolo.campaigns.campaign import (
    TrialTask,
    hit_tasks,
    learning_tasks,
    leave_interrupts_to_the_parent,
    run_tasks,
    with_absolute_paths,
)
from imolo.campaigns.dense_motions import play_motions, read_samples
from imolo.campaigns.kept_trials import TrialTiming
from imolo.campaigns.results import ResultsFolder, installed_versions
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import backend_plugin
from imolo.contracts.registry import PLANNERS
from imolo.contracts.trial import TrialKind
from imolo.errors import ConfigError
from imolo.messaging.log import read_log
from imolo.method.learned import load_learned
from imolo.trials.learning import build_table, learn_ball, learn_motions
from imolo.trials.metrics import MethodResult, Statistic, TrialResult, judge_campaign, judge_trial
from imolo.trials.recordings import SHOWN, hand_in_swing

Array = NDArray[np.float64]
Group = TypeVar("Group", bound=Hashable)

Progress = Callable[[str, int, int], None]
"""Told what is under way, how much of it is done, and how much there is."""


class Timing(BaseModel):
    """How fast it went on this machine.

    Attributes:
        decision_median: Of a planner decision, mocap message in, command out [s].
        decision_p99: 99th percentile of the same [s].
        real_time_factor: Simulated time over real time of one process.
    """

    model_config = ConfigDict(frozen=True)

    decision_median: NonNegativeFloat
    decision_p99: NonNegativeFloat
    real_time_factor: NonNegativeFloat


class Timings(BaseModel):
    """How fast it went, by backend, then by method: all that differs between two runs with the same seed."""

    model_config = ConfigDict(frozen=True)

    timing: dict[str, dict[str, Timing]]


class Comparison(BaseModel):
    """All results of a comparison; the same seed gives the same numbers to the last digit.

    Attributes:
        seed: Of all chance.
        versions: Of Python and the packages that were used.
        configs: Hash of the resolved config by backend; the configs lie beside the summary.
        results: By backend, then by method.
        disagreement: Distance between the hands of two backends for the same command in the middle of the swing, over
            the training motions [m]; by "a - b".
        robot: Its name.
        task: Name of the task.
    """

    model_config = ConfigDict(frozen=True)

    seed: NonNegativeInt
    versions: dict[str, str]
    configs: dict[str, str]
    results: dict[str, dict[str, MethodResult]]
    disagreement: dict[str, Statistic]
    robot: str = ""
    task: str = ""


def _no_progress(what: str, done: int, total: int) -> None: ...


def compare(
    configs: Sequence[ExperimentConfig], folder: ResultsFolder, jobs: int, progress: Progress = _no_progress
) -> tuple[Comparison, Timings]:
    """Learn, build tables, throw balls and judge, on every backend.

    Args:
        configs: One per backend, alike but for the backend.
        folder: Where to write logs, tables, configs, summary.json and timing.json.
        jobs: Number of processes.
        progress: Told what is done.

    Raises:
        ImoloError: Something failed; what was recorded until then stays.
    """
    named = {config.backend.name: config for config in configs}
    if len(named) != len(configs):
        raise ConfigError(f"a backend is named twice: {', '.join(config.backend.name for config in configs)}")
    for config in configs[1:]:
        for key, value in configs[0]:
            if key != "backend" and getattr(config, key) != value:
                raise ConfigError(
                    f"the configs of {configs[0].backend.name!r} and {config.backend.name!r} differ in {key!r}; a "
                    "comparison needs them alike but for their backend"
                )
    disagreement = learn(configs, folder, jobs, progress)
    tables = {(name, method): folder.table(name, method) for name, config in named.items() for method in config.methods}
    results, timing = hit(named, tables, folder, jobs, progress)
    comparison = summarise(named, results, disagreement)
    timings = Timings(timing=timing)
    folder.save_json("summary.json", comparison)
    folder.save_json("timing.json", timings)
    return comparison, timings


def summarise(
    configs: Mapping[str, ExperimentConfig],
    results: dict[str, dict[str, MethodResult]],
    disagreement: dict[str, Statistic],
) -> Comparison:
    """Return results with what they come from; arguments as the attributes of `Comparison`, configs by backend."""
    first = next(iter(configs.values()))
    return Comparison(
        seed=first.seed,
        versions=installed_versions(configs),
        configs={name: config.digest() for name, config in configs.items()},
        results=results,
        disagreement=disagreement,
        robot=first.robot.name,
        task=first.task.name,
    )


def learn(
    configs: Sequence[ExperimentConfig],
    folder: ResultsFolder,
    jobs: int,
    progress: Progress = _no_progress,
    dense: bool = False,
) -> dict[str, Statistic]:
    """Run the learning trials of every backend and build the table of each of its methods.

    Args:
        configs: One per backend.
        folder: Where to write logs, tables and configs.
        jobs: Number of processes.
        progress: Told what is done.
        dense: Whether simulated motions go without a bus and logs, see `play_motions`; the tables are the same.

    Returns:
        How far the hands of two backends are apart for the same command, see `Comparison.disagreement`.

    Raises:
        ImoloError: Something failed; what was recorded until then stays.
    """
    folder.prepare()
    unlogged = [config for config in configs if dense and backend_plugin(config).simulated]
    tasks = {
        config.backend.name: learning_tasks(config, folder.learning(config.backend.name), config in unlogged)
        for config in configs
    }
    _run_groups(tasks, lambda name: f"{name}: learning trials", jobs, progress)
    samples = {}
    for config in unlogged:
        name = config.backend.name
        samples[name] = play_motions(
            config, folder.learning(name), jobs, partial(progress, f"{name}: motions without logs")
        )
    for config in configs:
        # Not before: a folder that holds another campaign is refused as it is.
        folder.save_config(config)
        progress(f"{config.backend.name}: tables", 0, len(config.methods))
    # Processes that are left of another campaign may be in another folder.
    absolute = ResultsFolder(folder.path.absolute())
    built = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(
        delayed(_build_table)(
            config,
            method,
            list(map(with_absolute_paths, tasks[config.backend.name])),
            samples.get(config.backend.name, []),
            absolute,
        )
        for config in configs
        for method in config.methods
    )
    done: Counter[str] = Counter()
    methods = {config.backend.name: len(config.methods) for config in configs}
    for name in built:
        done[name] += 1
        progress(f"{name}: tables", done[name], methods[name])
    return _disagreement(tasks)


def hit(
    named: Mapping[str, ExperimentConfig],
    tables: Mapping[tuple[str, str], Path],
    folder: ResultsFolder,
    jobs: int,
    progress: Progress = _no_progress,
) -> tuple[dict[str, dict[str, MethodResult]], dict[str, dict[str, Timing]]]:
    """Throw the balls, let the robot hit them with tables that are there, and judge by the logs.

    Args:
        named: Configs by backend.
        tables: Table file by backend and method.
        folder: Where to write the logs.
        jobs: Number of processes.
        progress: Told what is done.

    Returns:
        Results and timing by backend, then by method.

    Raises:
        ImoloError: Something failed; what was recorded until then stays.
    """
    tasks = {
        (name, method): hit_tasks(named[name], folder.hits(name, method), method, path)
        for (name, method), path in tables.items()
    }
    timings = _run_groups(tasks, lambda group: f"{group[0]}: balls, method {group[1]}", jobs, progress)
    results: dict[str, dict[str, MethodResult]] = {name: {} for name, _ in tables}
    timing: dict[str, dict[str, Timing]] = {name: {} for name, _ in tables}
    for (name, method), group in tasks.items():
        trials = Parallel(n_jobs=jobs)(delayed(_judge)(task) for task in map(with_absolute_paths, group))
        results[name][method] = judge_campaign(trials)
        timing[name][method] = _timing(timings[name, method])
    return results, timing


def _judge(task: TrialTask) -> TrialResult:
    leave_interrupts_to_the_parent()
    config = task.config
    learns = PLANNERS.load(config.methods[task.method].controller.name).learns
    table = (
        load_learned(task.table_path, config.robot.name, type(config.motion))[0] if learns and task.table_path else None
    )
    return judge_trial(read_log(task.log_path), config, config.methods[task.method], table)


def _run_groups(
    groups: Mapping[Group, Sequence[TrialTask]], label: Callable[[Group], str], jobs: int, progress: Progress
) -> dict[Group, list[TrialTiming]]:
    """Run the tasks of all groups, one group after the other: a process then needs one table at a time."""
    owner = {id(task): group for group, tasks in groups.items() for task in tasks}
    done = dict.fromkeys(groups, 0)
    for group, tasks in groups.items():
        progress(label(group), 0, len(tasks))

    def count(task: TrialTask) -> None:
        group = owner[id(task)]
        done[group] += 1
        progress(label(group), done[group], len(groups[group]))

    ordered = [task for tasks in groups.values() for task in tasks]
    timings = dict(zip(map(id, ordered), run_tasks(ordered, jobs, count), strict=True))
    return {group: [timings[id(task)] for task in tasks] for group, tasks in groups.items()}


def _build_table(
    config: ExperimentConfig,
    method_name: str,
    tasks: Sequence[TrialTask],
    samples: Sequence[Path],
    folder: ResultsFolder,
) -> str:
    leave_interrupts_to_the_parent()
    name, method = config.backend.name, config.methods[method_name]
    # One thread, so that the sums do not depend on the number of cores.
    with threadpool_limits(limits=1):
        throws = [task.log_path for task in tasks if task.trial.kind is TrialKind.THROW]
        logs = [task.log_path for task in tasks if task.trial.kind is TrialKind.TRAINING]
        data = read_samples(samples) if samples else learn_motions(config, logs)
        path = folder.table(name, method_name)
        path.parent.mkdir(parents=True, exist_ok=True)
        build_table(config, method, data, learn_ball(method, throws)).save(path)
    return name


def _disagreement(learning: Mapping[str, Sequence[TrialTask]]) -> dict[str, Statistic]:
    hands = {name: _training_hands(tasks) for name, tasks in learning.items()}
    return {
        f"{a} - {b}": Statistic.of(
            [float(np.linalg.norm(hands[a][i] - hands[b][i])) for i in hands[a] if i in hands[b]]
        )
        for a, b in combinations(hands, 2)
    }


def _training_hands(tasks: Sequence[TrialTask]) -> dict[int, Array]:
    training = [task for task in tasks if task.trial.kind is TrialKind.TRAINING]
    hands = {t.trial.index: hand_in_swing(read_log(t.log_path, SHOWN), t.config) for t in training}
    return {index: hand for index, hand in hands.items() if hand is not None}


def _timing(timings: Sequence[TrialTiming]) -> Timing:
    decisions = np.concatenate([timing.decisions for timing in timings])
    return Timing(
        decision_median=float(np.median(decisions)),
        decision_p99=float(np.percentile(decisions, 99)),
        real_time_factor=sum(t.simulated for t in timings) / sum(t.elapsed for t in timings),
    )
