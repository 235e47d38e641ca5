"""Pneumatic actuators: proportional valves, tubes, tanks, and a cylinder on every joint."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from imolo.config.disturbance import DisturbanceConfig
from imolo.config.experiment import ExperimentConfig
from imolo.config.model import Fraction, Model, NonNegative, Positive, Searched
from imolo.config.simulation import SimulationConfig
from imolo.conformance import Check
from imolo.contracts.actuators import Actuators, ActuatorsConfig, Channel
from imolo.errors import ConfigError
from imolo.method.motion import PhasedMotion
from imolo_backends.actuators import pneumatics_kernel as k
from imolo_backends.compiled import CFunction, c_function

Array = NDArray[np.float64]

ATMOSPHERE = 101325.0  # [Pa]
GAS_CONSTANT = 287.05  # of dry air [J/(kg·K)]
REFERENCE_DENSITY = 1.185  # of ISO 6358's reference air, 20 °C, 100 kPa, 65 % humidity [kg/m³]
REFERENCE_TEMPERATURE = 293.15  # [K], ISO 6358


class Cylinder(Model):
    """The double-acting cylinder on one joint.

    Attributes:
        bore: Inner diameter [m].
        lever: Piston travel per joint angle [m/rad]: radius of the joint's pulley, times the reduction.
        coulomb_friction: [N·m].
        viscous_friction: [N·m·s].
        up: Valve of the chamber that drives the joint angle up, counted from 1.
        down: Valve of the chamber that drives it down.
    """

    bore: Positive
    lever: Positive
    coulomb_friction: NonNegative = 0.0
    viscous_friction: NonNegative = 0.0
    up: Annotated[int, Field(ge=1)]
    down: Annotated[int, Field(ge=1)]


class PneumaticDisturbance(DisturbanceConfig):
    """How much a pneumatic robot differs from one trial to the next."""

    profiles: ClassVar[dict[str, dict[str, float]]] = {
        "none": {},
        "realistic": {"valve_dead_time": 0.0003, "supply_pressure": 0.005e6, "joint_angle": 0.001},
    }

    valve_dead_time: NonNegative = Field(0.0, description="of each valve's dead time [s]")
    supply_pressure: NonNegative = Field(0.0, description="of the filled tanks [Pa]")


@dataclass(frozen=True)
class AirDisturbance:
    """What is different in this trial.

    Attributes:
        valve_dead_time: Added to each valve's dead time [s], shape (V,).
        supply_pressure: Added to the pressure of the filled tanks [Pa].
    """

    valve_dead_time: Array
    supply_pressure: float


class AirConfig(ActuatorsConfig):
    """Tubes, valves and tanks; pressures are gauge pressures [Pa] unless they say absolute.

    A subclass says which cylinders there are; `PneumaticsConfig` takes them from the config.
    """

    supply_pressure: Positive = Field(description="pressure of the filled tanks [Pa]")
    tank_volume: Positive = Field(description="of all tanks together [m³]")
    tube_diameter: Positive = Field(0.004, description="inner diameter of the tubes [m]")
    tube_length: Annotated[Positive, Searched(0.15, 1.5)] = Field(0.5, description="valve to chamber [m]")
    critical_ratio: Fraction = Field(0.3, description="b of ISO 6358 for valves and tubes [-], assumed: typical")
    supply_conductance: Annotated[Positive, Searched(2e-09, 5e-07)] = Field(
        description="sonic conductance of a valve from tank to tube [m³/(s·Pa)]"
    )
    exhaust_conductance: Annotated[Positive, Searched(5e-09, 3e-06)] = Field(
        description="sonic conductance of a valve to the air [m³/(s·Pa)]"
    )
    full_opening_error: Annotated[Positive, Searched(5000, 100000)] = Field(
        0.3e5, description="pressure error that opens a valve fully [Pa], assumed"
    )
    valve_time_constant: Annotated[Positive, Searched(0.002, 0.05)] = Field(
        0.015, description="first-order lag of the opening [s], assumed"
    )
    valve_dead_time: Annotated[NonNegative, Searched(0.001, 0.03)] = Field(
        0.010, description="delay of the command [s], assumed"
    )
    dead_volume: Annotated[Positive, Searched(5e-07, 8e-05)] = Field(
        15e-6, description="of a chamber at the end of its stroke [m³], assumed"
    )
    manifold_volume: Positive = Field(4e-6, description="behind each valve [m³], assumed")
    heat_in: Positive = Field(1.4, description="exponent of gas flowing in [-], Richer & Hurmuzlu 2000: adiabatic")
    heat_out: Positive = Field(1.0, description="exponent of gas flowing out [-], Richer & Hurmuzlu 2000: isothermal")
    heat_volume: Positive = Field(1.2, description="polytropic exponent of the moving piston [-], ibid.")
    temperature: Positive = Field(293.15, description="of the gas [K], assumed: room")
    friction_smoothing: Positive = Field(0.5, description="speed over which dry friction builds up [rad/s], numerical")
    laminar_ratio: Fraction = Field(0.995, description="pressure ratio above which flow is linear [-], numerical")
    rest_pressure: Annotated[tuple[NonNegative, ...], Field(min_length=1), Searched(0.0, 1e5, "linear")] = Field(
        description="of each valve before the onset [Pa]"
    )
    valve_names: tuple[str, ...] = Field((), description="what each valve does, for people")
    pressure_noise: NonNegative = Field(1.0e3, description="sd of a pressure sensor [Pa], assumed: 0.1 % of full scale")
    max_substep: Annotated[float, Field(gt=0, le=1e-4)] = Field(1e-4, description="longest integration step [s]")

    @model_validator(mode="after")
    def _valves_can_be_integrated_and_named(self) -> Self:
        if self.valve_time_constant < self.max_substep:
            raise ValueError(
                f"valve_time_constant {self.valve_time_constant:g} s cannot be integrated in substeps of "
                f"{self.max_substep:g} s; give at least that much, or a smaller max_substep"
            )
        valves = len(self.rest_pressure)
        if self.valve_names and len(self.valve_names) != valves:
            raise ValueError(f"valve_names has {len(self.valve_names)} names, rest_pressure {valves} valves")
        if max(self.rest_pressure) > self.supply_pressure:
            raise ValueError(f"rest_pressure {max(self.rest_pressure):g} Pa is above supply_pressure")
        return self

    def cylinders_of_joints(self) -> tuple[Cylinder, ...]:
        """Return the cylinder of each joint, in the order of the joints."""
        raise NotImplementedError

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The valves."""
        names = self.valve_names or ("",) * len(self.rest_pressure)
        return tuple(
            Channel(f"valve {number}" + (f": {name}" if name else ""), "Pa", 0.0, self.supply_pressure, rest=rest)
            for number, (name, rest) in enumerate(zip(names, self.rest_pressure, strict=True), start=1)
        )

    @property
    def sensor_noise(self) -> float:
        """Standard deviation of a pressure sensor [Pa]."""
        return self.pressure_noise

    def settled_torque(self, target: Array, joint_angle: Array) -> Array:
        """Return (p_up - p_down) A r of each joint [N·m], shape (J,): settled chambers have their valves' pressures."""
        cylinders = self.cylinders_of_joints()
        pressure = [target[cylinder.up - 1] - target[cylinder.down - 1] for cylinder in cylinders]
        lever = [0.25 * math.pi * cylinder.bore**2 * cylinder.lever for cylinder in cylinders]
        return np.asarray(np.array(pressure) * np.array(lever))

    def checks(self, joint_limits: Array) -> Sequence[Check]:
        """Return the scenes of `checks.py`: flows, chambers, valves and tanks in closed form."""
        from imolo_backends.actuators.checks import PneumaticDrive, pneumatic_checks

        return pneumatic_checks(PneumaticDrive(self, joint_limits))

    def draw(self, disturbance: DisturbanceConfig, rng: np.random.Generator) -> AirDisturbance:
        """Draw what is different in a trial."""
        scale = disturbance if isinstance(disturbance, PneumaticDisturbance) else PneumaticDisturbance(profile="none")
        dead_time = rng.normal(0.0, 1.0, len(self.rest_pressure)) * scale.valve_dead_time
        return AirDisturbance(dead_time, float(rng.normal() * scale.supply_pressure))

    def create(self, joint_limits: Array, joint_angle: Array, timestep: float, drawn: Any = None) -> Actuators:
        """Fill the tanks of one trial and bring every chamber to its rest pressure."""
        return Pneumatics(self, timestep, joint_limits, joint_angle, drawn)


class PneumaticsConfig(AirConfig):
    """Air whose cylinders and valve map are written in the config."""

    cylinders: Annotated[tuple[Cylinder, ...], Field(min_length=1)] = Field(description="one per joint, in their order")

    @model_validator(mode="after")
    def _every_valve_feeds_a_chamber(self) -> Self:
        check_valve_map(self.cylinders, len(self.rest_pressure))
        return self

    def cylinders_of_joints(self) -> tuple[Cylinder, ...]:
        """Return the cylinder of each joint, in the order of the joints."""
        return self.cylinders


class PneumaticSimulation(SimulationConfig):
    """What surrounds a pneumatic robot."""

    actuators: PneumaticsConfig
    disturbance: PneumaticDisturbance = PneumaticDisturbance()


class PneumaticExperiment(ExperimentConfig):
    """An experiment with a pneumatic robot whose cylinders and valve map are in its config."""

    motion: PhasedMotion
    simulation: PneumaticSimulation


def check_valve_map(cylinders: Sequence[Cylinder], valves: int) -> None:
    """Raise `ValueError` unless the cylinders' valves are 1 to `valves`, each feeding a chamber."""
    fed = {valve for cylinder in cylinders for valve in (cylinder.up, cylinder.down)}
    if beyond := sorted(fed - set(range(1, valves + 1))):
        raise ValueError(
            f"a cylinder names valve {beyond[0]}, but rest_pressure has {valves} valves; give it a pressure"
        )
    if idle := sorted(set(range(1, valves + 1)) - fed):
        raise ValueError(f"valve {idle[0]} feeds no chamber; name it in `up` or `down` of a cylinder, or leave it out")


def valves_of_chambers(cylinders: Sequence[Cylinder]) -> NDArray[np.int64]:
    """Return the valve of each chamber, from 0, shape (2 J,): those that drive the joints up, then those down."""
    return np.array([one.up for one in cylinders] + [one.down for one in cylinders], dtype=np.int64) - 1


def tube_conductance(diameter: float, length: float) -> float:
    """Return the sonic conductance of a plastic tube [m³/(s·Pa)] from its inner diameter and length [m].

    The empirical formula of ISO 6358-3 in SI units.
    """
    return 0.029 * diameter**2 / math.sqrt(length / diameter**1.25 + 510.0)


class Pneumatics:
    """Air, valves and cylinders of one trial."""

    def __init__(
        self,
        config: AirConfig,
        timestep: float,
        joint_limits: Array,
        joint_angle: Array,
        disturbance: AirDisturbance | None = None,
    ) -> None:
        """Fill the tanks and bring every chamber to its rest pressure.

        Args:
            config: Parameters.
            timestep: Of the engine [s]; split into substeps of at most `max_substep`.
            joint_limits: Lowest and highest angle of each joint [rad], shape (J, 2); the ends of the pistons' strokes.
            joint_angle: At the start [rad], shape (J,).
            disturbance: Of this trial; None for an undisturbed one.

        Raises:
            ConfigError: There is not one cylinder for each joint, or a joint has no limits.
        """
        cylinders = config.cylinders_of_joints()
        joints, valves = len(cylinders), len(config.rest_pressure)
        if len(joint_limits) != joints:
            raise ConfigError(f"there are {joints} cylinders for {len(joint_limits)} joints; give one for each")
        if not np.isfinite(joint_limits).all():
            raise ConfigError("a joint without limits has no cylinder that fits; give its URDF joint a <limit>")
        changes = disturbance or AirDisturbance(np.zeros(valves), 0.0)
        substeps = max(1, math.ceil(timestep / config.max_substep - 1e-9))
        valve_of = valves_of_chambers(cylinders)
        self._parameters = _parameters(config, cylinders, valve_of, timestep / substeps, joint_limits)
        dead_time = np.maximum(config.valve_dead_time + changes.valve_dead_time, 0.0)
        dead_steps = np.rint(dead_time * substeps / timestep).astype(np.int64)
        rest = np.array(config.rest_pressure)
        self._counters = np.concatenate(([substeps, 0, joints, valves], dead_steps, valve_of)).astype(np.int64)
        self._delayed = np.tile(rest, (int(dead_steps.max()) + 1, 1))
        self._joints, self._tank = joints, 2 * joints + valves
        supply = config.supply_pressure + changes.supply_pressure + ATMOSPHERE
        self._state = np.concatenate(
            (
                rest[valve_of] + ATMOSPHERE,
                rest + ATMOSPHERE,
                [supply],
                np.zeros(valves),
                self._volumes(cylinders, joint_limits, joint_angle),
            )
        )
        self._behind_valves = self._state[2 * joints : self._tank]
        self._port = np.zeros(valves + joints)
        self.target = self._port[:valves]
        self.joint_torque = self._port[valves:]
        self.target[:] = rest
        self._air = self._parameters, self._state, self._delayed, self._counters, self._port

    def step(self, joint_angle: Array, joint_velocity: Array) -> None:
        """Advance the air by one engine step under `target`, then set `joint_torque`."""
        k.advance(*self._air, joint_angle, joint_velocity)

    def compiled_step(self, joint_angle: Array, joint_velocity: Array) -> CFunction:
        """Return what does the same as `step` with these two arrays."""
        return c_function(k.advance, *self._air, joint_angle, joint_velocity)

    def measured(self) -> Array:
        """Return the gauge pressure behind each valve [Pa], shape (V,)."""
        return self._behind_valves - ATMOSPHERE

    @property
    def chamber_pressure(self) -> Array:
        """Gauge pressure of each chamber [Pa], shape (2, J): driving the joint angles up, and down."""
        return (self._state[: 2 * self._joints] - ATMOSPHERE).reshape(2, self._joints)

    @property
    def tank_pressure(self) -> float:
        """Gauge pressure of the tanks [Pa]."""
        return float(self._state[self._tank]) - ATMOSPHERE

    def _volumes(self, cylinders: Sequence[Cylinder], joint_limits: Array, joint_angle: Array) -> Array:
        bore, lever = np.array([(cylinder.bore, cylinder.lever) for cylinder in cylinders]).T
        swept_by_angle = 0.25 * math.pi * bore**2 * lever
        up = np.maximum(joint_angle - joint_limits[:, 0], 0.0)
        down = np.maximum(joint_limits[:, 1] - joint_angle, 0.0)
        swept = np.concatenate((swept_by_angle * up, swept_by_angle * down))
        return np.asarray(self._parameters[-2 * self._joints :] + swept)


def _parameters(
    config: AirConfig, cylinders: Sequence[Cylinder], valve_of: NDArray[np.int64], substep: float, joint_limits: Array
) -> Array:
    half_tube = 0.25 * math.pi * config.tube_diameter**2 * config.tube_length / 2
    density = REFERENCE_DENSITY * math.sqrt(REFERENCE_TEMPERATURE / config.temperature)
    scalars = np.zeros(k.SCALARS)
    scalars[k.SUPPLY_FLOW] = density * config.supply_conductance
    scalars[k.EXHAUST_FLOW] = density * config.exhaust_conductance
    scalars[k.TUBE_FLOW] = density * tube_conductance(config.tube_diameter, config.tube_length)
    scalars[k.CRITICAL_RATIO] = config.critical_ratio
    scalars[k.LAMINAR_RATIO] = config.laminar_ratio
    scalars[k.FULL_OPENING_ERROR] = config.full_opening_error
    scalars[k.VALVE_TIME_CONSTANT] = config.valve_time_constant
    scalars[k.HEAT_IN] = config.heat_in
    scalars[k.HEAT_OUT] = config.heat_out
    scalars[k.HEAT_VOLUME] = config.heat_volume
    scalars[k.GAS_ENERGY] = GAS_CONSTANT * config.temperature
    scalars[k.ATMOSPHERE] = ATMOSPHERE
    scalars[k.TANK_VOLUME] = config.tank_volume
    scalars[k.FRICTION_SMOOTHING] = config.friction_smoothing
    scalars[k.SUBSTEP] = substep
    bore = np.array([cylinder.bore for cylinder in cylinders])
    tubes = np.bincount(valve_of, minlength=len(config.rest_pressure))
    return np.concatenate(
        (
            scalars,
            0.25 * math.pi * bore**2,
            [cylinder.lever for cylinder in cylinders],
            joint_limits[:, 0],
            joint_limits[:, 1],
            [cylinder.coulomb_friction for cylinder in cylinders],
            [cylinder.viscous_friction for cylinder in cylinders],
            config.manifold_volume + half_tube * tubes,
            np.full(2 * len(cylinders), config.dead_volume + half_tube),
        )
    )
