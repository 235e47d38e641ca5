"""The command line: every mistake ends in one line and exit code 2, and Ctrl-C keeps what is done."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest
from command_line import Run
from requirements import BACKENDS

from imolo import registry
from imolo.channels import TRIAL
from imolo.log import read_log

IMOLO = Path(sys.executable).with_name("imolo")
COMMANDS = (
    *(
        "backends",
        "check",
        "attribute",
        "compare",
        "learn",
        "hit",
        "ball",
        "interpolation",
        "trials",
        "transfer",
        "report",
    ),
    *("spy", "top", "replay", "diff", "export", "plot", "view"),
    *("backend", "planner", "record", "throw", "up"),
    *("board", "arm", "disarm", "emulate"),
)
GOOD = "backend: {name: mujoco}\n"


def is_one_line_about(errors: str, *parts: str) -> bool:
    return (
        errors.startswith("imolo: ")
        and errors.count("\n") == 1
        and errors.endswith("\n")
        and "Traceback" not in errors
        and all(part in errors for part in parts)
    )


@pytest.mark.parametrize("name", BACKENDS)
def test_backends_lists_every_engine_as_ready(run: Run, name: str) -> None:
    code, output, errors = run("backends")
    assert (code, errors) == (0, "")
    assert re.search(rf"^{name} +ready +\S", output, flags=re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_explains_it(run: Run, command: str) -> None:
    code, output, _ = run(command, "--help")
    assert code == 0
    assert f"Usage: imolo {command}" in output


def test_help_names_every_command(run: Run) -> None:
    code, output, _ = run("--help")
    assert code == 0
    assert {line.split()[0] for line in output.partition("Commands:")[2].splitlines() if line.strip()} >= set(COMMANDS)


def test_unknown_command_is_refused_with_the_nearest_name(run: Run) -> None:
    code, _, errors = run("compre")
    assert code == 2
    assert "compare" in errors


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


def test_line_of_an_error_is_not_broken_where_the_terminal_ends(run: Run) -> None:
    path = "a_long_name/" * 12 + "experiment.yaml"
    code, _, errors = run("compare", path)
    assert code == 2
    assert is_one_line_about(errors, path, "No such file")


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


@pytest.fixture
def without_pybullet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make Python find no PyBullet, as where the extra was not installed."""
    monkeypatch.setitem(sys.modules, "pybullet", None)
    monkeypatch.delitem(sys.modules, "imolo_backends.pybullet_engine", raising=False)


@pytest.mark.usefixtures("without_pybullet")
def test_missing_extra_ends_in_one_line_that_says_how_to_get_it(run: Run) -> None:
    Path("experiment.yaml").write_text("backend: {name: pybullet}\n", encoding="utf-8")
    code, _, errors = run("compare", "experiment.yaml")
    assert code == 2
    assert is_one_line_about(errors, "backend 'pybullet' cannot be used", "pip install 'imolo[pybullet]'")


@pytest.mark.usefixtures("without_pybullet")
def test_missing_extra_leaves_the_other_backends_ready() -> None:
    status = {name: registry.backend_status(name) for name in ("dart", "mujoco", "pybullet")}
    assert status["pybullet"].plugin is None
    assert status["pybullet"].problem.endswith("install it with: pip install 'imolo[pybullet]'")
    assert (status["mujoco"].problem, status["dart"].problem) == ("", "")


@pytest.mark.usefixtures("without_pybullet")
def test_backends_says_that_an_engine_is_missing(run: Run) -> None:
    code, output, _ = run("backends")
    assert code == 0
    assert re.search(r"^pybullet +missing ", output, flags=re.MULTILINE)
    assert re.search(r"^mujoco +ready ", output, flags=re.MULTILINE)


@pytest.mark.usefixtures("without_pybullet")
def test_backends_says_how_to_get_a_missing_engine(run: Run) -> None:
    _, output, _ = run("backends")
    assert "pip install 'imolo[pybullet]'" in " ".join(output.split())


# `imolo check`.

BROKEN_PLUGIN = """
import os
import time

import numpy as np

from imolo_backends.engine import EngineOptions
from imolo_backends.simulated import simulated_plugin


class Engine:
    def __init__(self, scene, options):
        pass

    def step(self, joint_torque, ball_force):
        os.write(2, b"broken.cpp:7: out of luck\\n")
        os.abort()

    def motion(self):
        return np.zeros(0), np.zeros(0), np.zeros(3)

    def close(self):
        pass


BACKEND = simulated_plugin(Engine, EngineOptions, "an engine that crashes at its first step")
"""


@pytest.fixture
def broken_plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install, as far as Python can tell, a distribution whose engine crashes."""
    folder = tmp_path / "plugins"
    about = folder / "broken-1.0.dist-info"
    about.mkdir(parents=True)
    (folder / "broken_plugin.py").write_text(BROKEN_PLUGIN, encoding="utf-8")
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text("[imolo.backends]\nbroken = broken_plugin:BACKEND\n", encoding="utf-8")
    monkeypatch.syspath_prepend(folder)


def test_check_reports_each_quantity_with_its_verdict(run: Run) -> None:
    code, output, errors = run("check", "mujoco", "--only", "free_fall", "--json", "numbers.json")
    assert (code, errors) == (0, "")
    assert re.search(r"^ +free_fall +height +18\.77\d* +18\.77\d* +1e-9 +m +pass", output, flags=re.MULTILINE)
    assert "mujoco: 1 scene, 3 quantities: 3 pass, 0 unsupported, 0 FAIL" in output
    (record,) = json.loads(Path("numbers.json").read_text(encoding="utf-8"))
    assert [outcome["verdict"] for outcome in record["outcomes"]] == ["pass"] * 3


def test_check_of_a_config_is_under_its_options(run: Run) -> None:
    Path("runge.yaml").write_text("backend: {name: mujoco, integrator: rk4}\n", encoding="utf-8")
    code, output, _ = run("check", "runge.yaml", "--only", "free_fall")
    assert code == 0
    # Without the bias of Euler's, which is half g dt t.
    assert re.search(r"^ +free_fall +height +18\.773[78] +18\.773[78] ", output, flags=re.MULTILINE)
    assert re.search(r"^runge \(mujoco-core \S+, integrator: rk4\)", output, flags=re.MULTILINE)


def test_check_of_several_engines_ends_in_a_matrix(run: Run) -> None:
    code, output, _ = run("check", "mujoco", "pybullet", "--only", "sealed_piston")
    assert code == 0
    assert re.search(r"^ +scene +mujoco +pybullet", output, flags=re.MULTILINE)
    assert re.search(r"^ +sealed_piston +pass +pass", output, flags=re.MULTILINE)


@pytest.mark.usefixtures("broken_plugin")
def test_engine_that_crashes_fails_its_check_and_the_next_one_still_runs(run: Run) -> None:
    code, output, errors = run("check", "broken", "--only", "free_fall", "--only", "emptying")
    assert (code, errors) == (1, "")
    assert "broken: 2 scenes, 5 quantities: 4 pass, 0 unsupported, 1 FAIL" in output
    died = "broken free_fall the process died with signal 6 (SIGABRT), after saying: broken.cpp:7: out of luck"
    assert died in " ".join(output.partition("Failed")[2].split())


@pytest.mark.usefixtures("broken_plugin")
def test_scene_that_takes_too_long_fails_and_the_next_one_still_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    from imolo.conformance.runner import run_suites
    from imolo.conformance.suite import Suite

    # Of a process that was stopped nothing is heard any more.
    stopped = BROKEN_PLUGIN.replace("os.abort()", "time.sleep(600.0)")
    Path(sys.path[0], "broken_plugin.py").write_text(stopped, encoding="utf-8")
    monkeypatch.delitem(sys.modules, "broken_plugin", raising=False)
    outcomes = run_suites([Suite("broken", "broken")], ["free_fall", "emptying"], time_limit=8.0)["broken"]
    assert [(o.check, o.verdict.value) for o in outcomes] == [("free_fall", "fail")] + [("emptying", "pass")] * 4
    assert outcomes[0].remark == "took longer than 8 s"


@pytest.mark.usefixtures("broken_plugin")
def test_engine_that_dies_while_it_is_loaded_fails_every_check(run: Run, tmp_path: Path) -> None:
    # In the parent it loads.
    dies = "import multiprocessing\nimport os\nif multiprocessing.parent_process():\n    os._exit(3)\n"
    (tmp_path / "plugins" / "broken_plugin.py").write_text(dies + BROKEN_PLUGIN, encoding="utf-8")
    sys.modules.pop("broken_plugin", None)
    code, output, _ = run("check", "broken", "--only", "free_fall", "--only", "emptying")
    assert code == 1
    assert output.count("cannot be loaded: the process ended with exit code 3") == 2


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("mujco",), ("unknown backend 'mujco'", "did you mean 'mujoco'?")),
        (("nothing.yaml",), ("nothing.yaml", "No such file")),
        (("mujoco", "mujoco"), ("'mujoco' would be reported twice",)),
        (("mujoco", "--only", "free_fal"), ("unknown check or group 'free_fal'", "did you mean 'free_fall'?")),
        (("mujoco", "--only", "free_fall", "--page", "page.md"), ("--page tells of all scenes",)),
        (("fine.yaml", "--page", "page.md"), ("--page tells of default options", "'mujoco'")),
        (("mujoco", "--only", "sealed_piston", "--json", "no/folder.json"), ("cannot write no/folder.json",)),
    ],
)
def test_mistake_in_what_is_to_be_checked_ends_in_one_line(
    run: Run, arguments: tuple[str, ...], parts: list[str]
) -> None:
    Path("fine.yaml").write_text("backend: {name: mujoco, integrator: rk4}\n", encoding="utf-8")
    code, _, errors = run("check", *arguments)
    assert code == 2
    assert is_one_line_about(errors, *parts)


def test_ctrl_c_ends_a_check_in_one_line(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [IMOLO, "check", "mujoco", "--jobs", "2"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        deadline = time.monotonic() + 60.0
        while not children.read_text().split() and process.poll() is None and time.monotonic() < deadline:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.02)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert process.returncode == 130
    assert is_one_line_about(errors, "interrupted; 0 of", "scenes were done")


@pytest.mark.parametrize("wrong", [None, ModuleType("ode")], ids=["none", "another package of this name"])
def test_missing_ode_ends_in_one_line_that_says_how_to_get_it(
    run: Run, monkeypatch: pytest.MonkeyPatch, wrong: ModuleType | None
) -> None:
    monkeypatch.setitem(sys.modules, "ode", wrong)
    for module in ("ode_engine", "ode_model"):
        monkeypatch.delitem(sys.modules, f"imolo_backends.{module}", raising=False)
    Path("experiment.yaml").write_text("backend: {name: ode}\n", encoding="utf-8")
    code, _, errors = run("compare", "experiment.yaml")
    assert code == 2
    assert is_one_line_about(errors, "backend 'ode' cannot be used", "make ode")
    # PyPI has another package of this name.
    assert "pip install" not in errors


def logs(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.lcmlog"))


def digest(folder: Path) -> dict[str, bytes]:
    files = [folder / "summary.json", *logs(folder), *sorted((folder / "tables").glob("*"))]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


SMALL = """
backend: {name: mujoco}
simulation: {timestep: 5.0e-4}
campaign: {learning_throws: 4, balls: 2}
methods:
  quick:
    forward_model: {parameters: {C: 100.0, epsilon: 0.001, gamma: 0.3}, inputs: standardized}
    grid: {spacing: 0.02, time_tolerance: 0.02, unique: all, k: {start: -1.0, stop: 1.0, step: 0.05}}
"""


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
    ball = ("ball", "small.yaml", "--throws", 4, "--models", "linear", "--jobs", 1, "--out", "out")
    assert run(*ball)[0] == 0
    code, _, errors = run(*ball, "--seed", 2)
    assert code == 2
    assert is_one_line_about(errors, "is of another seed, config; give another --out, or --fresh")
    assert run(*ball, "--seed", 2, "--fresh")[0] == 0


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_ctrl_c_keeps_the_logs_and_ends_in_one_line(tmp_path: Path, jobs: int) -> None:
    (tmp_path / "experiment.yaml").write_text(GOOD, encoding="utf-8")
    process = subprocess.Popen(
        [IMOLO, "compare", "experiment.yaml", "--out", "results", "--jobs", str(jobs)],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A terminal sends Ctrl-C to the whole process group, the workers included.
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 300.0
        # With one log more than there are processes, one is whole.
        while len(logs(tmp_path)) <= jobs and process.poll() is None and time.monotonic() < deadline:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.02)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert process.returncode == 130
    kept = logs(tmp_path)
    assert is_one_line_about(errors, "interrupted", f"{len(kept)} logs", "kept in results")
    assert len(kept) > jobs
    # What was cut off can be read up to where it was cut.
    ends = [[event.event for event in read_log(path).messages[TRIAL]][-1:] for path in kept]
    assert ["end"] in ends
