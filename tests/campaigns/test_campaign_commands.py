"""`imolo compare`, `learn` and `hit`: every mistake ends in one line, and Ctrl-C keeps what is done."""

from pathlib import Path

import pytest
from command_line import Run, interrupt, is_one_line_about

from imolo.messaging.channels import TRIAL
from imolo.messaging.log import read_log

GOOD = "backend: {name: mujoco}\n"
SMALL = """
backend: {name: mujoco}
simulation: {timestep: 5.0e-4}
campaign: {learning_throws: 4, balls: 2}
methods:
  quick:
    forward_model: {parameters: {C: 100.0, epsilon: 0.001, gamma: 0.3}, inputs: standardized}
    grid: {spacing: 0.02, time_tolerance: 0.02, unique: all, parameters: {k: {step: 0.05}}}
"""


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ("holds no settings",)),
        (GOOD + "sed: 1\n", ("unknown key 'sed'", "did you mean 'seed'?")),
        (GOOD + "seed: x\n", ("'seed' is 'x'",)),
        (GOOD + "training: {motions: []}\n", ("training.motions", "at least 1 item")),
        ("backend: [\n", ("is not YAML",)),
        ("backend: {name: mujco}\n", ("unknown backend 'mujco'", "did you mean 'mujoco'?")),
        ("backend: {name: mujoco, itegrator: 1}\n", ("unknown key 'itegrator'", "did you mean 'integrator'?")),
    ],
)
@pytest.mark.parametrize("command", ["compare", "learn"])
def test_mistake_in_a_config_ends_in_one_line(run: Run, command: str, text: str, parts: tuple[str, ...]) -> None:
    Path("experiment.yaml").write_text(text, encoding="utf-8")
    code, output, errors = run(command, "experiment.yaml")
    assert (code, output) == (2, "")
    assert is_one_line_about(errors, *parts)


def test_backend_named_twice_ends_in_one_line(run: Run) -> None:
    Path("one.yaml").write_text(GOOD, encoding="utf-8")
    code, _, errors = run("compare", "one.yaml", "one.yaml")
    assert code == 2
    assert is_one_line_about(errors, "mujoco")


@pytest.mark.parametrize("command", ["compare", "learn"])
def test_results_folder_that_cannot_be_written_ends_in_one_line(run: Run, command: str) -> None:
    Path("experiment.yaml").write_text(GOOD, encoding="utf-8")
    Path("file").write_text("in the way", encoding="utf-8")
    code, _, errors = run(command, "experiment.yaml", "--out", "file/results")
    assert code == 2
    assert is_one_line_about(errors, "cannot write results to file/results", "choose another --out")


@pytest.mark.parametrize(
    ("content", "parts"), [(None, ("table.npz",)), (b"no table", ("table.npz",)), (b"", ("table.npz",))]
)
def test_table_that_cannot_be_read_ends_in_one_line(run: Run, content: bytes | None, parts: tuple[str, ...]) -> None:
    Path("experiment.yaml").write_text(GOOD, encoding="utf-8")
    if content is not None:
        Path("table.npz").write_bytes(content)
    code, _, errors = run("hit", "experiment.yaml", "table.npz")
    assert code == 2
    assert is_one_line_about(errors, *parts)


def test_unknown_method_ends_in_one_line_with_the_nearest_name(run: Run) -> None:
    Path("experiment.yaml").write_text(GOOD, encoding="utf-8")
    code, _, errors = run("hit", "experiment.yaml", "table.npz", "--method", "papr")
    assert code == 2
    assert is_one_line_about(errors, "unknown method 'papr'", "did you mean 'paper'?")


def logs(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.lcmlog"))


def digest(folder: Path) -> dict[str, bytes]:
    files = [folder / "summary.json", *logs(folder), *sorted((folder / "tables").glob("*"))]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.mark.slow
def test_comparison_is_the_same_wherever_it_runs_and_however_often_it_stops(run: Run) -> None:
    from distributed import LocalCluster

    Path("small.yaml").write_text(SMALL, encoding="utf-8")
    assert run("compare", "small.yaml", "--out", "one", "--jobs", 1)[::2] == (0, "")
    expected = digest(Path("one"))
    assert len(logs(Path("one"))) == 4 + 15 + 2
    assert run("compare", "small.yaml", "--out", "two", "--jobs", 2)[::2] == (0, "")
    assert digest(Path("two")) == expected
    for path in logs(Path("two"))[::3]:
        path.unlink()
    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as cluster:
        on_dask = ("--scheduler", cluster.scheduler_address)
        code, output, _ = run("compare", "small.yaml", "--out", "two", *on_dask)
        assert (code, "14 trials are in two already" in output) == (0, True)
        assert digest(Path("two")) == expected
        assert run("compare", "small.yaml", "--out", "dask", *on_dask)[::2] == (0, "")
        assert digest(Path("dask")) == expected


def test_results_of_another_seed_are_refused_until_fresh_ones_are_wanted(run: Run) -> None:
    Path("small.yaml").write_text(SMALL, encoding="utf-8")
    ball = ("ball", "small.yaml", "--balls", 4, "--models", "linear", "--jobs", 1, "--out", "out")
    assert run(*ball)[0] == 0
    code, _, errors = run(*ball, "--seed", 2)
    assert code == 2
    assert is_one_line_about(errors, "is of another seed, config; give another --out, or --fresh")
    assert run(*ball, "--seed", 2, "--fresh")[0] == 0


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_ctrl_c_keeps_the_logs_and_ends_in_one_line(tmp_path: Path, jobs: int) -> None:
    (tmp_path / "experiment.yaml").write_text(GOOD, encoding="utf-8")
    # With one log more than there are processes, one is whole.
    code, errors = interrupt(
        tmp_path,
        lambda _: len(logs(tmp_path)) > jobs,
        *("compare", "experiment.yaml", "--out", "results", "--jobs", jobs),
    )
    assert code == 130
    kept = logs(tmp_path)
    assert is_one_line_about(errors, "interrupted", f"{len(kept)} logs", "kept in results")
    assert len(kept) > jobs
    # What was cut off can be read up to where it was cut.
    ends = [[event.event for event in read_log(path).messages[TRIAL]][-1:] for path in kept]
    assert ["end"] in ends


def test_dense_motions_are_learned_without_logs_and_make_the_same_table(run: Run) -> None:
    """Its motions in a config, and so with logs, teach the same."""
    from imolo.method.table_file import read_table_file

    coarse = SMALL.replace("5.0e-4", "1.0e-3").replace("simulation: {", "simulation: {sensor_rate: 240.0, ")
    Path("dense.yaml").write_text(coarse, encoding="utf-8")
    run("learn", "dense.yaml", "--motions", "4", "--out", "dense", "--jobs", "1")
    assert not list(Path("dense/logs").rglob("training_*.lcmlog"))
    run("learn", "dense/configs/mujoco.yaml", "--out", "logs", "--jobs", "1")
    assert len(list(Path("logs/logs").rglob("training_*.lcmlog"))) == 4
    (header, dense), (other_header, logs) = (
        read_table_file(Path(f"{out}/tables/mujoco_quick.npz")) for out in ("dense", "logs")
    )
    assert header["origin"]["ball_model"] == other_header["origin"]["ball_model"]
    assert dense.keys() == logs.keys()
    assert all((dense[name] == logs[name]).all() for name in dense)
