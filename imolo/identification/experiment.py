"""What a study fits: recordings, each of which can be played again in an engine under other settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Errors = Mapping[str, Array]
"""By quantity: simulated less recorded in its unit, shape (N, D); its size is the norm over D."""


@dataclass(frozen=True)
class Quantity:
    """What is compared.

    Attributes:
        name: Such as "position".
        unit: As it is shown, such as "mm".
        factor: From the SI unit to the one shown.
        scale: An error of this size [SI] counts one in the loss.
    """

    name: str
    unit: str
    factor: float
    scale: float


class Recording(Protocol):
    """One recording, which a process of its own can play."""

    @property
    def name(self) -> str:
        """For people."""

    def play(self, config: Any) -> Errors:
        """Play it under a config and return what differs, by quantity.

        Raises:
            BackendError: The engine refuses the settings, or diverges.
        """


@dataclass(frozen=True)
class Finding:
    """What the check of the data found.

    Attributes:
        what: Such as "free fall".
        text: In words, with numbers.
        warning: Whether it is to be mended, or at least known.
        value: The number itself, with `deviation`, where there is one.
        deviation: Its standard deviation.
        recordings: Names of the recordings it is about; all if empty.
        unusable: Whether these are left out.
    """

    what: str
    text: str
    warning: bool = False
    value: float | None = None
    deviation: float | None = None
    recordings: tuple[str, ...] = ()
    unusable: bool = False


@dataclass(frozen=True, eq=False)
class Experiment:
    """The recordings of a study, and what is known before the fit.

    Attributes:
        recordings: That can be played.
        quantities: What is compared.
        findings: What the check of the data found.
        configs: Where the search starts, by engine.
        loss: Mean size of the errors, which outliers pull little, or mean square, for smooth motions.
        digest: Hash of all that is played, beside the configs.
        apart: Which recordings are only for judging, where the study says so.
    """

    recordings: Sequence[Recording]
    quantities: Sequence[Quantity]
    findings: Sequence[Finding]
    configs: Mapping[str, Any]
    loss: Literal["absolute", "squared"] = "absolute"
    digest: str = ""
    apart: Sequence[int] = ()

    def names(self, indices: Sequence[int]) -> list[str]:
        """Return the names of recordings."""
        return [self.recordings[index].name for index in indices]


def sizes(errors: Errors) -> dict[str, float]:
    """Return the mean size of the errors of one recording, by quantity [SI]."""
    return {name: float(np.linalg.norm(error, axis=1).mean()) for name, error in errors.items()}


def residuals(errors: Errors, quantities: Sequence[Quantity]) -> Array:
    """Return errors as one vector, so that its squared length is the mean squared loss of the recording."""
    return np.concatenate(
        [(errors[one.name] / (one.scale * np.sqrt(len(errors[one.name])))).ravel() for one in quantities]
    )


def loss_of(errors: Errors, experiment: Experiment) -> float:
    """Return the loss of one recording."""
    if experiment.loss == "squared":
        vector = residuals(errors, experiment.quantities)
        return float(vector @ vector)
    mean = sizes(errors)
    return sum(mean[one.name] / one.scale for one in experiment.quantities)
