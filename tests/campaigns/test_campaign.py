"""Campaigns: the same logs wherever they run, whoever dies, and however often they are stopped."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from played_trials import config

from imolo.campaigns import campaign, kept_trials, workers
from imolo.campaigns.campaign import TrialTask, log_name, run_tasks
from imolo.campaigns.kept_trials import TrialTiming, partial_path, partial_paths
from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ExperimentConfig, ParallelConfig
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import BusError, ConfigError, MissingToolError, ResultsError, WorkerError

SHORT = 0.1  # [s] of a trial
NOBODY = "tcp://127.0.0.1:9"


def short(duration: float = SHORT, parallel: ParallelConfig | None = None, seed: int = 1) -> ExperimentConfig:
    chosen = config("mujoco", seed=seed)
    changes: dict[str, object] = {"duration": duration, "parallel": parallel or ParallelConfig()}
    return chosen.model_copy(update={"campaign": chosen.campaign.model_copy(update=changes)})


def throws(folder: Path, chosen: ExperimentConfig, number: int = 4) -> list[TrialTask]:
    trials = [Trial(TrialKind.THROW, index, chosen.seed) for index in range(number)]
    return [TrialTask(chosen, trial, folder / log_name(trial)) for trial in trials]


def logs(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.lcmlog")}


@pytest.fixture(scope="module")
def serial(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("serial")
    run_tasks(throws(folder, short()), jobs=1)
    written = logs(folder)
    assert len(written) == 4
    return written


def run_alone(text: str, *arguments: object) -> subprocess.Popen[str]:
    """Start a Python program that may import what the tests import."""
    return subprocess.Popen(
        [sys.executable, "-c", text, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_two_processes_write_the_logs_of_one(serial: dict[str, bytes], tmp_path: Path) -> None:
    timings = run_tasks(throws(tmp_path, short()), jobs=2)
    assert logs(tmp_path) == serial
    assert [timing.simulated for timing in timings] == pytest.approx([SHORT] * 4)


# Stopped campaigns.


def test_complete_trials_are_not_run_again(
    serial: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = throws(tmp_path, short())
    first = run_tasks(tasks[:2], jobs=1)
    run: list[Path] = []
    original = campaign.run_task

    def run_task(task: TrialTask) -> TrialTiming:
        run.append(task.log_path)
        return original(task)

    monkeypatch.setattr(campaign, "run_task", run_task)
    done: list[TrialTask] = []
    timings = run_tasks(tasks, jobs=1, on_done=done.append)
    assert run == [partial_path(task.log_path) for task in tasks[2:]]
    assert done == tasks
    assert timings[:2] == first
    assert logs(tmp_path) == serial


def test_log_that_is_cut_off_is_run_again(serial: dict[str, bytes], tmp_path: Path) -> None:
    tasks = throws(tmp_path, short())
    partial = tasks[0].log_path.with_name(f"{tasks[0].log_path.name}.elsewhere-1.part")
    partial.write_bytes(serial[tasks[0].log_path.name][:1000])
    run_tasks(tasks, jobs=1)
    assert logs(tmp_path) == serial
    assert not partial_paths(tasks[0].log_path)


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        (short(seed=2), "another seed, config"),
        (short(duration=0.05), "another config"),
    ],
)
def test_trials_of_another_config_are_refused(tmp_path: Path, changed: ExperimentConfig, what: str) -> None:
    run_tasks(throws(tmp_path, short(), 1), jobs=1)
    with pytest.raises(ResultsError, match=rf"throw_000.lcmlog is of {what}; give another --out, or --fresh"):
        run_tasks(throws(tmp_path, changed, 1), jobs=1)


def test_trials_of_another_version_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_tasks(throws(tmp_path, short(), 1), jobs=1)
    monkeypatch.setattr(campaign, "environment", lambda: kept_trials.environment() | {"source": "newer"})
    with pytest.raises(ResultsError, match="is of another source"):
        run_tasks(throws(tmp_path, short(), 1), jobs=1)


@pytest.mark.parametrize("record", [None, b"", b"{"])
def test_log_of_unknown_origin_is_refused(tmp_path: Path, record: bytes | None) -> None:
    (task,) = throws(tmp_path, short(), 1)
    task.log_path.write_bytes(b"")
    if record is not None:
        task.log_path.with_name(f"{task.log_path.name}.origin.json").write_bytes(record)
    with pytest.raises(ResultsError, match="of unknown origin"):
        run_tasks([task], jobs=1)


def test_trials_with_a_table_that_was_replaced_are_refused(tmp_path: Path) -> None:
    table = tmp_path / "table.npz"
    table.write_bytes(b"one")
    (task,) = throws(tmp_path, short(), 1)
    run_tasks([TrialTask(task.config, task.trial, task.log_path, "", None)], jobs=1)
    with pytest.raises(ResultsError, match="another table"):
        run_tasks([TrialTask(task.config, task.trial, task.log_path, "", table)], jobs=1)


def test_fresh_deletes_trials_and_nothing_else(tmp_path: Path) -> None:
    folder = ResultsFolder(tmp_path)
    run_tasks(throws(folder.learning("mujoco"), short(), 2), jobs=1)
    partial_path(folder.learning("mujoco") / "throw_002.lcmlog").touch()
    note = folder.learning("mujoco") / "notes.txt"
    note.touch()
    assert folder.trials() == 2
    folder.discard_trials()
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [note]


KILLED = """
import sys
from pathlib import Path
from test_campaign import short, throws
from imolo.campaigns.campaign import run_tasks
run_tasks(throws(Path(sys.argv[1]), short(), 4), int(sys.argv[2]))
"""


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_campaign_whose_process_was_killed_goes_on(serial: dict[str, bytes], tmp_path: Path, jobs: int) -> None:
    process = run_alone(KILLED, tmp_path, jobs)
    wait_for(lambda: bool(logs(tmp_path)) or process.poll() is not None)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    kept_before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.lcmlog")}
    assert kept_before
    run_tasks(throws(tmp_path, short()), jobs=1)
    assert logs(tmp_path) == serial
    assert {path: path.stat().st_mtime_ns for path in kept_before} == kept_before


def wait_for(condition: object, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline
        time.sleep(0.002)


# Workers that die.


def killed_while(folder: Path) -> threading.Thread:
    """Kill one process that has begun a log in a folder."""

    def kill() -> None:
        parts: list[Path] = []

        def begun() -> bool:
            parts[:] = folder.glob("*.part")
            return bool(parts)

        wait_for(begun)
        os.kill(int(parts[0].name.removesuffix(".part").removesuffix(".json").rpartition("-")[2]), signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    return thread


def test_trials_of_a_killed_process_are_run_again(serial: dict[str, bytes], tmp_path: Path) -> None:
    killer = killed_while(tmp_path)
    run_tasks(throws(tmp_path, short()), jobs=2)
    killer.join()
    assert logs(tmp_path) == serial
    assert not list(tmp_path.glob("*.part"))


def die(task: Path) -> None:
    """Leave a trace, then die if the name says so."""
    with task.open("a") as file:
        file.write("run\n")
    if task.name == "fatal":
        os.kill(os.getpid(), signal.SIGKILL)


def test_task_that_always_kills_its_process_is_named_after_its_retries(tmp_path: Path) -> None:
    tasks = [tmp_path / name for name in ("a", "fatal", "b")]
    with pytest.raises(WorkerError, match=r"fatal was given up: its worker died 3 times"):
        list(workers.run_on_cores(die, tasks, 2, 2, Path.exists))
    # Once beside others, then alone.
    assert (tmp_path / "fatal").read_text() == "run\n" * 3


@pytest.mark.slow
def test_processes_that_die_before_they_begin_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(WorkerError, match="workers died 2 times before they began anything"):
        list(workers.run_on_cores(die, [tmp_path / "fatal"], 2, 1, lambda _: False))


# Clusters.


@contextmanager
def cluster(workers: int = 2) -> Iterator[str]:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as running:
        yield running.scheduler_address


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with cluster() as started:
        yield started


def on(address: str) -> ParallelConfig:
    return ParallelConfig(backend="dask", address=address)


def test_dask_workers_write_the_logs_of_one_process(serial: dict[str, bytes], tmp_path: Path, address: str) -> None:
    run_tasks(throws(tmp_path, short(parallel=on(address))), jobs=1)
    assert logs(tmp_path) == serial


def test_trials_of_a_killed_dask_worker_are_run_again(serial: dict[str, bytes], tmp_path: Path, address: str) -> None:
    killer = killed_while(tmp_path)
    run_tasks(throws(tmp_path, short(parallel=on(address))), jobs=1)
    killer.join()
    assert logs(tmp_path) == serial


def test_where_trials_run_is_no_part_of_what_they_are(tmp_path: Path) -> None:
    run_tasks(throws(tmp_path, short()), jobs=1)
    # All are there, so nobody is asked.
    assert len(run_tasks(throws(tmp_path, short(parallel=on(NOBODY))), jobs=1)) == 4


@pytest.mark.slow
def test_trial_that_always_kills_its_dask_worker_is_named(tmp_path: Path, address: str) -> None:
    with pytest.raises(WorkerError, match=r"fatal was given up: its worker died again and again"):
        list(workers.run_on_dask(die, [tmp_path / "a", tmp_path / "fatal"], on(address)))


def test_dask_worker_that_cannot_write_says_so(tmp_path: Path, address: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BusError, match=r"worker on .*cannot write the log .*folder you may write to that all machines"):
        run_tasks(throws(tmp_path / "file", short(parallel=on(address)), 1), jobs=1)


def test_dask_worker_of_another_version_is_refused(
    tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign, "environment", lambda: kept_trials.environment() | {"numpy": "1.0"})
    with pytest.raises(WorkerError, match=r"worker on .* has numpy .*, unlike the machine of the command"):
        run_tasks(throws(tmp_path, short(parallel=on(address)), 1), jobs=1)


def test_log_that_a_worker_wrote_elsewhere_is_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "ARRIVAL", 0.0)
    monkeypatch.setattr(campaign, "keep", lambda *_: None)
    with pytest.raises(WorkerError, match="it is not there; choose an --out that all machines share"):
        run_tasks(throws(tmp_path, short(), 1), jobs=1)


def test_scheduler_that_is_not_there_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "CONNECT_TIMEOUT", 0.5)
    with pytest.raises(WorkerError, match=rf"no Dask scheduler answers at {NOBODY}"):
        run_tasks(throws(tmp_path, short(parallel=on(NOBODY))), jobs=1)


def test_scheduler_without_workers_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "CONNECT_TIMEOUT", 1.0)
    with cluster(0) as lonely, pytest.raises(WorkerError, match="has no workers; start some with `dask worker"):
        run_tasks(throws(tmp_path, short(parallel=on(lonely))), jobs=1)


def test_missing_dask_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingToolError, match=r'pip install "dask>=[\d.]+" "distributed>=[\d.]+"'):
        run_tasks(throws(tmp_path, short(parallel=on(NOBODY))), jobs=1)


def test_one_bus_for_all_workers_is_refused(tmp_path: Path) -> None:
    shared = short(parallel=on(NOBODY)).model_copy(update={"bus": "udpm://239.255.76.67:7667?ttl=0"})
    with pytest.raises(ConfigError, match="would mix their messages"):
        run_tasks(throws(tmp_path, shared), jobs=1)
