"""The settings of the valve board: its channels, its limits, its times."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from imolo.config.loading import config_for
from imolo.config.model import Model, NonNegative, Positive
from imolo.contracts.registry import default_robot
from imolo.errors import BackendNotFoundError, ConfigError
from imolo_drivers.board.valve_io import IioConfig

MAX_CHANNELS = 128  # a state of all of them fits into a frame
HIGHEST = 0.9e6  # [Pa] unless the channels say another
FILL_RATE = 50e6  # [Pa/s] the supply's 0.9 MPa in 18 ms, assumed: a step for the chambers, none for a wrong number


class ChannelConfig(Model):
    """An actuator and the sensor behind it; a target of 0 is vented, or without force."""

    name: str = Field(max_length=60, description='for a person, such as "valve 1: extends right hip"')
    unit: str = Field("Pa", max_length=12, description="of its targets and measurements")
    rest: float = Field(0.0, description="target while armed and without a motion [unit]")
    lowest: float = Field(0.0, le=0.0, description="a lower target is refused [unit]")
    highest: float = Field(HIGHEST, ge=0.0, description="a higher target is refused [unit]")
    limit: Positive | None = Field(None, description="of its own instead of the board's pressure_limit [unit]")
    rise_limit: NonNegative | None = Field(None, description="of its own instead of the board's rise_limit [unit/s]")

    @model_validator(mode="after")
    def _rest_is_allowed(self) -> Self:
        if not self.lowest <= self.rest <= self.highest:
            raise ValueError(f"rest {self.rest:g} is not within {self.lowest:g} to {self.highest:g} {self.unit}")
        return self


def channels_of(robot: str) -> tuple[ChannelConfig, ...]:
    """Return the channels of an installed robot as settings of a board.

    Raises:
        ConfigError: It is not installed.
    """
    try:
        actuators = config_for("hardware", robot={"name": robot}).simulation.actuators
    except BackendNotFoundError as error:
        raise ConfigError(f"{error}; a board of another robot says its `channels` itself") from error
    return tuple(
        ChannelConfig(name=one.name[:60], unit=one.unit, rest=one.rest, lowest=min(one.low, 0.0), highest=one.high)
        for one in actuators.channels
    )


class BoardConfig(Model):
    """How the valve board keeps its robot safe."""

    name: str = Field("valve board", max_length=80, description="told to whoever connects")
    robot: str = Field(
        default_factory=default_robot,
        max_length=80,
        description="told to whoever connects, who refuses another robot; the default robot if not given",
    )
    channels: Annotated[tuple[ChannelConfig, ...], Field(min_length=1, max_length=MAX_CHANNELS)] = Field(
        default_factory=lambda given: channels_of(given["robot"]),
        description="in the order of the commands; those of the robot, which is to be installed then, if not given",
    )
    secret: Path | None = Field(
        None, description="file of mode 0600 that clients must know; none: the board listens to this machine alone"
    )
    watchdog: Annotated[float, Field(ge=0.01, le=1.0)] = Field(
        0.1,
        description="without a valid command in a motion or any frame while armed, vent and latch within this time [s]",
    )
    pressure_limit: Positive = Field(
        HIGHEST, description="targets farther from 0 are clamped [unit]; lower it for the first start"
    )
    rise_limit: NonNegative = Field(
        FILL_RATE,
        description="fastest departure of a target from 0 [unit/s], return is never slowed; 0 for none; lower it for "
        "the first start",
    )
    time_window: Positive = Field(
        10.0, description="a command whose times are farther from the clock of the board is refused [s], assumed"
    )
    state_rate: Annotated[float, Field(gt=0.0, le=1000.0)] = Field(1000.0, description="of measurements and state [Hz]")
    silence: Annotated[float, Field(ge=0.2)] = Field(
        1.0, description="a connection that says nothing is closed [s], assumed; frees the board of half-open ones"
    )
    dry_run: bool = Field(False, description="do everything but move: all targets stay 0")
    iio: IioConfig | None = Field(None, description="the converters; none: simulated valves that follow at once")

    @model_validator(mode="after")
    def _converters_have_a_channel_each(self) -> Self:
        for name, converter in (("dac", self.iio and self.iio.dac), ("adc", self.iio and self.iio.adc)):
            if converter and len(converter.channels) != len(self.channels):
                count, wanted = len(converter.channels), len(self.channels)
                raise ValueError(f"iio.{name} has {count} channels; give {wanted}, one for each of `channels`")
        return self

    def limit(self, channel: ChannelConfig) -> float:
        """Return how far from 0 the target of a channel may be [unit]."""
        return self.pressure_limit if channel.limit is None else channel.limit

    def slew_limit(self, channel: ChannelConfig) -> float:
        """Return how fast the target of a channel may depart from 0 [unit/s]; 0 where it is not limited."""
        return self.rise_limit if channel.rise_limit is None else channel.rise_limit
