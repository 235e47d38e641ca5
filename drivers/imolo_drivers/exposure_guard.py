"""Keeps frames out whose exposure cannot be true: what they show would be taken for now, or would hide what follows."""

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
        refused: Frames that were not.
        problem: What was wrong with the last frame; empty if nothing was.
    """

    def __init__(self, limits: ExposureLimits, begin: float) -> None:
        """Know of no frame; those exposed before `begin` are left out, but nothing is wrong with them."""
        self.heard = begin
        self.refused = 0
        self.problem = ""
        self._limits, self._begin, self._newest = limits, begin, begin

    def accept(self, exposed: float, error: float, now: float) -> bool:
        """Return whether a frame that came `now` can have been exposed then, give or take the greatest error."""
        age, since = now - exposed, exposed - self._newest
        if age > self._limits.oldest + error:
            problem = f"exposed {age:.3g} s before it came"
        elif age < -self._limits.ahead - error:
            problem = f"exposed {-age:.3g} s after it came"
        elif since <= min(2.0 * error, self._limits.step):  # two echoes may disagree by so much about one stamp
            problem = f"exposed {1e3 * since:.3g} ms after the one before"
        else:
            self.heard, self._newest, self.problem = now, exposed, ""
            return True
        self.refused += exposed > self._begin
        self.problem = f"a camera frame was {problem}"
        return False
