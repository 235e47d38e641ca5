"""The checks as tests of pytest, for the author of a backend.

One file of tests::

    from imolo.conformance.testing import BackendCheck, assert_conforms, parametrize_checks

    @parametrize_checks("my_engine")
    def test_conformance(check: BackendCheck) -> None:
        assert_conforms(check)
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from imolo.conformance.check import Outcome, Verdict
from imolo.conformance.report import explain
from imolo.conformance.suite import Suite, check_names, suites
from imolo.errors import ConfigError

if TYPE_CHECKING:
    import pytest


class ConformanceWarning(UserWarning):
    """What the author of a backend should look at, though nothing fails."""


@dataclass(frozen=True)
class BackendCheck:
    """One check of one backend.

    Attributes:
        suite: The backend and its options.
        name: Of the check.
    """

    suite: Suite
    name: str

    def run(self) -> list[Outcome]:
        """Run it in this process."""
        return self.suite.run(self.name)


def parametrize_checks(*backends: str | Suite, only: Sequence[str] = (), **options: Any) -> "pytest.MarkDecorator":
    """Return a decorator that runs a test once for each check of each backend, as its argument `check`.

    Args:
        backends: Names of backends, paths of configs, or suites, which say the options.
        only: Names of checks or groups; none for all.
        options: Of `pytest.param`, such as `marks`.

    Raises:
        BackendNotFoundError: A backend is not installed; the test is not skipped.
        ConfigError: Nothing is asked for, there is no such check, or a limitation of no check is declared.
    """
    import pytest

    if not backends:
        raise ConfigError("parametrize_checks needs the name of a backend, as in its entry point")
    chosen = suites(backends)
    check_names(only, chosen)
    for suite in chosen:
        for outcome in suite.misplaced():
            raise ConfigError(f"backend {suite.backend!r}, {outcome.check!r}: {outcome.remark}")
    return pytest.mark.parametrize(
        "check",
        [
            pytest.param(BackendCheck(suite, name), id=f"{suite.label}-{name}", **options)
            for suite in chosen
            for name in suite.select(only)
        ],
    )


def assert_conforms(check: BackendCheck) -> None:
    """Run a check, fail where a quantity is neither as it should be nor declared as a limitation, and pass warnings on.

    Raises:
        AssertionError: A quantity fails.
    """
    __tracebackhide__ = True
    lines: dict[Verdict, list[str]] = {verdict: [] for verdict in Verdict}
    for outcome in check.run():
        lines[outcome.verdict].append(f"{check.suite.label} {check.name}: {explain(outcome)}")
    if lines[Verdict.FAIL]:
        raise AssertionError("\n".join(lines[Verdict.FAIL]))
    for line in lines[Verdict.WARNING]:
        warnings.warn(line, ConformanceWarning, stacklevel=2)
