"""What surrounds the robot in a simulation, the same for every engine.

Each number is from the paper (its section is named), derived from it, or *assumed* with a reason. Assumed numbers were
chosen together, so that the motion looks like the paper's: k moves the hand sideways, t_w forward and up.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from imolo.config.model import Fraction, Model, NonNegative, Positive, Vector

EightPressures = Annotated[tuple[NonNegative, ...], Field(min_length=8, max_length=8)]


class PneumaticsConfig(Model):
    """Cylinders, tubes, valves and tanks; pressures are gauge pressures [Pa] unless they say absolute."""

    supply_pressure: Positive = Field(0.9e6, description="pressure of the filled tanks [Pa], Sec. VII-B")
    tank_volume: Positive = Field(4 * 550e-6, description="four tanks, lumped [m³], Sec. V-B")
    leg_bore: Positive = Field(0.040, description="inner diameter [m], Sec. V-A")
    arm_bore: Positive = Field(0.025, description="inner diameter [m], Sec. V-A")
    moment_arm: Positive = Field(0.026, description="radius of the joint pulley [m], Sec. V-A")
    leg_reduction: Positive = Field(2.0, description="speed reduction of the leg pulleys [-], Sec. V-A")
    tube_diameter: Positive = Field(0.004, description="inner diameter of the tubes [m], Sec. V-B")
    tube_length: Positive = Field(0.5, description="valve to chamber [m], assumed: half the robot's height")
    critical_ratio: Fraction = Field(0.3, description="b of ISO 6358 for valves and tubes [-], assumed: typical")
    supply_conductance: Positive = Field(
        0.8e-8, description="sonic conductance of a valve from tank to tube [m³/(s·Pa)], assumed: lift-off at 0.23 s"
    )
    exhaust_conductance: Positive = Field(
        3.0e-8,
        description="sonic conductance of a valve to the air [m³/(s·Pa)], assumed: arm at 60-130° at t_w + 0.17 s",
    )
    full_opening_error: Positive = Field(0.3e5, description="pressure error that opens a valve fully [Pa], assumed")
    valve_time_constant: Positive = Field(
        0.015, description="first-order lag of the opening [s], assumed: see conductances"
    )
    valve_dead_time: NonNegative = Field(0.010, description="delay of the command [s], assumed: see conductances")
    dead_volume: Positive = Field(15e-6, description="of a chamber at the end of its stroke [m³], assumed")
    manifold_volume: Positive = Field(4e-6, description="behind each valve [m³], assumed")
    heat_in: Positive = Field(1.4, description="exponent of gas flowing in [-], Richer & Hurmuzlu 2000: adiabatic")
    heat_out: Positive = Field(1.0, description="exponent of gas flowing out [-], Richer & Hurmuzlu 2000: isothermal")
    heat_volume: Positive = Field(1.2, description="polytropic exponent of the moving piston [-], ibid.")
    temperature: Positive = Field(293.15, description="of the gas [K], assumed: room")
    leg_coulomb_friction: NonNegative = Field(1.2, description="[N·m], assumed")
    leg_viscous_friction: NonNegative = Field(0.10, description="[N·m·s], assumed")
    arm_coulomb_friction: NonNegative = Field(0.12, description="[N·m], assumed")
    arm_viscous_friction: NonNegative = Field(0.01, description="[N·m·s], assumed")
    friction_smoothing: Positive = Field(0.5, description="speed over which dry friction builds up [rad/s], numerical")
    laminar_ratio: Fraction = Field(0.995, description="pressure ratio above which flow is linear [-], numerical")
    rest_pressure: EightPressures = Field(
        (0.0,) * 7 + (0.05e6,), description="valves 1..8 before the onset [Pa], assumed: valve 8 holds the crouch"
    )
    max_substep: Annotated[float, Field(gt=0, le=1e-4)] = Field(1e-4, description="longest integration step [s]")

    @model_validator(mode="after")
    def _valve_is_slower_than_a_substep(self) -> Self:
        if self.valve_time_constant < self.max_substep:
            raise ValueError(
                f"valve_time_constant {self.valve_time_constant:g} s cannot be integrated in substeps of "
                f"{self.max_substep:g} s; give at least that much, or a smaller max_substep"
            )
        return self


class ContactConfig(Model):
    """What the contacts are asked to be."""

    friction: NonNegative = Field(0.8, description="Coulomb coefficient [-], assumed: rubber sole on wood")
    restitution: Fraction = Field(0.3, description="of the ball [-], assumed: soft polyurethane foam")


class BallConfig(Model):
    """The ball of Sec. VII-A: soft polyurethane foam."""

    radius: Positive = Field(0.045, description="[m], Sec. VII-A")
    mass: Positive = Field(0.010, description="[kg], Sec. VII-A")
    drag_coefficient: NonNegative = Field(0.45, description="of a sphere [-], assumed: subcritical flow")
    air_density: NonNegative = Field(1.2, description="[kg/m³]")


class MocapConfig(Model):
    """The motion-capture system as the planner sees it (Secs. V-B, VII-A)."""

    rate: Positive = Field(120.0, description="frames per second [Hz], Sec. VII-A")
    latency: NonNegative = Field(0.005, description="exposure to delivery [s], assumed: typical of the camera family")
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
    """The machine that throws the ball from about 5 m to land before the robot after about 1 s (Sec. VII-A).

    The operator aims it so that the ball passes the reach of the robot: an aim point is drawn for each throw, and the
    release velocity that flies through it is found; then the machine's own scatter is added.
    """

    positions: Annotated[tuple[Vector, ...], Field(min_length=1)] = Field(
        ((5.0, -0.4, 1.1), (5.0, 0.4, 1.1)), description="points of release [m], Sec. VII-A; lateral offset assumed"
    )
    aim_center: Vector = Field(
        (0.95, -0.16, 1.60), description="middle of the aim points [m], assumed: the reach of the right hand"
    )
    aim_spread: Vector = Field((0.15, 0.10, 0.10), description="half range of the aim points [m], assumed: likewise")
    flight_time: Positive = Field(0.80, description="release to aim point [s], assumed: the ball lands after about 1 s")
    flight_time_spread: NonNegative = Field(0.04, description="half range of it [s], assumed")
    speed_scatter: NonNegative = Field(0.01, description="sd of the speed, relative [-], assumed: repeatability")
    angle_scatter: NonNegative = Field(0.005, description="sd of the two angles [rad], assumed: repeatability")
    hold_time: tuple[NonNegative, NonNegative] = Field((0.05, 0.10), description="range of the wait before release [s]")

    @model_validator(mode="after")
    def _hold_time_is_a_range(self) -> Self:
        if self.hold_time[0] > self.hold_time[1]:
            raise ValueError(f"hold_time {self.hold_time} is not (shortest, longest)")
        return self


class DisturbanceConfig(Model):
    """How much the robot differs from one trial to the next; every value is a standard deviation.

    `realistic` is *assumed*: its hands scatter by about as much as the paper's, whose distance to the selected grid
    point was 12.9 ± 9.4 mm with all errors together (Sec. VII-C).
    """

    profile: Literal["none", "realistic", "custom"] = "realistic"
    valve_dead_time: NonNegative = Field(0.0, description="of each valve's dead time [s]")
    supply_pressure: NonNegative = Field(0.0, description="of the filled tanks [Pa]")
    joint_angle: NonNegative = Field(0.0, description="of each joint in the ready pose, inwards from its limit [rad]")

    @model_validator(mode="before")
    @classmethod
    def _profile_sets_the_values(cls, values: object) -> object:
        if not isinstance(values, dict):
            return values
        profile = values.get("profile", "realistic")
        named = NAMED_DISTURBANCES.get(str(profile))
        if named is None:
            return values
        for key, value in values.items():
            if key != "profile" and key in named and value != named[key]:
                raise ValueError(f"profile {profile!r} sets {key} itself; use `profile: custom` to choose {key}")
        return {**values, **named}


NAMED_DISTURBANCES: dict[str, dict[str, float]] = {
    "none": {"valve_dead_time": 0.0, "supply_pressure": 0.0, "joint_angle": 0.0},
    "realistic": {"valve_dead_time": 0.0003, "supply_pressure": 0.005e6, "joint_angle": 0.001},
}


class SimulationConfig(Model):
    """Everything around the rigid bodies; a hardware backend does not read it."""

    timestep: Annotated[float, Field(gt=0, le=5e-3)] = Field(1e-4, description="of the engine [s], Sec. VI")
    sole: Literal["semicircular", "flat"] = Field("semicircular", description="Sec. V-A")
    pressure_rate: Positive = Field(1000.0, description="of VALVE_PRESSURE [Hz]")
    truth_rate: Positive = Field(
        240.0, description="of TRUTH_ROBOT and TRUTH_BALL [Hz]; at 120 Hz every mocap frame has its truth"
    )
    pressure_noise: NonNegative = Field(1.0e3, description="sd of a pressure sensor [Pa], assumed: 0.1 % of full scale")
    pneumatics: PneumaticsConfig = PneumaticsConfig()
    contact: ContactConfig = ContactConfig()
    ball: BallConfig = BallConfig()
    mocap: MocapConfig = MocapConfig()
    thrower: ThrowerConfig = ThrowerConfig()
    disturbance: DisturbanceConfig = DisturbanceConfig()

    @model_validator(mode="after")
    def _streams_are_slower_than_steps(self) -> Self:
        rates = {"pressure_rate": self.pressure_rate, "truth_rate": self.truth_rate, "mocap.rate": self.mocap.rate}
        for name, rate in rates.items():
            if rate * self.timestep > 1.0 + 1e-9:
                raise ValueError(f"{name} {rate:g} Hz is more than one message in a timestep of {self.timestep:g} s")
        return self
