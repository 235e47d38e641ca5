"""Two checkouts side by side: `python -m benchmarks --against REV` runs each subject in both, in turns.

Each checkout runs its own benchmarks, in its own process. The ratios are medians over the rounds: other programs on the
machine slow both down alike.
"""

import json
import os
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

HERE = Path(__file__).resolve().parents[1]

# What to run, as text, because an older checkout has its own modules of these names.
MEASURED = {
    "mujoco": "from benchmarks import loop; found = loop.run('mujoco')",
    "pybullet": "from benchmarks import loop; found = loop.run('pybullet')",
    "dart": "from benchmarks import loop; found = loop.run('dart')",
    "ode": "from benchmarks import loop; found = loop.run('ode')",
    "drake": "from benchmarks import loop; found = loop.run('drake')",
    "sapien": "from benchmarks import loop; found = loop.run('sapien')",
    "method": """
from benchmarks import planner, table
from benchmarks.learned import learn
learned, found = learn(folder), []
for method in learned.config.methods:
    measured, built = table.run(learned, method)
    found += [*measured, *planner.run(learned, method, built, folder)]
""",
    "live": """
from benchmarks import live, planner, table
from benchmarks.learned import learn
learned, method = learn(folder), "improved"
planner.run(learned, method, table.run(learned, method)[1], folder)
found = live.run(folder, folder / f"{method}.npz", method)
""",
}
FRAME = """
import json, sys, tempfile
from pathlib import Path
with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
{}
print(json.dumps({{f"{{one.subject}}: {{one.quantity}} [{{one.unit}}]": one.value for one in found}}))
"""
COMMANDS = {
    "help": ["--help"],
    "backends": ["backends"],
    "campaign": ["compare", "configs/mujoco.yaml", "--balls", "4", "--jobs", "1", "--out", "{out}"],
    "demo": ["compare", *(f"configs/{name}.yaml" for name in ("mujoco", "pybullet", "dart")), "--out", "{out}"],
}
OF_LOGS = {
    "top": ["top", "{log}"],
    "plot": ["plot", "{log}", "TRUTH_BALL.true_ball_position", "--out", "{out}/plot.png"],
    "diff": ["diff", "{log}", "{log}"],
    "export": ["export", "{log}", "--to", "csv", "--out", "{out}/csv"],
}
SUBJECTS = (*MEASURED, *COMMANDS, *OF_LOGS)
# Revisions before Drake and SAPIEN have no loops of theirs.
USUAL = tuple(name for name in (*MEASURED, *COMMANDS) if name not in ("live", "demo", "drake", "sapien"))


def compare(revision: str, subjects: list[str], rounds: int, console: Console, log: Path | None = None) -> None:
    """Measure subjects in this checkout and in a revision, in turns, and print the ratios, this over that.

    Args:
        revision: The other one.
        subjects: Of `SUBJECTS`.
        rounds: How often each is measured.
        console: Where to print.
        log: What those of `OF_LOGS` read.

    Raises:
        SystemExit: Something failed, or a subject lacks its log.
    """
    if missing := sorted(OF_LOGS.keys() & set(subjects)) if log is None else []:
        raise SystemExit(f"{', '.join(missing)}: give the log to read with --log")
    other = checkout(revision)
    found: dict[str, list[tuple[float, float]]] = {}
    for subject in subjects:
        for number in range(rounds):
            with console.status(f"{subject}, round {number + 1} of {rounds}"):
                # Who is first changes, so that neither always has the warmer caches.
                order = ((HERE, Path(sys.executable)), other)[:: 1 if number % 2 else -1]
                values = {folder: dict(_measure(subject, folder, python, log)) for folder, python in order}
            ours, theirs = values[HERE], values[other[0]]
            for name in ours.keys() & theirs.keys():
                found.setdefault(name, []).append((ours[name], theirs[name]))
    table = Table("what", "here", revision, "ratio", "of the rounds")
    for name, pairs in found.items():
        here, there = np.array(pairs).T
        ratios = here / np.where(there == 0.0, np.nan, there)
        spread = f"{ratios.min():.2f}-{ratios.max():.2f}"
        table.add_row(
            escape(name), f"{np.median(here):.4g}", f"{np.median(there):.4g}", f"{np.median(ratios):.2f}", spread
        )
    console.print(table)


def checkout(revision: str) -> tuple[Path, Path]:
    """Put a revision beside this one, once, upon the packages that are installed here.

    Returns:
        Its folder and its Python.
    """
    name = _run("git", "rev-parse", "--short", f"{revision}^{{commit}}").strip()
    folder = HERE / "build" / "against" / name
    python = folder / ".venv" / "bin" / "python"
    if not python.exists():
        _run("git", "worktree", "prune")
        _run("git", "worktree", "add", "--detach", str(folder), name)
        _run(sys.executable, "-m", "venv", str(folder / ".venv"))
        packages = Path(sysconfig.get_path("purelib", "venv", vars={"base": str(folder / ".venv")}))
        (packages / "installed_here.pth").write_text("\n".join(p for p in sys.path if p.endswith("site-packages")))
        _run(str(python), "-m", "pip", "install", "--quiet", "--no-deps", "--editable", str(folder))
    return folder, python


def _measure(subject: str, folder: Path, python: Path, log: Path | None) -> Iterator[tuple[str, float]]:
    """Yield what was measured and its number."""
    if subject in MEASURED:
        body = "\n".join(f"    {line}" for line in MEASURED[subject].splitlines())
        yield from json.loads(_run(str(python), "-c", FRAME.format(body), cwd=folder).splitlines()[-1]).items()
        return
    with tempfile.TemporaryDirectory() as out:
        command = [part.format(out=out, log=log and log.resolve()) for part in (COMMANDS | OF_LOGS)[subject]]
        begun = time.monotonic()
        with tempfile.TemporaryFile("w+") as said:
            program = subprocess.Popen(
                [python.with_name("imolo"), *command], cwd=folder, stdout=subprocess.DEVNULL, stderr=said
            )
            _, status, used = os.wait4(program.pid, 0)
            if status:
                said.seek(0)
                raise SystemExit(f"imolo {' '.join(command)} failed in {folder}:\n{said.read()[-2000:]}")
        yield f"{subject}: processor time [s]", used.ru_utime + used.ru_stime
        yield f"{subject}: elapsed [s]", time.monotonic() - begun
        yield f"{subject}: most memory of a process [MB]", used.ru_maxrss / 1024.0
        if (timing := Path(out) / "timing.json").exists():
            for backend, methods in json.loads(timing.read_text())["timing"].items():
                for method, numbers in methods.items():
                    yield from ((f"{subject}: {backend}, {method}, {name}", value) for name, value in numbers.items())


def _run(*command: str, cwd: Path = HERE) -> str:
    """Run a command and return what it printed.

    Raises:
        SystemExit: It failed; what it said is in the message.
    """
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)[:200]} failed in {cwd}:\n{done.stderr[-2000:]}")
    return done.stdout
