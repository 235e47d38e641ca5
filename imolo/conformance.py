"""Conformance: scenes with known truth that a backend must reproduce, and the verdict on each measured number.

A backend's plugin offers `checks`; each one measures quantities beside their truth. Where a backend cannot do what is
asked, its plugin declares a `Limitation` with the reason; what is declared but measures well is as wrong as what is not
declared and measures badly, so that the declarations stay true.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from imolo.errors import ImoloError


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
    """What a backend cannot do, and why; its measured number is reported instead of a failure.

    Attributes:
        check: Name of the check.
        quantity: The one that is out of tolerance.
        reason: Why, for the reader of the report.
    """

    check: str
    quantity: str
    reason: str


class Verdict(StrEnum):
    """What came of a measurement."""

    PASS = "pass"
    UNSUPPORTED = "unsupported"
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


def run_check(check: Check, limitations: Sequence[Limitation]) -> list[Outcome]:
    """Run a check and judge what it measured.

    Args:
        check: The check.
        limitations: All that the backend declares.

    Returns:
        One outcome per quantity; a failure where the check raised an error or a declaration fits nothing.
    """
    declared = {limit.quantity: limit.reason for limit in limitations if limit.check == check.name}
    outcomes: list[Outcome] = []

    def conclude(verdict: Verdict, measurement: Measurement | None, remark: str = "") -> None:
        outcomes.append(Outcome(check.name, check.group, check.title, verdict, measurement, remark))

    try:
        for measurement in check.measure():
            reason = declared.pop(measurement.quantity, None)
            if reason is None:
                conclude(Verdict.PASS if measurement.within else Verdict.FAIL, measurement)
            elif measurement.within:
                conclude(Verdict.FAIL, measurement, f"declared unsupported ({reason}), but it is within its tolerance")
            else:
                conclude(Verdict.UNSUPPORTED, measurement, reason)
    except (ImoloError, ArithmeticError, LookupError, RuntimeError, TypeError, ValueError) as error:
        conclude(Verdict.FAIL, None, f"{type(error).__name__}: {error}")
        return outcomes
    for quantity in declared:
        conclude(Verdict.FAIL, None, f"declares a limitation of {quantity!r}, which this check does not measure")
    return outcomes
