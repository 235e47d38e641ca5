"""Run many trials at once, on all cores, and keep what is done when one fails or the user stops."""

import multiprocessing
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from joblib import Parallel, delayed

from imolo.backend import Trial, TrialKind
from imolo.ball.fit import restore_ball_model
from imolo.ball.model import BallModel
from imolo.config.experiment import ExperimentConfig
from imolo.errors import ConfigError
from imolo.experiment.trainer import START_MARGIN, MotionPlayer
from imolo.experiment.trial import Bystander, Controller, run_trial
from imolo.method.planner import Planner
from imolo.method.table import LookupTable
from imolo.registry import load_backend


@dataclass(frozen=True)
class TrialTask:
    """One trial to run.

    Attributes:
        config: Of the experiment.
        trial: Which trial.
        log_path: Log to write.
        method: Name of the method that plans; empty where nothing is planned.
        table_path: Its table; None where nothing is planned.
        duration: Of a training motion's trial [s]; until its last sample if not given.
    """

    config: ExperimentConfig
    trial: Trial
    log_path: Path
    method: str = ""
    table_path: Path | None = None
    duration: float | None = None


@dataclass(frozen=True)
class TrialTiming:
    """How long a trial took; beside the log, since a log holds nothing that depends on the machine.

    Attributes:
        simulated: Simulated time [s].
        elapsed: Real time [s].
        decisions: Real time of each planner decision, mocap message in, command out [s].
    """

    simulated: float
    elapsed: float
    decisions: tuple[float, ...]


def learning_tasks(config: ExperimentConfig, folder: Path) -> list[TrialTask]:
    """Return the throws and the training motions that an experiment learns from."""
    throws = [Trial(TrialKind.THROW, index, config.seed) for index in range(config.campaign.learning_throws)]
    motions = [Trial(TrialKind.TRAINING, index, config.seed) for index in range(len(config.training.motions))]
    return [TrialTask(config, trial, folder / log_name(trial)) for trial in (*throws, *motions)]


def hit_tasks(config: ExperimentConfig, folder: Path, method: str, table_path: Path) -> list[TrialTask]:
    """Return the trials in which a method is to hit the balls."""
    trials = [Trial(TrialKind.HIT, index, config.seed) for index in range(config.campaign.balls)]
    return [TrialTask(config, trial, folder / log_name(trial), method, table_path) for trial in trials]


def log_name(trial: Trial) -> str:
    """Return the file name of a trial's log."""
    return f"{trial.kind.value}_{trial.index:03d}.lcmlog"


def run_tasks(
    tasks: Sequence[TrialTask], jobs: int, on_done: Callable[[TrialTask], None] = lambda _: None
) -> list[TrialTiming]:
    """Run trials in parallel; the logs do not depend on the number of processes.

    Args:
        tasks: What to run.
        jobs: Number of processes.
        on_done: Called after each trial, in the order in which they end.

    Returns:
        The timings in the order of the tasks.

    Raises:
        ConfigError: Several processes would share one bus.
        ImoloError: A trial failed; the logs of the others stay.
    """
    shared = next((task.config.bus for task in tasks if not task.config.bus.startswith("memq:")), None)
    if shared is not None and jobs > 1:
        raise ConfigError(
            f"trials run at once would mix their messages on the bus {shared!r}; give --jobs 1 or memq://"
        )
    timings: dict[int, TrialTiming] = {}
    ended: Iterable[tuple[int, TrialTiming]] = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(
        delayed(_run_numbered)(number, task) for number, task in enumerate(tasks)
    )
    for number, timing in ended:
        timings[number] = timing
        on_done(tasks[number])
    return [timings[number] for number in range(len(tasks))]


def leave_interrupts_to_the_parent() -> None:
    """Let Ctrl-C end the process that was started, which then ends its workers, without a word from these."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run_numbered(number: int, task: TrialTask) -> tuple[int, TrialTiming]:
    leave_interrupts_to_the_parent()
    return number, run_task(task)


def run_task(task: TrialTask) -> TrialTiming:
    """Run one trial in this process."""
    config, trial = task.config, task.trial
    controller: Controller = Bystander()
    duration = config.campaign.duration
    decisions: list[float] = []
    if trial.kind is TrialKind.TRAINING:
        theta = config.training.motions[trial.index]
        controller = MotionPlayer(config.motion, theta)
        duration = task.duration or START_MARGIN + theta.t_w + config.training.sampled_to
    elif task.table_path is not None:
        table, ball_model = load_learned(task.table_path, config.robot.name)
        controller = Planner(table, ball_model, config.methods[task.method].planner, config.tracker, decisions.append)
        if not load_backend(config.backend.name).simulated:
            controller.warm_up()
    begin = time.perf_counter()
    simulated = run_trial(config, trial, controller, task.log_path, duration)
    return TrialTiming(simulated, time.perf_counter() - begin, tuple(decisions))


def load_learned(path: Path, robot: str) -> tuple[LookupTable, BallModel]:
    """Return the table of a file and the ball model it was learned with.

    Raises:
        TableFileError: The file cannot be read, or is for another robot.
    """
    modified = path.stat().st_mtime_ns if path.is_file() else 0
    return _load(path, modified, robot)


@lru_cache(maxsize=8)
def _load(path: Path, _modified: int, robot: str) -> tuple[LookupTable, BallModel]:
    table = LookupTable.load(path, robot)
    return table, restore_ball_model(table.origin["ball_model"])
