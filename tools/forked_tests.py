"""Runs tests in a fork of a Python that has imported what they need but the project: a second instead of ten."""

import importlib
import multiprocessing
import os
import signal
import sys
from pathlib import Path

import numba
import pytest

IMPORTED = (
    "filterpy.kalman",
    "hypothesis.strategies",
    "jinja2",
    "lcm",
    "matplotlib.figure",
    "pydantic",
    "rich.table",
    "scipy.interpolate",
    "scipy.optimize",
    "scipy.spatial.transform",
    "scipy.stats",
    "sklearn.gaussian_process",
    "sklearn.multioutput",
    "sklearn.pipeline",
    "sklearn.svm",
    "typer",
    "yaml",
)
OPTIONS = ("-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning")
PATIENCE = 5.0  # times as long may tests take as they did, which may loop for ever now
START = 120.0  # [s] to begin


def import_before_forks() -> None:
    """Import what is slow to import, once."""
    for name in IMPORTED:
        importlib.import_module(name)


def first_failure(folder: Path, tests: list[str], seconds: float, environment: dict[str, str]) -> str:
    """Run tests of a copy of the project until one fails.

    Args:
        folder: The copy.
        tests: Their names, in this order.
        seconds: How long they took before [s].
        environment: Where Python finds the copy, and numba its cache.

    Returns:
        The test that failed, "no end" if they take too long, "no test could run", or "" if all passed.
    """
    told = folder / "told_by_tests.txt"
    names = folder / "tests_of_this_change"
    names.write_text("\n".join(tests))
    run = multiprocessing.get_context("fork").Process(target=_run, args=(folder, names, told, environment))
    run.start()
    assert run.pid is not None
    run.join(START + PATIENCE * seconds)
    ended = run.exitcode is not None
    _kill_group(run.pid)  # also what the tests started and left
    run.join()
    if not ended:
        return "no end"
    lines = told.read_text(errors="replace").splitlines()
    failed = [line.split(" - ")[0] for line in lines if line.startswith(("FAILED", "ERROR"))]
    return "" if run.exitcode == 0 else (failed or ["no test could run"])[0]


def _run(folder: Path, names: Path, told: Path, environment: dict[str, str]) -> None:
    os.setpgid(0, 0)
    output = os.open(told, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.chdir(folder)
    os.environ |= environment
    numba.core.config.CACHE_DIR = environment["NUMBA_CACHE_DIR"]
    # A file that is changed and put back within a second would be taken from its old bytecode.
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.dont_write_bytecode = True
    sys.path[:0] = environment["PYTHONPATH"].split(os.pathsep)
    code = 9
    try:
        code = int(pytest.main([*OPTIONS, f"@{names}"]))
    finally:  # without waiting for threads that a test has left
        sys.stdout.flush()
        os._exit(code)


def _kill_group(leader: int) -> None:
    try:
        os.killpg(leader, signal.SIGKILL)
    except ProcessLookupError:
        return
