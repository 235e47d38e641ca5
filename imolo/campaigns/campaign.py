"""Run many trials at once, on all cores or machines, and keep what is done when one fails or the user stops."""

import contextlib
import logging
import multiprocessing
import signal
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from imolo.campaigns.kept_trials import (
    TrialTiming,
    discard_partial,
    environment,
    file_digest,
    keep,
    kept,
    partial_path,
    partial_paths,
    plugin_code,
    set_aside,
    writing,
)
from imolo.campaigns.workers import run_on_cores, run_on_dask
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import backend_plugin
from imolo.contracts.planner import Controller
from imolo.contracts.registry import BACKENDS, PLANNERS
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import BusError, ConfigError, TrialVoidError, WorkerError
from imolo.machine.priority import BACKEND_PRIORITY, claimed_priority
from imolo.messaging.log import LOG_SUFFIX
from imolo.trials.trainer import START_MARGIN, MotionPlayer
from imolo.trials.trial import Bystander, run_trial

logger = logging.getLogger(__name__)

ARRIVAL = 10.0  # [s] a shared file system may take to show what another machine wrote
_ONE_TRIAL_AT_A_TIME = threading.Lock()


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


def learning_tasks(config: ExperimentConfig, folder: Path, throws_alone: bool = False) -> list[TrialTask]:
    """Return the throws and the training motions that an experiment learns from."""
    throws = [Trial(TrialKind.THROW, index, config.seed) for index in range(config.campaign.learning_throws)]
    count = 0 if throws_alone else len(config.training.motions)
    motions = [Trial(TrialKind.TRAINING, index, config.seed) for index in range(count)]
    return [TrialTask(config, trial, folder / log_name(trial)) for trial in (*throws, *motions)]


def hit_tasks(config: ExperimentConfig, folder: Path, method: str, table_path: Path) -> list[TrialTask]:
    """Return the trials in which a method is to hit the balls."""
    trials = [Trial(TrialKind.HIT, index, config.seed) for index in range(config.campaign.balls)]
    return [TrialTask(config, trial, folder / log_name(trial), method, table_path) for trial in trials]


def log_name(trial: Trial) -> str:
    """Return the file name of a trial's log."""
    return f"{trial.kind.value}_{trial.index:03d}{LOG_SUFFIX}"


def run_tasks(
    tasks: Sequence[TrialTask], jobs: int, on_done: Callable[[TrialTask], None] = lambda _: None
) -> list[TrialTiming]:
    """Run trials where `campaign.parallel` says; the logs depend neither on that nor on the number of processes.

    Trials whose complete logs are there are not run again. A trial whose process dies is repeated.

    Args:
        tasks: What to run.
        jobs: Number of processes, or -1 for one per core; a cluster has as many as it has, a robot needs one.
        on_done: Called after each trial, first for those that were there, then in the order in which they end.

    Returns:
        The timings in the order of the tasks.

    Raises:
        ConfigError: Several processes would share one bus, or a cluster would move a robot.
        TrialVoidError: A robot was lost in a trial; its log is kept.
        ResultsError: A log is there that is of another campaign.
        WorkerError: A trial's process died each time, or the cluster cannot be used.
        ImoloError: A trial failed; the logs of the others stay.
    """
    if not tasks:
        return []
    parallel = tasks[0].config.campaign.parallel
    shared = next((task.config.bus for task in tasks if not task.config.bus.startswith("memq:")), None)
    if shared is not None and (jobs != 1 or parallel.backend != "loky"):
        raise ConfigError(
            f"trials run at once would mix their messages on the bus {shared!r}; give --jobs 1 or memq://"
        )
    if not all(BACKENDS.load(name).simulated for name in {task.config.backend.name for task in tasks}):
        if parallel.backend != "loky":
            raise ConfigError("a robot can do one trial at a time, on this machine; leave --scheduler out")
        jobs = 1
    origins = _origins(tasks)
    timings: dict[int, TrialTiming] = {}
    left: list[tuple[int, TrialTask]] = []
    for number, task in enumerate(tasks):
        timing = kept(task.log_path, origins[number])
        if timing is None:
            left.append((number, task))
            discard_partial(task.log_path)
        else:
            timings[number] = timing
            on_done(task)
    work = [_TrialWork(with_absolute_paths(task), origins[number]) for number, task in left]
    for index, timing in run_work(work, jobs):
        number, task = left[index]
        discard_partial(task.log_path)
        timings[number] = timing
        on_done(task)
    return [timings[number] for number in range(len(tasks))]


class Work(ABC):
    """Something to do in another process, which leaves a file; errors name it by its text.

    Attributes:
        config: Of the experiment.
        path: File to write; absolute, since the process may have been started in another folder.
        origin: What the file comes from.
    """

    config: ExperimentConfig
    path: Path
    origin: dict[str, str]

    @abstractmethod
    def run(self) -> TrialTiming:
        """Do it, write the file, and return how long it took."""

    def was_begun(self) -> bool:
        """Tell whether a process died over it."""
        return bool(partial_paths(self.path))


def run_work(work: Sequence[Work], jobs: int) -> Iterator[tuple[int, TrialTiming]]:
    """Do work where `campaign.parallel` says, and again what a dying process left undone.

    Args:
        work: What to do, all of it under the same `campaign.parallel`.
        jobs: Number of processes on this machine, or -1 for one per core.

    Yields:
        Number of a piece of work and its timing, in the order in which they end.

    Raises:
        WorkerError: A process died each time, or the cluster cannot be used.
        ImoloError: A piece failed; the files of the others stay.
    """
    if not work:
        return
    parallel = work[0].config.campaign.parallel
    if parallel.backend == "dask":
        ended: Iterable[tuple[int, TrialTiming]] = run_on_dask(_run_far, work, parallel)
    elif jobs == 1:
        ended = enumerate(map(_run_here, work))
    else:
        ended = run_on_cores(_run_here, work, jobs, parallel.retries, Work.was_begun)
    for number, timing in ended:
        _check_arrival(work[number].path)
        yield number, timing


class _TrialWork(Work):
    """A trial and the origin to write beside its log."""

    def __init__(self, task: TrialTask, origin: dict[str, str]) -> None:
        self.task, self.origin = task, origin
        self.config, self.path = task.config, task.log_path

    def __str__(self) -> str:
        task = self.task
        method = f", method {task.method}" if task.method else ""
        return f"trial {task.trial.kind.value} {task.trial.index} on {task.config.backend.name}{method}"

    def run(self) -> TrialTiming:
        """Run the trial and keep its log."""
        partial = partial_path(self.path)
        with writing(self.path):
            try:
                timing = run_task(replace(self.task, log_path=partial))
            except TrialVoidError as void:
                kept_log = set_aside(partial, self.path)
                raise TrialVoidError(
                    f"{self} is void: {void} (log: {kept_log}); give the same command to go on"
                ) from void
            keep(partial, self.path, self.origin, timing)
        return timing


def _origins(tasks: Sequence[TrialTask]) -> list[dict[str, str]]:
    """Return what each log comes from."""
    configs = {id(task.config): task.config for task in tasks}
    digests = {key: config.digest() for key, config in configs.items()}
    tables = {path: file_digest(path) for path in {task.table_path for task in tasks} if path is not None}
    return [
        {
            "seed": str(task.trial.seed),
            "config": digests[id(task.config)],
            "method": task.method,
            "duration": "" if task.duration is None else str(task.duration),
            "table": tables[task.table_path] if task.table_path is not None else "",
            **environment(),
            **plugin_code(task.config),
        }
        for task in tasks
    ]


def with_absolute_paths(task: TrialTask) -> TrialTask:
    """Return a task as it is for a process that was started in another folder."""
    table = None if task.table_path is None else task.table_path.absolute()
    return replace(task, log_path=task.log_path.absolute(), table_path=table)


def _check_arrival(path: Path) -> None:
    """Refuse a file that a worker wrote to a disk of its own.

    Raises:
        WorkerError: The file is not there.
    """
    deadline = time.monotonic() + ARRIVAL
    while not path.is_file():
        if time.monotonic() > deadline:
            raise WorkerError(f"a worker wrote {path}, but it is not there; choose an --out that all machines share")
        # A look at the folder makes a network file system ask its server.
        list(path.parent.glob("*"))
        time.sleep(0.1)


def leave_interrupts_to_the_parent() -> None:
    """Let Ctrl-C end the process that was started, which then ends its workers, without a word from these."""
    # A worker of a cluster works in a thread of its own, which may not ask for signals.
    if multiprocessing.parent_process() is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run_here(work: Work) -> TrialTiming:
    leave_interrupts_to_the_parent()
    return work.run()


def _run_far(work: Work) -> TrialTiming:
    """Run on a worker of a cluster, which may run several threads in a process and another version of imolo."""
    host = socket.gethostname()
    here = environment() | plugin_code(work.config)
    different = [f"{key} {here.get(key)}" for key in here if here[key] != work.origin.get(key)]
    if different:
        raise WorkerError(
            f"the worker on {host} has {', '.join(different)}, unlike the machine of the command; use one that is alike"
        )
    try:
        with _ONE_TRIAL_AT_A_TIME:
            return work.run()
    except BusError as error:
        raise BusError(f"the worker on {host}: {error} that all machines share") from error


def run_task(task: TrialTask) -> TrialTiming:
    """Run one trial in this process."""
    config, trial = task.config, task.trial
    controller: Controller = Bystander()
    duration = config.campaign.duration
    decisions: list[float] = []
    on_robot = not backend_plugin(config).simulated
    if trial.kind is TrialKind.TRAINING:
        theta = config.training.motions[trial.index]
        controller = MotionPlayer(config.motion, theta)
        duration = task.duration or START_MARGIN + config.motion.swing_of(theta) + config.training.sampled_to
    elif task.table_path is not None:
        plugin = PLANNERS.load(config.methods[task.method].controller.name)
        planner = plugin.create(config, task.method, task.table_path, decisions.append)
        if on_robot:
            planner.warm_up()
        controller = planner
    begin = time.perf_counter()
    with contextlib.ExitStack() as stack:
        # One thread, so that the sums do not depend on the number of cores.
        stack.enter_context(threadpool_limits(limits=1))
        if on_robot:
            logger.info("%s", stack.enter_context(claimed_priority(BACKEND_PRIORITY)))
        simulated = run_trial(config, trial, controller, task.log_path, duration)
    return TrialTiming(simulated=simulated, elapsed=time.perf_counter() - begin, decisions=tuple(decisions))
