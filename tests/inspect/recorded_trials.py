"""What the tests of recorded trials share."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

Run = Callable[..., tuple[int, str, str]]

METHOD = "paper"  # whose planner has the default settings


@dataclass(frozen=True)
class Recorded:
    """Logs of two balls, and the table with which both were planned."""

    first: Path
    second: Path
    table: Path
