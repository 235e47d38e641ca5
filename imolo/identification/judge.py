"""Judge fits on recordings that they have not seen, and engines against each other on the same ones."""

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from imolo.identification.evaluation import Outcome

Array = NDArray[np.float64]

RESAMPLES = 2000
INSIDE = 0.95


class Spread(BaseModel):
    """A mean over recordings.

    Attributes:
        mean: Itself.
        sd: Standard deviation over the recordings.
        low: Lower end of its 95 % bootstrap interval.
        high: Upper end.
        count: Number of recordings.
    """

    model_config = ConfigDict(frozen=True)

    mean: float
    sd: float
    low: float
    high: float
    count: int

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval lies on one side of 0."""
        return self.low > 0.0 or self.high < 0.0


def spread(values: Array) -> Spread | None:
    """Return mean, standard deviation and interval of one number per recording; those that are NaN are left out."""
    finite = values[np.isfinite(values)]
    if len(finite) < 2:
        return None
    chance = np.random.default_rng(0)
    means = finite[chance.integers(len(finite), size=(RESAMPLES, len(finite)))].mean(axis=1)
    low, high = np.quantile(means, [0.5 - INSIDE / 2.0, 0.5 + INSIDE / 2.0])
    return Spread(mean=finite.mean(), sd=finite.std(ddof=1), low=low, high=high, count=len(finite))


def choose(candidates: Mapping[str, Outcome]) -> str:
    """Return which candidate is taken: a later one, with more parameters, only if it surely wins on these recordings.

    Args:
        candidates: From the one with the fewest parameters on, each played on the same held-out recordings.
    """
    names = list(candidates)
    taken = names[0]
    for name in names[1:]:
        difference = spread(candidates[name].loss - candidates[taken].loss)
        if difference is not None and difference.high < 0.0:
            taken = name
    return taken


def paired(first: Array, second: Array) -> Spread | None:
    """Return the spread of the difference, second less first, of two results on the same recordings."""
    return spread(second - first)


def split(
    count: int,
    training: int,
    held_out: int | None,
    seed: int,
    left_out: Collection[int],
    apart: Collection[int] = (),
) -> tuple[list[int], list[int]]:
    """Return which recordings a fit sees and which it is judged on, drawn once by the seed.

    Args:
        count: Number of recordings.
        training: How many the fit sees.
        held_out: How many it is judged on; all others if not given.
        seed: Of the draw.
        left_out: Recordings that are not used.
        apart: Recordings that fits are judged on, and no others; drawn from what a fit does not see if empty.
    """
    order = [index for index in np.random.default_rng(seed).permutation(count).tolist() if index not in left_out]
    seen = [index for index in order if index not in apart][:training]
    rest = [index for index in order if (index in apart if apart else index not in seen)]
    return sorted(seen), sorted(rest if held_out is None else rest[:held_out])
