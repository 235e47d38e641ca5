"""The command line as a whole: its help, and how it tells of mistakes."""

import subprocess
import sys

import pytest
from command_line import Run, is_one_line_about

COMMANDS = (
    *("backends", "check"),
    *("compare", "learn", "hit", "ball", "interpolation", "transfer", "trials", "attribute", "report"),
    *("backend", "planner", "record", "throw", "up"),
    *("spy", "top", "replay", "diff", "export", "plot", "view"),
    *("board", "arm", "disarm", "calibrate", "emulate"),
)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_explains_it(run: Run, command: str) -> None:
    code, output, _ = run(command, "--help")
    assert code == 0
    assert f"Usage: imolo {command}" in output


def test_help_names_every_command_beside_those_of_its_subject(run: Run) -> None:
    code, output, _ = run("--help")
    assert code == 0
    named = [line.split()[0] for line in output.partition("Commands:")[2].splitlines() if line.strip()]
    # Other distributions may add theirs.
    assert [name for name in named if name in COMMANDS] == list(COMMANDS)


def test_backends_are_listed_without_importing_an_engine() -> None:
    listing = "from imolo.contracts.registry import BACKENDS; [BACKENDS.about(name) for name in BACKENDS.names()]"
    program = f"import sys; {listing}; print(*sys.modules)"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    imported = set(ended.stdout.split())
    assert "imolo.contracts.registry" in imported
    assert not imported & {"numpy", "scipy", "numba", "pydantic", "mujoco", "pybullet", "dartpy", "pydrake", "sapien"}


def test_backends_are_loaded_without_what_only_trials_and_fits_import() -> None:
    listing = "from imolo.contracts.registry import BACKENDS; [BACKENDS.status(name) for name in BACKENDS.names()]"
    program = f"import sys; {listing}; print(*sys.modules)"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    imported = set(ended.stdout.split())
    assert "imolo_backends.engines.mujoco_engine" in imported
    assert not imported & {"sklearn", "scipy.stats", "scipy.spatial", "scipy.integrate", "scipy.optimize", "joblib"}


def test_a_planner_with_its_table_needs_no_scikit_learn() -> None:
    program = "import sys, imolo.method.planner, imolo.campaigns.campaign; print(*sys.modules)"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    imported = set(ended.stdout.split())
    assert "imolo.method.table" in imported
    assert not imported & {"sklearn", "scipy.stats", "matplotlib"}


def test_help_waits_for_nothing_that_takes_long_to_import() -> None:
    program = "import sys, imolo.command_line.main; print(*sys.modules)"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    imported = set(ended.stdout.split())
    assert "imolo.campaigns.commands" in imported
    assert not imported & {
        "numpy",
        "scipy",
        "sklearn",
        "numba",
        "matplotlib",
        "pydantic",
        "lcm",
        "imolo.contracts.backend",
    }


def test_unknown_command_is_refused_with_the_nearest_name(run: Run) -> None:
    code, _, errors = run("compre")
    assert code == 2
    assert "compare" in errors


def test_line_of_an_error_is_not_broken_where_the_terminal_ends(run: Run) -> None:
    path = "a_long_name/" * 12 + "experiment.yaml"
    code, _, errors = run("compare", path)
    assert code == 2
    assert is_one_line_about(errors, path, "No such file")
