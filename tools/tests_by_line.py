"""Which test runs which line: the fast tests once under coverage, each test being a context of its own.

A plug-in of pytest as well (`-p tests_by_line`), which names the contexts and writes how long each test took.
Compiled code has no lines that coverage sees, and lines of a module run when the first test imports it. Such a place
is looked after by all tests that run something of its file, or of a file that imports it.
"""

import ast
import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from coverage import Coverage, CoverageData

SETTINGS = """[run]
source = imolo, backends, drivers
data_file = {folder}/.coverage
parallel = true
patch = subprocess
context = ${{PYTEST_CURRENT_TEST-}}
disable_warnings = no-data-collected, module-not-measured, module-not-imported, already-imported
"""
PASSED = "passed.txt"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Let what runs now be of this test."""
    measured = Coverage.current()
    if measured is not None:
        measured.switch_context(item.nodeid)
    return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Write down how long each part of a test took, and whether it passed."""
    if "PYTEST_XDIST_WORKER" not in os.environ:  # which tells the process that started it
        with Path(PASSED).open("a", encoding="utf-8") as file:
            print(json.dumps((report.nodeid, report.duration, report.outcome == "passed")), file=file)


def pytest_sessionfinish() -> None:
    """Save what a process of xdist saw, which ends without doing so."""
    measured = Coverage.current()
    if measured is not None:
        measured.save()


class TestsByLine:
    """What the fast tests of a copy of the project run.

    Attributes:
        seconds: How long each test takes that passes [s], by its name.
        lines: Tests that run a line, by file and line.
    """

    def __init__(self, folder: Path, seconds: dict[str, float], lines: dict[str, dict[str, list[str]]]) -> None:
        self.folder = folder
        self.seconds = seconds
        self.lines = lines

    @classmethod
    def measure(cls, folder: Path, environment: dict[str, str]) -> "TestsByLine":
        """Run all fast tests of a copy, as many at once as there are cores."""
        settings = folder / "coverage.ini"
        settings.write_text(SETTINGS.format(folder=folder))
        coverage = [sys.executable, "-m", "coverage"]
        tests = ["-m", "pytest", "-p", "tests_by_line", "-m", "not slow", "-q", "-n", "auto", "-p", "no:cacheprovider"]
        ran = [*coverage, "run", f"--rcfile={settings}", *tests]
        subprocess.run(ran, cwd=folder, env=environment, check=False, stdout=sys.stderr)
        subprocess.run([*coverage, "combine", "-q", f"--rcfile={settings}"], cwd=folder, env=environment, check=True)
        seconds = _seconds(folder / PASSED)
        data = CoverageData(str(folder / ".coverage"))
        data.read()
        lines: dict[str, dict[str, list[str]]] = {}
        for path in map(Path, data.measured_files()):
            # In a program that a test starts the context is "name (phase)".
            lines[str(path.relative_to(folder))] = {
                str(line): sorted({re.sub(r" \((setup|call|teardown)\)$", "", test) for test in tests} & set(seconds))
                for line, tests in data.contexts_by_lineno(str(path)).items()
            }
        return cls(folder, seconds, lines)

    @classmethod
    def kept(cls, folder: Path, environment: dict[str, str], path: Path) -> "TestsByLine":
        """Read what was measured before; measure and keep it if any Python file has changed since."""
        sources = b"".join(file.read_bytes() for file in sorted(folder.rglob("*.py")) if file.parent.name != "tools")
        digest = hashlib.sha256(sources).hexdigest()
        if path.exists() and (content := json.loads(path.read_text())).pop("digest") == digest:
            return cls(folder, **content)
        known = cls.measure(folder, environment)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"digest": digest, "seconds": known.seconds, "lines": known.lines}))
        return known

    def users(self, path: str) -> list[str]:
        """Return a file, those that import it, and those whose compiled code may hold some of its."""
        texts = {file: (self.folder / file).read_text() for file in self.lines}
        found = [path]
        for used in found:
            module = used.removeprefix("backends/").removeprefix("drivers/").removesuffix(".py").replace("/", ".")
            package, _, name = module.rpartition(".")
            imports = re.compile(rf"\b{re.escape(package)}(\.| import .*\b){name}\b")
            further = used != path
            found += (
                file
                for file, text in texts.items()
                if file not in found and imports.search(text) and (not further or "njit" in text)
            )
        return found

    def of(self, path: str, line: int) -> list[str]:
        """Return the tests that may notice a change of a line, the most likely and quickest first.

        After the tests that run it come the others in their files, which may use what those have made.
        """
        text = (self.folder / path).read_text()
        span = _in_function(ast.parse(text), line)
        known = self.lines.get(path, {})
        tests = {test for at in span for test in known.get(str(at), ())}
        if not span or (not tests and "njit" in text):
            found = (tests for user in self.users(path) for tests in self.lines.get(user, {}).values())
            tests = {test for some in found for test in some}
        files = {test.partition("::")[0] for test in tests}
        others = {test for test in self.seconds if test.partition("::")[0] in files} - tests
        return [*sorted(tests, key=self.seconds.__getitem__), *sorted(others, key=self.seconds.__getitem__)]


def _seconds(path: Path) -> dict[str, float]:
    """Return how long each test took [s], those that did not pass left out."""
    seconds: dict[str, float] = {}
    failed: set[str] = set()
    for test, part, passed in map(json.loads, path.read_text(encoding="utf-8").splitlines()):
        seconds[test] = seconds.get(test, 0.0) + part
        if not passed:
            failed.add(test)
    return {test: taken for test, taken in seconds.items() if test not in failed}


def _in_function(tree: ast.Module, line: int) -> range:
    """Return the lines of the statement at a line, without those of its body; none if it runs at import."""
    found = range(0)
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            for statement in ast.walk(function):
                if isinstance(statement, ast.stmt | ast.excepthandler) and statement is not function:
                    body = getattr(statement, "body", None)
                    end = body[0].lineno - 1 if body else statement.end_lineno or line
                    lines = range(statement.lineno, max(end, statement.lineno) + 1)
                    if line in lines and (not found or len(lines) <= len(found)):
                        found = lines
    return found
