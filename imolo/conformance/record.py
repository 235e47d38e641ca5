"""What came of the checks of one backend, and how it is kept as JSON."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from imolo.conformance.check import Measurement, Outcome, Verdict
from imolo.conformance.suite import Suite
from imolo.errors import ResultsError
from imolo.machine.files import write_whole

Cell = tuple[str, str]
"""Check and quantity, which name a number; the quantity is empty where a check broke off."""


@dataclass(frozen=True)
class Record:
    """What came of the checks of one backend.

    Attributes:
        label: Under which it is reported.
        backend: Name of the backend.
        options: The options that were chosen; all others had their defaults.
        versions: Version of each package that the backend needs.
        outcomes: One per quantity, in the order of the checks.
    """

    label: str
    backend: str
    options: dict[str, Any]
    versions: dict[str, str]
    outcomes: tuple[Outcome, ...]

    @property
    def cells(self) -> dict[Cell, Outcome]:
        """The outcomes by check and quantity."""
        return {cell(outcome): outcome for outcome in self.outcomes}

    def count(self, verdict: Verdict) -> int:
        """Return how many quantities have this verdict."""
        return sum(outcome.verdict is verdict for outcome in self.outcomes)


def cell(outcome: Outcome) -> Cell:
    """Return the name of an outcome's number."""
    return outcome.check, outcome.measurement.quantity if outcome.measurement else ""


def record(suite: Suite, outcomes: Sequence[Outcome]) -> Record:
    """Return the record of a suite that was run."""
    return Record(suite.label, suite.backend, suite.options, suite.versions(), tuple(outcomes))


def worst(outcomes: Sequence[Outcome]) -> Verdict:
    """Return the worst of some verdicts."""
    return max((outcome.verdict for outcome in outcomes), key=list(Verdict).index)


def save_records(path: Path, records: Sequence[Record]) -> None:
    """Write records as JSON.

    Raises:
        ResultsError: The file cannot be written.
    """
    write_text(path, "[\n" + ",\n".join(_to_text(one) for one in records) + "\n]\n")


def load_records(path: Path) -> list[Record]:
    """Read records.

    Raises:
        ResultsError: The file cannot be read, or holds something else.
    """
    try:
        return [_from_json(one) for one in json.loads(path.read_text(encoding="utf-8"))]
    except OSError as error:
        raise ResultsError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, LookupError, TypeError) as error:
        raise ResultsError(f"{path} does not hold what `imolo check` wrote: {error!r}") from error


def write_text(path: Path, text: str) -> None:
    """Write a file.

    Raises:
        ResultsError: It cannot be written.
    """
    try:
        write_whole(path, text)
    except OSError as error:
        raise ResultsError(f"cannot write {path}: {error.strerror}") from error


def _to_text(one: Record) -> str:
    lines = []
    for outcome in one.outcomes:
        entry = asdict(outcome)
        if outcome.measurement and not math.isfinite(outcome.measurement.measured):
            # JSON knows no such numbers.
            entry["measurement"]["measured"] = str(outcome.measurement.measured)
        lines.append(json.dumps(entry, ensure_ascii=False, allow_nan=False))
    head = json.dumps({**asdict(one), "outcomes": []}, ensure_ascii=False, allow_nan=False)
    # A line for each number, so that a change of one is a change of a line.
    return head.removesuffix("]}") + "\n" + ",\n".join(lines) + "\n]}"


def _from_json(content: dict[str, Any]) -> Record:
    outcomes = []
    for entry in content["outcomes"]:
        values = entry["measurement"]
        measurement = values and Measurement(**{**values, "measured": float(values["measured"])})
        outcomes.append(Outcome(**{**entry, "verdict": Verdict(entry["verdict"]), "measurement": measurement}))
    return Record(**{**content, "outcomes": tuple(outcomes)})
