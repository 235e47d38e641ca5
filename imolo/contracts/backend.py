"""What a backend is: a body, simulated or real, that speaks the LCM streams and is the only clock."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from imolo.config.model import Model
from imolo.conformance import Check, Limitation
from imolo.contracts.engine import Engine
from imolo.contracts.trial import Trial
from imolo.messaging.bus import Bus

if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig


class Backend(Protocol):
    """Publishes MOCAP, ACTUATOR_STATE and TRIAL events, and executes ACTUATOR_COMMAND; one instance per trial."""

    @property
    def utime(self) -> int:
        """Time of the backend's clock [µs]."""

    def start(self, bus: Bus, trial: Trial) -> None:
        """Bring the robot to its ready pose and join the bus."""

    def advance(self, until_utime: int) -> None:
        """Simulate up to this time, or wait for it [µs].

        Raises:
            DivergenceError: The simulated state is no longer finite.
        """

    def close(self) -> None:
        """Leave the bus and free what the backend holds."""


@dataclass(frozen=True)
class BackendPlugin:
    """What an entry point of the group `imolo.backends` names.

    Attributes:
        summary: One line for `imolo backends`.
        options: Model of the backend's own section of the config.
        create: Makes a backend for one trial from the whole config and the validated options.
        checks: Makes the conformance checks of the backend under these options, for `imolo check`.
        limitations: What it cannot do under its default options.
        ingredients: What can be exchanged in it, for `imolo attribute`: by ingredient, the alternative settings, each
            a set of the backend's options.
        simulated: Whether it may be run unasked; a robot moves only for who names its backend.
        engine: The physics engine in it, for scenes without a robot; None where there is none.
    """

    summary: str
    options: type[Model]
    create: Callable[["ExperimentConfig", Model], Backend]
    checks: Callable[[Model], Sequence[Check]] = lambda _: ()
    limitations: tuple[Limitation, ...] = ()
    ingredients: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    simulated: bool = True
    engine: type[Engine] | None = None
