"""What a check is, and how what it measured is judged."""

import math
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


@dataclass(frozen=True)
class Measurement:
    """A measured number beside the truth.

    Attributes:
        quantity: What was measured, in words that are unique within its check.
        unit: Of the three numbers; empty for a pure number.
        truth: What it should be.
        measured: What it is.
        tolerance: Largest allowed distance between the two.
        basis: Where the tolerance comes from.
    """

    quantity: str
    unit: str
    truth: float
    measured: float
    tolerance: float
    basis: str

    @property
    def within(self) -> bool:
        """Whether the measured number is finite and within its tolerance."""
        return math.isfinite(self.measured) and abs(self.measured - self.truth) <= self.tolerance


@dataclass(frozen=True)
class Check:
    """A scene and what is measured in it.

    Attributes:
        name: Unique among the checks of a backend.
        group: Heading under which it is reported.
        title: One line.
        measure: Runs the scene.
    """

    name: str
    group: str
    title: str
    measure: Callable[[], Iterable[Measurement]]


@dataclass(frozen=True)
class Limitation:
    """One cause for which a backend cannot do what is asked; measured numbers are reported instead of failures.

    Attributes:
        reason: The cause, for the reader of the report.
        quantities: By name of the check: all quantities that are out of tolerance for it.
    """

    reason: str
    quantities: Mapping[str, Sequence[str]]


class Verdict(StrEnum):
    """What came of a measurement, from the best to the worst; a warning is for the author, and fails nothing."""

    PASS = "pass"
    UNSUPPORTED = "unsupported"
    WARNING = "warning"
    FAIL = "fail"


@dataclass(frozen=True)
class Outcome:
    """The verdict on one quantity of one check.

    Attributes:
        check: Name of the check.
        group: Its group.
        title: Its title.
        verdict: The verdict.
        measurement: The numbers; None where the check broke off.
        remark: The declared reason, or what went wrong.
    """

    check: str
    group: str
    title: str
    verdict: Verdict
    measurement: Measurement | None
    remark: str = ""


def run_check(check: Check, limitations: Sequence[Limitation], exactly: bool = True) -> list[Outcome]:
    """Run a check and judge what it measured.

    Args:
        check: The check.
        limitations: All that the backend declares.
        exactly: Whether a declaration should apply, as it should under the options it was made for.

    Returns:
        One outcome per quantity; a failure where the check raised an error; a warning where a number is better than
        declared, and for each warning of Python.
    """
    declared = {name: limit.reason for limit in limitations for name in limit.quantities.get(check.name, ())}
    measured: set[str] = set()
    outcomes: list[Outcome] = []

    def conclude(verdict: Verdict, measurement: Measurement | None, remark: str = "") -> None:
        outcomes.append(Outcome(check.name, check.group, check.title, verdict, measurement, remark))

    try:
        for measurement in _measure(check, lambda said: conclude(Verdict.WARNING, None, said)):
            if measurement.quantity in measured:
                conclude(Verdict.FAIL, None, f"measures {measurement.quantity!r} twice")
                continue
            measured.add(measurement.quantity)
            reason = declared.pop(measurement.quantity, None)
            if reason is None:
                conclude(Verdict.PASS if measurement.within else Verdict.FAIL, measurement)
            elif measurement.within and not exactly:
                conclude(Verdict.PASS, measurement)
            elif not math.isfinite(measurement.measured):
                conclude(
                    Verdict.FAIL, measurement, f"declared unsupported ({reason}), but there is no number to report"
                )
            elif measurement.within:
                conclude(
                    Verdict.WARNING, measurement, f"declared unsupported ({reason}), but it is within its tolerance"
                )
            else:
                conclude(Verdict.UNSUPPORTED, measurement, reason)
    except Exception as error:  # noqa: BLE001 (a plug-in may raise anything, and the other checks are still to run)
        conclude(Verdict.FAIL, None, _explain(error))
        return outcomes
    for quantity in declared if exactly else ():
        conclude(Verdict.FAIL, None, f"declares a limitation of {quantity!r}, which this check does not measure")
    if not outcomes:
        conclude(Verdict.FAIL, None, "measures nothing")
    return outcomes


def _measure(check: Check, warn: Callable[[str], None]) -> Iterable[Measurement]:
    """Run a check and pass on what Python warns of meanwhile, once each."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            yield from check.measure()
        finally:
            for said in dict.fromkeys(
                f"{one.category.__name__}: {one.message} ({Path(one.filename).name}:{one.lineno})" for one in caught
            ):
                warn(said)


def _explain(error: Exception) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
