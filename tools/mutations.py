"""Do the tests notice when the code is wrong? Changes a copy of it at random places and runs the tests of each line.

Usage: python tools/mutations.py [COUNT] [--seed N] [--only PART_OF_A_PATH] [--map FILE] (`make mutations`). A change is
a comparison, an operator, a constant or a condition; every place is as likely as every other. Prints what noticed it.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator, operator_names
from tests_by_line import TestsByLine

CHANGED = (
    "imolo/ball/",
    "imolo/inspect/",
    "imolo/messaging/",
    "imolo/method/",
    "drivers/imolo_drivers/natnet/",
    "backends/imolo_backends/actuators/",
)
"""Folders whose code is changed."""
KINDS = ("Comparison", "BinaryOperator", "UnaryOperator", "NumberReplacer", "AndWithOr", "OrWithAnd", "True", "AddNot")
ENOUGH = 120.0  # [s] of tests of one change; what these do not notice counts as not noticed
PATIENCE = 5.0  # times as long may tests take as without a change, which may loop for ever

Place = tuple[str, tuple[int, int]]
Change = tuple[str, int]
"""Operator of cosmic-ray, and its how manyth place in the file."""


def changes(folder: Path, only: str) -> dict[Place, list[Change]]:
    """Return what can be changed at every place of the code, by file, line and column."""
    found: dict[Place, list[Change]] = {}
    names = [name for name in operator_names() if any(kind in name for kind in KINDS) and "BitOr" not in name]
    for path in sorted({path for start in CHANGED for path in folder.glob(f"{start}*.py")}):
        if only not in str(path):
            continue
        nodes = list(ast_nodes(get_ast_from_path(path)))
        for name in names:
            operator = get_operator(name)()
            places = [start for node in nodes for start, _ in operator.mutation_positions(node)]
            for occurrence, start in enumerate(places):
                found.setdefault((str(path.relative_to(folder)), start), []).append((name, occurrence))
    return found


def environment_of(folder: Path) -> dict[str, str]:
    """Return the environment in which Python imports the copy."""
    roots = (folder, folder / "backends", folder / "drivers", folder / "lcmtypes", folder / "tools")
    paths = os.pathsep.join([*map(str, roots), *sys.path[1:]])
    return {**os.environ, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(folder / ".numba")}


def who_fails(folder: Path, tests: list[str], seconds: float, fresh: bool) -> str:
    """Run tests of the copy until one fails.

    Args:
        folder: The copy.
        tests: Their names, in this order.
        seconds: How long they take without a change [s].
        fresh: Compile everything again: compiled code holds what it calls, and constants, as they were.

    Returns:
        The test that failed, or "" if all passed.
    """
    # A file that is changed and put back within a second would be taken from its old bytecode.
    environment = environment_of(folder) | {"PYTHONDONTWRITEBYTECODE": "1"}
    names = folder / "tests_of_this_change"
    names.write_text("\n".join(tests))
    with tempfile.TemporaryDirectory() as cache:
        if fresh:
            environment["NUMBA_CACHE_DIR"] = cache
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", f"@{names}"]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, cwd=folder, env=environment, stdout=pipe, text=True, process_group=0) as ran:
            try:
                told, _ = ran.communicate(timeout=120.0 + PATIENCE * seconds)
            except subprocess.TimeoutExpired:
                os.killpg(ran.pid, signal.SIGKILL)
                return "no end"
    failed = [line.split(" - ")[0] for line in told.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return "" if ran.returncode == 0 else (failed or ["no test could run"])[0]


def noticed_by(folder: Path, known: TestsByLine, place: Place, change: Change) -> str | None:
    """Change one place, run its tests and put it back.

    Returns:
        The test that noticed, "" if none did, None if the change makes no Python.
    """
    path, tests, seconds = folder / place[0], list[str](), 0.0
    for test in known.of(place[0], place[1][0]):
        seconds += known.seconds[test]
        if seconds > ENOUGH and tests:
            break
        tests.append(test)
    with use_mutation(path, get_operator(change[0])(), change[1]):
        try:
            compile(path.read_text(), path, "exec")
        except SyntaxError:
            return None
        return who_fails(folder, tests, seconds, known.is_compiled_in(place[0])) if tests else ""


def copy_of_project(folder: Path) -> None:
    """Copy what Git knows, as it is now."""
    files = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True).stdout.splitlines()
    for file in filter(os.path.exists, files):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, folder / file)


def main() -> None:
    """Sample, run, and print what was not noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument(
        "--map", type=Path, default="build/tests_by_line.json", help="where to keep which test runs what"
    )
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="imolo-mutations-") as name:
        folder = Path(name)
        copy_of_project(folder)
        known = TestsByLine.kept(folder, environment_of(folder), chosen.map)
        rng = random.Random(chosen.seed)
        places = changes(folder, chosen.only)
        tried = noticed = 0
        for place in rng.sample(sorted(places), len(places)):
            if tried == chosen.count:
                break
            change = rng.choice(places[place])
            by = noticed_by(folder, known, place, change)
            if by is None:
                continue
            tried, noticed = tried + 1, noticed + bool(by)
            (path, (line, column)), text = place, (folder / place[0]).read_text().splitlines()[place[1][0] - 1].strip()
            told = f"{by or 'NOT NOTICED'}\n    {path}:{line}:{column} {change[0][5:]} {change[1]}: {text}"
            print(f"{tried:3} {told}", flush=True)
        print(f"{noticed} of {tried} noticed, of {len(places)} places")


if __name__ == "__main__":
    main()
