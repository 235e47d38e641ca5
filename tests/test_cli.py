"""The command line as a whole: its help, and how it tells of mistakes."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import typer.main
from command_line import IMOLO, Run, interrupt, is_one_line_about

from imolo.command_line.main import app

GROUPS = {
    "Start": ("backends", "robots", "config", "new", "check"),
    "Compare": ("compare", "learn", "hit"),
    "Study": ("ball", "interpolation", "transfer", "trials", "attribute", "identify"),
    "Live": ("backend", "planner", "record", "throw", "up"),
    "Look": ("report", "spy", "top", "replay", "diff", "export", "plot", "view"),
    "Robot": ("board", "arm", "disarm", "calibrate", "emulate"),
}
COMMANDS: Any = typer.main.get_command(app)


def parameters() -> list[tuple[str, Any]]:
    """Return every option of every command, the commands in `new` included, beside the command's name."""
    inner = [(f"new {name}", command) for name, command in COMMANDS.commands["new"].commands.items()]
    return [
        (name, parameter)
        for name, command in (*COMMANDS.commands.items(), *inner)
        for parameter in command.params
        if parameter.param_type_name == "option"
    ]


@pytest.mark.parametrize("command", [name for names in GROUPS.values() for name in names])
def test_help_of_every_command_explains_it(run: Run, command: str) -> None:
    code, output, _ = run(command, "--help")
    assert code == 0
    assert f"Usage: imolo {command}" in output
    assert max(map(len, output.splitlines())) <= 80


def test_help_names_every_command_in_its_group_with_one_whole_line(run: Run) -> None:
    code, output, _ = run("--help")
    assert code == 0
    listed = output[output.index("\nStart:\n") :]
    assert "..." not in listed
    assert "…" not in listed
    found: dict[str, list[str]] = {}
    for line in listed.splitlines():
        assert len(line) <= 80
        if line and not line.startswith(" "):
            group = found.setdefault(line.rstrip(":"), [])
        elif line:
            name, _, summary = line.strip().partition(" ")
            assert summary.strip().endswith("."), line  # the sentence ends where the line does
            group.append(name)
    # Other distributions may add theirs.
    assert {title: tuple(found[title][: len(names)]) for title, names in GROUPS.items()} == GROUPS


def test_commands_of_a_command_have_one_whole_line_each(run: Run) -> None:
    for name in [name for name, command in COMMANDS.commands.items() if hasattr(command, "commands")]:
        _, output, _ = run(name, "--help")
        lines = [line.strip() for line in output.partition("\nCommands:\n")[2].splitlines()]
        assert [line.split()[0] for line in lines] == list(COMMANDS.commands[name].commands)
        assert all(line.endswith(".") and not line.endswith("..") for line in lines)


def test_one_thing_has_one_name_over_all_commands() -> None:
    names: dict[str, set[str]] = {}
    for command, parameter in parameters():
        names.setdefault(parameter.opts[0], set()).add(command)
    assert not names.keys() & {"--url", "--throws", "--trials"}
    assert names["--bus"] >= {"spy", "top", "view", "up", "backend", "planner", "record", "throw"}
    assert names["--balls"] >= {"compare", "hit", "transfer", "ball", "up"}
    assert names["--numbers"] == {"interpolation", "trials"}


@pytest.mark.parametrize(
    ("command", "choices"),
    [
        ("up", "<lockstep|realtime>"),
        ("backend", "<lockstep|realtime>"),
        ("export", "<mcap|csv|parquet>"),
        ("ball", "--units m|cm|mm "),
        ("ball", "--time s|ms|us|ns "),
        ("ball", "--up z|-z|y|-y|x|-x "),
        ("ball", "--models linear,drag,spin "),
    ],
)
def test_help_shows_what_can_be_chosen(run: Run, command: str, choices: str) -> None:
    assert choices in run(command, "--help")[1]


def test_what_cannot_be_chosen_is_refused_with_what_can(run: Run) -> None:
    code, _, errors = run("export", "any.lcmlog", "--to", "parket")
    assert code == 2
    assert "'parket' is not one of 'mcap', 'csv', 'parquet'" in errors


@pytest.mark.parametrize(
    ("arguments", "largest"),
    [
        (("throw",), 2**31 - 1),
        (("up", "mujoco", "--balls"), 2**31 - 1),
        (("hit", "mujoco", "--balls"), 2**31 - 1),
        (("hit", "mujoco", "--seed"), 2**63 - 1),
    ],
)
def test_number_that_no_message_holds_is_refused(run: Run, arguments: tuple[str, ...], largest: int) -> None:
    code, _, errors = run(*arguments, largest + 1)
    assert code == 2
    assert f"less than or equal to {largest}" in errors


@pytest.mark.parametrize("program", ["imolo", "-m imolo"])
def test_version_is_that_of_the_distribution(program: str, tmp_path: Path) -> None:
    command = [IMOLO] if program == "imolo" else [sys.executable, "-m", "imolo"]
    ended = subprocess.run([*command, "--version"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert ended.stdout == f"imolo {version('imolo')}\n"


@pytest.mark.parametrize("command", ["record", "throw", "top"])
def test_interrupted_command_that_waits_ends_with_130(command: str, tmp_path: Path) -> None:
    def is_on_the_bus(process: int) -> bool:
        return "lcm" in Path(f"/proc/{process}/maps").read_text(encoding="utf-8")

    code, errors = interrupt(tmp_path, is_on_the_bus, command, "--bus", "memq://")
    assert code == 130
    assert "Traceback" not in errors


def test_interrupt_that_python_drops_is_repeated() -> None:
    """Such as one that arrives in the callback of a lock that importing lets go."""
    program = """
import signal, sys, time, types, weakref
from imolo.command_line import start
class Lock: pass
def run():
    lock = Lock()
    told = weakref.ref(lock, lambda _: signal.raise_signal(signal.SIGINT))
    del lock
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        sys.exit(130)
sys.modules["imolo.command_line.main"] = types.SimpleNamespace(main=run)
start.main()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=50)
    assert (ended.returncode, ended.stderr) == (130, "")


def test_shell_completes_commands_and_choices() -> None:
    def complete(line: str) -> str:
        asked = {"_IMOLO_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()))}
        return subprocess.run([IMOLO], env={**os.environ, **asked}, capture_output=True, text=True, check=True).stdout

    assert "interpolation" in complete("imolo ").split()
    assert set(complete("imolo export --to ").split()) == {"mcap", "csv", "parquet"}


def test_backends_are_listed_without_importing_an_engine() -> None:
    """Those that are here: what is missing, and how to get it, is said by an import that fails."""
    program = """
import sys
from importlib.metadata import entry_points
from imolo.contracts.registry import BACKENDS
from imolo.contracts.unloaded import summary_unloaded
here = [one.name for one in entry_points(group=BACKENDS.group) if summary_unloaded(one) is not None]
assert {BACKENDS.about(name)[1] for name in here} == {""}
print(*here)
print(*sys.modules)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    here, imported = (set(line.split()) for line in ended.stdout.splitlines())
    assert "hardware" in here
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
