"""Keeps frames out whose exposure cannot be true: what they show would be taken for now, or would hide what follows."""

from collections import Counter

from pydantic import Field

from imolo.config.model import Model, Positive


class ExposureLimits(Model):
    """When the cameras can have exposed a frame that comes now."""

    oldest: Positive = Field(0.25, description="exposed so long before it came [s], assumed: the tracker's patience")
    ahead: Positive = Field(
        0.002, description="beyond the error of the clocks [s], assumed: a quarter of the time between two frames"
    )
    step: Positive = Field(
        0.001, description="less than that later than the frame before is the same moment [s], assumed: 1000 Hz"
    )


class ExposureGuard:
    """Compares the exposure of every frame with the time at which it came, and with the frame before; times in s.

    Attributes:
        heard: When the last good frame came.
        refused: How many were not, by what was wrong with them.
        problem: What was wrong with the last frame; empty if nothing was.
        is_news: Whether that was wrong with no frame before.
    """

    def __init__(self, limits: ExposureLimits, begin: float) -> None:
        """Know of no frame; those exposed before `begin` are left out, but nothing is wrong with them."""
        self.heard = begin
        self.refused: Counter[str] = Counter()
        self.problem = ""
        self.is_news = False
        self._limits, self._begin, self._newest = limits, begin, begin

    def accept(self, exposed: float, error: float, now: float) -> bool:
        """Return whether a frame that came `now` can have been exposed then, give or take the greatest error."""
        age, since = now - exposed, exposed - self._newest
        if age > self._limits.oldest + error:
            by, what = f"{age:.3g} s", "before it came"
        elif age < -self._limits.ahead - error:
            by, what = f"{-age:.3g} s", "after it came"
        elif since <= min(2.0 * error, self._limits.step):  # two echoes may disagree by so much about one stamp
            by, what = f"{1e3 * since:.3g} ms", "after the one before"
        else:
            self.heard, self._newest, self.problem = now, exposed, ""
            return True
        self.is_news = exposed > self._begin and what not in self.refused
        self.refused[what] += exposed > self._begin
        self.problem = f"a camera frame was exposed {by} {what}"
        return False
