"""Do the tests notice when the code is wrong? Changes a copy of it at random places and runs the tests of each line.

Usage: python tools/mutations.py [COUNT] [--seed N] [--only PART_OF_A_PATH] [--map FILE] (`make mutations`). A change is
a comparison, an operator, a constant or a condition; every place is as likely as every other. Prints what noticed it.
"""

import argparse
import contextlib
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator, operator_names
from forked_tests import first_failure, import_before_forks
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
    programs = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return {**os.environ, "PATH": programs, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(folder / ".numba")}


def without_stale(cache: Path, known: TestsByLine, path: str, folder: Path) -> Path:
    """Copy what numba compiled before, but that which may hold code or constants of one file.

    Args:
        cache: What was compiled from the code without a change.
        known: Which file uses which.
        path: The file that is changed.
        folder: Where to copy it to.

    Returns:
        The copy, or what was there if nothing compiled depends on the file.
    """
    users = known.users(path)
    if not any("njit" in (known.folder / user).read_text() for user in users):
        return cache
    shutil.copytree(cache, folder, dirs_exist_ok=True, copy_function=os.link)
    for user in users:
        for stale in folder.glob(f"{Path(user).parent.name}_*/{Path(user).stem}.*"):
            stale.unlink()
    return folder


def noticed_by(folder: Path, known: TestsByLine, place: Place, change: Change) -> str | None:
    """Change one place, run its tests and put it back.

    Returns:
        The test that noticed, and passes without the change; "" if none did, None if the change makes no Python.
    """
    path, tests, seconds = folder / place[0], list[str](), 0.0
    environment = environment_of(folder)
    compiled_before = Path(environment["NUMBA_CACHE_DIR"])
    compiled_before.mkdir(exist_ok=True)
    for test in known.of(place[0], place[1][0]):
        seconds += known.seconds[test]
        if seconds > ENOUGH and tests:
            break
        tests.append(test)
    with tempfile.TemporaryDirectory(dir=folder) as compiled:
        while tests:
            cache = without_stale(compiled_before, known, place[0], Path(compiled))
            with changed(path, change):
                try:
                    compile(path.read_text(), path, "exec")
                except SyntaxError:
                    return None
                by = first_failure(folder, tests, seconds, environment | {"NUMBA_CACHE_DIR": str(cache)})
            test = by.partition(" ")[2]
            again = [test] if test in tests else tests
            if by in ("", "no end") or not first_failure(folder, again, seconds, environment):
                return by
            if again is tests:
                return ""  # they end without a word, whatever is changed
            tests.remove(test)
    return ""


@contextlib.contextmanager
def changed(path: Path, change: Change) -> Iterator[None]:
    """Change a file for a while; put back, it counts as never changed."""
    status = path.stat()
    try:
        with use_mutation(path, get_operator(change[0])(), change[1]):
            yield
    finally:
        os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


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
        import_before_forks()
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
