"""What the tests of recorded trials share."""

from dataclasses import dataclass
from pathlib import Path

METHOD = "paper"  # whose planner has the default settings


@dataclass(frozen=True)
class Recorded:
    """Logs of two balls, and the table with which both were planned."""

    first: Path
    second: Path
    table: Path
