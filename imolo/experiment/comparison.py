"""The comparison: the same motions, balls and methods on several backends (Sec. VII, for each of them)."""

import itertools
import json
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import yaml
from joblib import Parallel, delayed
from pydantic import BaseModel, ConfigDict
from threadpoolctl import threadpool_limits

from imolo.backend import TrialKind
from imolo.config.experiment import ExperimentConfig
from imolo.errors import ConfigError, ResultsError
from imolo.experiment.campaign import TrialTask, TrialTiming, hit_tasks, learning_tasks, run_tasks
from imolo.experiment.learning import build_table, learn_ball, learn_motions
from imolo.experiment.metrics import MethodResult, Statistic, judge_campaign, judge_trial
from imolo.experiment.recordings import hand_at, last_plan
from imolo.log import read_log

PACKAGES = ("imolo", "lcm", "numpy", "scipy", "scikit-learn", "filterpy", "numba", "mujoco-core", "pybullet", "dartpy")
AGREEMENT_TIME = 0.17  # [s] after t_w, in the middle of the samples of Sec. VII-B

Progress = Callable[[str, str, int, int], None]
"""Told backend, stage, trials done and trials in all."""


class Timing(BaseModel):
    """How fast it went on this machine; the only numbers that differ between two runs with the same seed.

    Attributes:
        decision_median: Of a planner decision, mocap message in, command out [s].
        decision_p99: 99th percentile of the same [s].
        real_time_factor: Simulated time over real time of one process.
    """

    model_config = ConfigDict(frozen=True)

    decision_median: float
    decision_p99: float
    real_time_factor: float


class Comparison(BaseModel):
    """All results of a comparison.

    Attributes:
        seed: Of all chance.
        versions: Of Python and the packages that were used.
        configs: Hash of the resolved config by backend; the configs lie beside the summary.
        results: By backend, then by method.
        disagreement: Mean distance between the hands of two backends for the same command, `AGREEMENT_TIME` after
            t_w, over the training motions [m]; by "a - b".
        timing: By backend, then by method.
    """

    model_config = ConfigDict(frozen=True)

    seed: int
    versions: dict[str, str]
    configs: dict[str, str]
    results: dict[str, dict[str, MethodResult]]
    disagreement: dict[str, Statistic]
    timing: dict[str, dict[str, Timing]]


@dataclass(frozen=True)
class ResultsFolder:
    """Where everything of one comparison lies."""

    path: Path

    def prepare(self) -> None:
        """Create the folder.

        Raises:
            ResultsError: It cannot be written.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            probe = self.path / ".writable"
            probe.touch()
            probe.unlink()
        except OSError as error:
            raise ResultsError(
                f"cannot write results to {self.path}: {error.strerror}; choose another --out"
            ) from error

    def learning(self, backend: str) -> Path:
        """Return the folder of the logs that a backend learns from."""
        return self.path / "logs" / backend / "learning"

    def hits(self, backend: str, method: str) -> Path:
        """Return the folder of the logs of one method's balls."""
        return self.path / "logs" / backend / method

    def table(self, backend: str, method: str) -> Path:
        """Return the table file of one method."""
        return self.path / "tables" / f"{backend}_{method}.npz"

    @property
    def summary(self) -> Path:
        """Return the file of all numbers."""
        return self.path / "summary.json"

    @property
    def figures(self) -> Path:
        """Return the folder of the figures."""
        return self.path / "figures"


def compare(
    configs: Sequence[ExperimentConfig], folder: ResultsFolder, jobs: int, progress: Progress = lambda *_: None
) -> Comparison:
    """Learn, build tables, throw balls and judge, on every backend.

    Args:
        configs: One per backend, alike but for the backend.
        folder: Where to write logs, tables, configs and the summary.
        jobs: Number of processes.
        progress: Told what is done.

    Raises:
        ImoloError: Something failed; what was recorded until then stays.
    """
    named = {config.backend.name: config for config in configs}
    if len(named) != len(configs):
        raise ConfigError(f"a backend is named twice: {', '.join(config.backend.name for config in configs)}")
    folder.prepare()
    for name, config in named.items():
        _save_config(config, folder.path / "configs" / f"{name}.yaml")
    learning = {name: learning_tasks(config, folder.learning(name)) for name, config in named.items()}
    _run_all(learning, "learning", jobs, progress)
    _learn_all(named, learning, folder, jobs, progress)
    hitting = {
        f"{name} {method}": hit_tasks(config, folder.hits(name, method), method, folder.table(name, method))
        for name, config in named.items()
        for method in config.methods
    }
    timings = _run_all(hitting, "balls", jobs, progress)
    comparison = Comparison(
        seed=configs[0].seed,
        versions=_versions(),
        configs={name: config.digest() for name, config in named.items()},
        results={
            name: {
                method: judge_campaign([judge_trial(read_log(t.log_path), config) for t in hitting[f"{name} {method}"]])
                for method in config.methods
            }
            for name, config in named.items()
        },
        disagreement=_disagreement(learning),
        timing={
            name: {method: _timing(timings[f"{name} {method}"]) for method in config.methods}
            for name, config in named.items()
        },
    )
    folder.summary.write_text(json.dumps(comparison.model_dump(), indent=1) + "\n", encoding="utf-8")
    return comparison


def _run_all(
    groups: Mapping[str, Sequence[TrialTask]], stage: str, jobs: int, progress: Progress
) -> dict[str, list[TrialTiming]]:
    """Run the tasks of all groups together, so that no core waits for the slowest backend."""
    owner = {id(task): name for name, tasks in groups.items() for task in tasks}
    done = dict.fromkeys(groups, 0)
    for name, tasks in groups.items():
        progress(name, stage, 0, len(tasks))

    def count(task: TrialTask) -> None:
        name = owner[id(task)]
        done[name] += 1
        progress(name, stage, done[name], len(groups[name]))

    # Turn by turn through the groups, the longest first within each.
    ordered = [task for turn in itertools.zip_longest(*groups.values()) for task in turn if task is not None]
    timings = dict(zip(map(id, ordered), run_tasks(ordered, jobs, count), strict=True))
    return {name: [timings[id(task)] for task in tasks] for name, tasks in groups.items()}


def _learn_all(
    named: Mapping[str, ExperimentConfig],
    learning: Mapping[str, Sequence[TrialTask]],
    folder: ResultsFolder,
    jobs: int,
    progress: Progress,
) -> None:
    for name in named:
        progress(name, "tables", 0, 1)
    ended = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(
        delayed(_learn)(config, learning[name], folder) for name, config in named.items()
    )
    for name in ended:
        progress(name, "tables", 1, 1)


def _learn(config: ExperimentConfig, tasks: Sequence[TrialTask], folder: ResultsFolder) -> str:
    name = config.backend.name
    # One thread, so that the sums do not depend on the number of cores.
    with threadpool_limits(limits=1):
        ball_model = learn_ball(config, [task.log_path for task in tasks if task.trial.kind is TrialKind.THROW])
        data = learn_motions(config, [task.log_path for task in tasks if task.trial.kind is TrialKind.TRAINING])
        for method_name, method in config.methods.items():
            path = folder.table(name, method_name)
            path.parent.mkdir(parents=True, exist_ok=True)
            build_table(config, method, data, ball_model).save(path)
    return name


def _disagreement(learning: Mapping[str, Sequence[TrialTask]]) -> dict[str, Statistic]:
    hands: dict[str, dict[int, np.ndarray]] = {}
    for name, tasks in learning.items():
        hands[name] = {}
        for task in tasks:
            if task.trial.kind is TrialKind.TRAINING:
                log = read_log(task.log_path)
                plan = last_plan(log)
                if plan is not None:
                    at = plan.plan_onset_utime * 1e-6 + plan.theta[1] + AGREEMENT_TIME
                    hand = hand_at(log, task.config.robot.hand_marker, at)
                    if hand is not None:
                        hands[name][task.trial.index] = hand
    return {
        f"{a} - {b}": Statistic.of(
            [float(np.linalg.norm(hands[a][i] - hands[b][i])) for i in hands[a] if i in hands[b]]
        )
        for a, b in itertools.combinations(hands, 2)
    }


def _timing(timings: Sequence[TrialTiming]) -> Timing:
    decisions = np.concatenate([timing.decisions for timing in timings])
    return Timing(
        decision_median=float(np.median(decisions)),
        decision_p99=float(np.percentile(decisions, 99)),
        real_time_factor=sum(t.simulated for t in timings) / sum(t.elapsed for t in timings),
    )


def _save_config(config: ExperimentConfig, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    content = config.model_dump(mode="json")
    content["backend"].update(config.backend_options().model_dump(mode="json"))
    path.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), encoding="utf-8")


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version(), "platform": sys.platform}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
