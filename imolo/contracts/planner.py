"""What a planner is: it listens to MOCAP and TRIAL, and commands the actuators."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from imolo.config.model import Model
from imolo.messaging.bus import Bus

if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig


class Controller(Protocol):
    """What commands the robot in a trial. It knows neither engine nor backend, only the messages."""

    def attach(self, bus: Bus) -> None:
        """Join the bus."""


class Planner(Controller, Protocol):
    """A controller that is kept over trials: it begins anew when TRIAL says that one starts.

    Attributes:
        commander: Instance of the program it runs in, to be said in every command; 0 where it is alone.
    """

    commander: int

    def warm_up(self) -> None:
        """Load and compile what takes seconds at first; a robot in real time cannot wait for it."""


@dataclass(frozen=True)
class PlannerPlugin:
    """What an entry point of the group `imolo.planners` names.

    Attributes:
        summary: One line for `imolo robots`.
        options: Model of the `planner` section of a method.
        create: Makes the planner of a method from the config, the name of the method, the table it has learned, and
            what is told how long each answer took [s].
        learns: Whether it needs a table, so that motions are learned before it plays.
    """

    summary: str
    options: type[Model]
    create: "Callable[[ExperimentConfig, str, Path, Callable[[float], object]], Planner]"
    learns: bool = True
