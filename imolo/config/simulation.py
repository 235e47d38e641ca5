"""What surrounds the robot in a simulation, the same for every engine and, but for the actuators, for every robot.

Each number is from the paper (its section is named), derived from it, or *assumed* with a reason.
"""

from typing import Annotated, Self

from pydantic import Field, SerializeAsAny, model_validator

from imolo.config.disturbance import DisturbanceConfig
from imolo.config.model import Fraction, Model, NonNegative, Positive, Searched, Vector
from imolo.contracts.actuators import ActuatorsConfig


class ContactConfig(Model):
    """What the contacts are asked to be."""

    friction: Annotated[NonNegative, Searched(0.2, 1.5)] = Field(
        0.8, description="Coulomb coefficient [-], assumed: rubber sole on wood"
    )
    restitution: Fraction = Field(0.3, description="of the ball [-], assumed: soft polyurethane foam")
    robot_restitution: Fraction = Field(0.0, description="of the robot on floor and boxes [-], assumed: none")


class BallConfig(Model):
    """The ball of Sec. VII-A: soft polyurethane foam."""

    radius: Positive = Field(0.045, description="[m], Sec. VII-A")
    mass: Positive = Field(0.010, description="[kg], Sec. VII-A")
    drag_coefficient: NonNegative = Field(0.45, description="of a sphere [-], assumed: subcritical flow")
    lift_slope: NonNegative = Field(1.0, description="lift coefficient over r ω / v [-], assumed: of slow spins")
    air_density: NonNegative = Field(1.2, description="of the room [kg/m³]")


class MocapConfig(Model):
    """The motion-capture system as the planner sees it (Secs. V-B, VII-A)."""

    rate: Positive = Field(120.0, description="frames per second [Hz], Sec. VII-A")
    latency: NonNegative = Field(0.005, description="exposure to delivery [s], assumed: typical of the camera family")
    clock_offset: Annotated[float, Searched(-0.02, 0.02, "linear")] = Field(
        0.0,
        description="of the stamps, late where positive [s]; can be fitted to logs",
        exclude_if=lambda late: not late,
    )
    marker_noise: NonNegative = Field(0.0003, description="sd of a robot marker, each axis [m], assumed")
    ball_noise: NonNegative = Field(
        0.001, description="sd of the ball, each axis [m], assumed: seals on a 90 mm sphere, not a marker"
    )
    marker_dropout: Fraction = Field(0.002, description="chance that a robot marker is missing in a frame, assumed")
    ball_dropout: Fraction = Field(0.02, description="chance that the ball is missing in a frame, assumed")
    frame_dropout: Fraction = Field(0.001, description="chance that a whole frame is lost, assumed")
    unlabelled: Fraction = Field(0.005, description="chance that a robot marker loses its label in a frame, assumed")
    ghost: Fraction = Field(0.01, description="chance that a frame holds a reflection that is no marker, assumed")


class ThrowerConfig(Model):
    """The machine that throws the ball (Sec. VII-A).

    The operator aims it so that the ball passes the reach of the robot: an aim point is drawn for each throw, and the
    release velocity that flies through it is found; then the machine's own scatter is added.
    """

    positions: Annotated[tuple[Vector, ...], Field(min_length=1)] = Field(
        description="points of release [m]; the throws take turns"
    )
    aim_center: Vector = Field(description="middle of the aim points [m]: the reach of the robot")
    aim_spread: Vector = Field((0.0, 0.0, 0.0), description="half range of the aim points [m]")
    flight_time: Positive = Field(description="release to aim point [s]")
    flight_time_spread: NonNegative = Field(0.04, description="half range of it [s], assumed")
    speed_scatter: NonNegative = Field(0.01, description="sd of the speed, relative [-], assumed: repeatability")
    angle_scatter: NonNegative = Field(0.005, description="sd of the two angles [rad], assumed: repeatability")
    topspin: Annotated[float, Searched(-60.0, 60.0, "linear")] = Field(
        0.0,
        description="of the ball [rad/s], below 0 backspin; the throws that a ball model is learned from have none",
    )
    spin_scatter: NonNegative = Field(0.0, description="sd of the spin, each axis, of every throw [rad/s]")
    hold_time: tuple[NonNegative, NonNegative] = Field((0.05, 0.10), description="range of the wait before release [s]")

    @model_validator(mode="after")
    def _hold_time_is_a_range(self) -> Self:
        if self.hold_time[0] > self.hold_time[1]:
            raise ValueError(f"hold_time {self.hold_time} is not (shortest, longest)")
        return self


class SimulationConfig(Model):
    """Everything around the rigid bodies; a hardware backend does not read it."""

    timestep: Annotated[float, Field(gt=0, le=5e-3)] = Field(1e-4, description="of the engine [s], Sec. VI")
    sensor_rate: Positive = Field(1000.0, description="of the actuators' sensors, ACTUATOR_STATE [Hz]")
    truth_rate: Positive = Field(
        240.0, description="of TRUTH_ROBOT and TRUTH_BALL [Hz]; at 120 Hz every mocap frame has its truth"
    )
    actuators: SerializeAsAny[ActuatorsConfig]
    contact: ContactConfig = ContactConfig()
    ball: BallConfig = BallConfig()
    mocap: MocapConfig = MocapConfig()
    thrower: ThrowerConfig
    disturbance: SerializeAsAny[DisturbanceConfig] = DisturbanceConfig()

    @model_validator(mode="after")
    def _streams_are_slower_than_steps(self) -> Self:
        rates = {"sensor_rate": self.sensor_rate, "truth_rate": self.truth_rate, "mocap.rate": self.mocap.rate}
        for name, rate in rates.items():
            if rate * self.timestep > 1.0 + 1e-9:
                raise ValueError(f"{name} {rate:g} Hz is more than one message in a timestep of {self.timestep:g} s")
        return self
