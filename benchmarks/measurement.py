"""What a benchmark returns: a number, and how large it may be."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Measurement:
    """One number; less is better.

    Attributes:
        subject: What was measured.
        quantity: Which number of it.
        value: In `unit`.
        unit: Unit of value and target; empty for a ratio.
        target: Highest value that is fast enough; None where the number only explains another one.
    """

    subject: str
    quantity: str
    value: float
    unit: str
    target: float | None = None

    @property
    def verdict(self) -> str:
        """Return "ok" or "slow"; nothing without a target."""
        if self.target is None:
            return ""
        return "ok" if self.value <= self.target else "slow"
