"""What actuators are: they turn the control target of every channel into joint torques, and sense what comes of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from imolo.config.disturbance import DisturbanceConfig
from imolo.config.model import Model
from imolo.conformance import Check
from imolo.contracts.urdf import Joint

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Channel:
    """What one number of a command means: a valve, a motor.

    Attributes:
        name: For people, such as "1: extends right hip".
        unit: SI unit of its target and of what its sensor measures, such as "Pa" or "rad".
        low: Lowest target that may be asked for.
        high: Highest target that may be asked for.
        rest: Target before the onset of a motion.
        released: Target after its end, and when the robot is to be made safe; a valve vents at 0.
    """

    name: str
    unit: str
    low: float
    high: float
    rest: float = 0.0
    released: float = 0.0


class Actuators(Protocol):
    """The actuators of one trial; a fresh instance per trial.

    Attributes:
        target: What the channels are asked for now, shape (C,); the framework writes into it.
        joint_torque: Torque about each joint [N·m], shape (J,); `step` fills it, and the engine reads the same array.
    """

    target: Array
    joint_torque: Array

    def step(self, joint_angle: Array, joint_velocity: Array) -> None:
        """Advance by one engine step under `target`, then set `joint_torque`.

        This is the hot path, called at every step.

        Args:
            joint_angle: At the start of the step [rad], shape (J,).
            joint_velocity: At the start of the step [rad/s], shape (J,).
        """

    def measured(self) -> Array:
        """Return what a perfect sensor of each channel reads, in the unit of the channel, shape (C,)."""


class ActuatorsConfig(Model):
    """The settings of a kind of actuators; a subclass holds them, and makes the actuators of a trial."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What can be commanded, in the order of every command."""
        raise NotImplementedError

    @property
    def sensor_noise(self) -> float:
        """Standard deviation of the channels' sensors, in their unit."""
        raise NotImplementedError

    def check_joints(self, joints: Sequence[Joint]) -> None:
        """Raise `ConfigError` where the settings do not fit the joints of a robot, in their order."""

    def settled_torque(self, target: Array, joint_angle: Array) -> Array:
        """Return what the joint torques settle to under constant targets, the joints held [N·m or N], shape (J,).

        The closed form that `imolo check --robot` compares the actuators with.

        Args:
            target: Of the channels, in their units, shape (C,).
            joint_angle: At which the joints are held [rad], shape (J,).
        """
        raise NotImplementedError

    def checks(self, joint_limits: Array) -> Sequence[Check]:
        """Return further checks in closed form that this kind of actuators offers, for `imolo check --robot`."""
        return ()

    def draw(self, disturbance: DisturbanceConfig, rng: np.random.Generator) -> Any:
        """Draw what is different in a trial, for `create`; always the same number of draws.

        Args:
            disturbance: How much one trial differs from another.
            rng: Chance of this trial.
        """
        raise NotImplementedError

    def create(self, joint_limits: Array, joint_angle: Array, timestep: float, drawn: Any = None) -> Actuators:
        """Make the actuators of one trial.

        Args:
            joint_limits: Lowest and highest angle of each joint [rad], shape (J, 2).
            joint_angle: At the start [rad], shape (J,).
            timestep: Of the engine [s].
            drawn: What `draw` returned; None for an undisturbed trial.

        Raises:
            ConfigError: They do not fit the joints.
        """
        raise NotImplementedError
