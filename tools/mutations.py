"""Do the tests notice when the code is wrong? Changes copies of it at random places and runs the tests of each place.

Usage: python tools/mutations.py [COUNT] [--seed N] [--only PART_OF_A_PATH] (`make mutations`). A change is a
comparison, an operator, a constant or a condition; every place is as likely as every other. What lives is printed.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator, operator_names

TESTS = {
    "imolo/ball/": "tests/ball",
    "imolo/inspect/": "tests/inspect",
    "imolo/messaging/": "tests/messaging",
    "imolo/method/planner": "tests/trials/test_planner_trials.py tests/trials/test_streams.py",
    "imolo/method/table": "tests/method/test_table.py tests/method/test_table_file.py",
    "imolo/method/hit_": "tests/method/test_hit_choice.py",
    "imolo/method/motion": "tests/method/test_motion.py tests/plant/test_command_schedule.py",
    "imolo/method/commands": "tests/method/test_motion.py tests/plant/test_command_schedule.py",
    "imolo/method/": "tests/method",
    "drivers/imolo_drivers/natnet/": "tests/drivers/natnet",
    "backends/imolo_backends/actuators/": "tests/plant",
}
"""Which tests know a file best, by the beginning of its path; the first that fits."""
KINDS = ("Comparison", "BinaryOperator", "UnaryOperator", "NumberReplacer", "AndWithOr", "OrWithAnd", "True", "AddNot")
TIMEOUT = 600.0  # [s] of the tests of one change, which may loop for ever

Place = tuple[str, tuple[int, int]]
Change = tuple[str, int]
"""Operator of cosmic-ray, and its how manyth place in the file."""


def changes(folder: Path, only: str) -> dict[Place, list[Change]]:
    """Return what can be changed at every place of the code, by file, line and column."""
    found: dict[Place, list[Change]] = {}
    names = [name for name in operator_names() if any(kind in name for kind in KINDS) and "BitOr" not in name]
    for path in sorted({path for start in TESTS for path in folder.glob(f"{start}*.py")}):
        if only not in str(path):
            continue
        nodes = list(ast_nodes(get_ast_from_path(path)))
        for name in names:
            operator = get_operator(name)()
            places = [start for node in nodes for start, _ in operator.mutation_positions(node)]
            for occurrence, start in enumerate(places):
                found.setdefault((str(path.relative_to(folder)), start), []).append((name, occurrence))
    return found


def tests_of(path: str) -> str:
    """Return the tests of a file, separated by spaces."""
    return next(tests for start, tests in TESTS.items() if path.startswith(start))


def passes(folder: Path, tests: str) -> bool:
    """Run tests of the copy."""
    roots = (folder, folder / "backends", folder / "drivers", folder / "lcmtypes")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*map(str, roots), *sys.path[1:]])}
    environment["NUMBA_CACHE_DIR"] = str(folder / ".numba")
    options = ["-m", "not slow", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    command = [sys.executable, "-m", "pytest", *options, *tests.split()]
    try:
        ran = subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        return False
    return ran.returncode == 0


def is_noticed(folder: Path, place: Place, change: Change) -> bool | None:
    """Change one place, run its tests and put it back; None if that makes no Python."""
    path = folder / place[0]
    with use_mutation(path, get_operator(change[0])(), change[1]):
        try:
            compile(path.read_text(), path, "exec")
        except SyntaxError:
            return None
        return not passes(folder, tests_of(place[0]))


def main() -> None:
    """Sample, run, and print what was not noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="imolo-mutations-") as name:
        folder = Path(name)
        files = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True).stdout.splitlines()
        for file in filter(os.path.exists, files):
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file, folder / file)
        rng = random.Random(chosen.seed)
        known = changes(folder, chosen.only)
        tried = noticed = 0
        sound: set[str] = set()
        for place in rng.sample(sorted(known), len(known)):
            if tried == chosen.count:
                break
            tests, change = tests_of(place[0]), rng.choice(known[place])
            if tests not in sound and not passes(folder, tests):
                sys.exit(f"{tests} fails without a change; mend it first")
            sound.add(tests)
            result = is_noticed(folder, place, change)
            if result is None:
                continue
            tried, noticed = tried + 1, noticed + result
            (path, (line, column)), text = place, (folder / place[0]).read_text().splitlines()[place[1][0] - 1].strip()
            told = "noticed" if result else "NOT NOTICED"
            print(f"{tried:3} {told:11} {path}:{line}:{column} {change[0][5:]} {change[1]}: {text}", flush=True)
        print(f"{noticed} of {tried} noticed, of {len(known)} places")


if __name__ == "__main__":
    main()
