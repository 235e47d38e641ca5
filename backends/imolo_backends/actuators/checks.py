"""Checks of a pneumatic plant against closed forms, whatever robot its config describes; they need no engine.

Reference: ISO 6358 for flows through valves and tubes, Richer & Hurmuzlu 2000 for chambers; `kappa` is a heat exponent.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imolo.conformance import Check, Measurement
from imolo.contracts.engine import Array
from imolo_backends.actuators.pneumatics import (
    ATMOSPHERE,
    GAS_CONSTANT,
    REFERENCE_DENSITY,
    REFERENCE_TEMPERATURE,
    AirConfig,
    Pneumatics,
    tube_conductance,
    valves_of_chambers,
)

SUBSTEP = 1e-4  # [s]
ROUNDING = 1e-11  # relative, of some ten thousand operations in double precision
NO_TUBE: dict[str, Any] = {"tube_diameter": 1e-9}  # [m] lets 1e-17 kg through
ISOTHERMAL: dict[str, Any] = {"heat_in": 1.0, "heat_out": 1.0, "heat_volume": 1.0}
ENDLESS_TANK: dict[str, Any] = {"tank_volume": 1e9}  # [m³]
AT_ONCE: dict[str, Any] = {"valve_dead_time": 0.0, "valve_time_constant": SUBSTEP}
SHUT: dict[str, Any] = {"full_opening_error": 1e18}  # [Pa] a valve that no error opens
KILO = 1e-3


@dataclass(frozen=True)
class PneumaticDrive:
    """What is checked.

    Attributes:
        config: The parameters; the checks change some of them.
        joint_limits: Lowest and highest angle [rad], shape (J, 2).
        make: Makes the plant from parameters, with steps of `SUBSTEP`, its joints at these angles [rad]; the one of
            `pneumatics.py` if not given.
    """

    config: AirConfig
    joint_limits: Array
    make: Callable[[AirConfig, Array], Pneumatics] | None = None

    @cached_property
    def sweep(self) -> Array:
        """Volume that the two chambers of a joint sweep [m³/rad], shape (J,)."""
        return np.array([math.pi / 4 * one.bore**2 * one.lever for one in self.config.cylinders_of_joints()])

    @cached_property
    def valve_of_chamber(self) -> NDArray[np.int64]:
        """Valve of each chamber, shape (2 J,): those that drive the joints up, then those down."""
        return valves_of_chambers(self.config.cylinders_of_joints())

    @property
    def middle(self) -> Array:
        """Joint angles in the middle of their ranges [rad], shape (J,)."""
        return np.asarray(self.joint_limits.mean(axis=1))

    @property
    def valves(self) -> int:
        """How many valves there are."""
        return len(self.config.rest_pressure)

    @property
    def empty(self) -> dict[str, Any]:
        """The parameters that let all valves rest at the atmosphere's pressure."""
        return {"rest_pressure": (0.0,) * self.valves}

    def air(self, **changes: Any) -> "Air":
        """Make a plant with some parameters changed."""
        return Air(self, self.config.model_validate({**self.config.model_dump(), **changes}))


class Air:
    """A plant whose joints are led."""

    def __init__(self, drive: PneumaticDrive, config: AirConfig) -> None:
        self.config = config
        self.drive = drive
        make = drive.make or (lambda config, angle: Pneumatics(config, SUBSTEP, drive.joint_limits, angle))
        self.plant = make(config, drive.middle)
        self._still = np.zeros(len(drive.sweep))

    def hold(self, duration: float, angle: Array | None = None) -> None:
        """Hold the joints [rad], in the middle of their ranges by default, for a duration [s]."""
        angle = self.drive.middle if angle is None else angle
        for _ in range(round(duration / SUBSTEP)):
            self.plant.step(angle, self._still)

    def volumes(self, angle: Array | None = None) -> tuple[Array, Array]:
        """Return the volumes of the chambers, shape (2, J), and behind the valves, shape (V,) [m³]."""
        config, limits = self.config, self.drive.joint_limits
        angle = self.drive.middle if angle is None else angle
        half_tube = math.pi / 4 * config.tube_diameter**2 * config.tube_length / 2
        stroke = self.drive.sweep * np.array([angle - limits[:, 0], limits[:, 1] - angle])
        tubes = np.bincount(self.drive.valve_of_chamber, minlength=self.drive.valves)
        return config.dead_volume + half_tube + stroke, np.asarray(config.manifold_volume + half_tube * tubes)

    def mass_in_robot(self, angle: Array | None = None) -> float:
        """Return the air in chambers, tubes and manifolds [g]."""
        chambers, manifolds = self.volumes(angle)
        energy = ((self.plant.chamber_pressure + ATMOSPHERE) * chambers).sum()
        energy += ((self.plant.measured() + ATMOSPHERE) * manifolds).sum()
        return float(energy) / self.gas_energy / KILO

    def mass_in_tanks(self) -> float:
        """Return the air in the tanks [g]."""
        return (self.plant.tank_pressure + ATMOSPHERE) * self.config.tank_volume / self.gas_energy / KILO

    def volumes_of_valves(self) -> Array:
        """Return the volume that each valve feeds [m³], shape (V,)."""
        chambers, manifolds = self.volumes()
        return np.asarray(np.bincount(self.drive.valve_of_chamber, chambers.ravel(), self.drive.valves) + manifolds)

    def decay(self) -> Array:
        """Return K of the last of emptying [1/(Pa·s)], shape (V,).

        Opening and laminar flow both fall with the error e, so that de/dt = -K e², all isothermal.
        """
        laminar = self.laminar(self.config.exhaust_conductance)
        return self.gas_energy * laminar / (self.config.full_opening_error * self.volumes_of_valves())

    def tube_lag(self) -> Array:
        """Return how late the last of emptying is for the tubes [s], shape (V,).

        Behind a laminar tube g a chamber of volume V_c is late by t_c = V_c / (R T g), so that its pressure is
        e + t_c K e², and (1 + 2 K e sum(t_c V_c / V)) de/dt = -K e².
        """
        tube = self.laminar(tube_conductance(self.config.tube_diameter, self.config.tube_length))  # [kg/(s·Pa)]
        chambers, _ = self.volumes()
        weighed = np.bincount(self.drive.valve_of_chamber, chambers.ravel() ** 2, self.drive.valves)
        return np.asarray(2.0 * weighed / (self.gas_energy * tube * self.volumes_of_valves()))

    def laminar(self, conductance: float) -> float:
        """Return the mass flow per difference of pressure [kg/(s·Pa)] through a conductance where it is laminar."""
        config = self.config
        x = (config.laminar_ratio - config.critical_ratio) / (1.0 - config.critical_ratio)
        return conductance * self.density * math.sqrt(1.0 - x**2) / (1.0 - config.laminar_ratio)

    @property
    def gas_energy(self) -> float:
        """R T [J/kg]."""
        return GAS_CONSTANT * self.config.temperature

    @property
    def density(self) -> float:
        """What turns a conductance [m³/(s·Pa)] into a mass flow, at the temperature of the gas [kg/m³], ISO 6358."""
        return REFERENCE_DENSITY * math.sqrt(REFERENCE_TEMPERATURE / self.config.temperature)

    def filled(self, opened: float, ratio: float) -> float:
        """Return the manifold that a valve, open for so long [s], fills to this share of its choked range [m³]."""
        flow = self.config.supply_conductance * self.density * (self.config.supply_pressure + ATMOSPHERE)
        reach = ratio * (self.config.critical_ratio * (self.config.supply_pressure + ATMOSPHERE) - ATMOSPHERE)
        return self.config.heat_in * self.gas_energy * flow * opened / reach


def sealed_piston(drive: PneumaticDrive) -> Iterator[Measurement]:
    """A piston squeezes and widens a sealed chamber."""
    start = 0.2 * drive.config.supply_pressure  # [Pa] gauge
    for kappa, law in ((1.0, "isothermal"), (1.2, "polytropic"), (1.4, "adiabatic")):
        air = drive.air(**NO_TUBE, rest_pressure=(start,) * drive.valves, heat_volume=kappa)
        before, _ = air.volumes()
        for share in (0.1, 0.9, 0.35, 0.0, 1.0, 0.2):
            angle = drive.joint_limits[:, 0] + share * np.ptp(drive.joint_limits, axis=1)
            air.hold(SUBSTEP, angle)
        after, _ = air.volumes(angle)
        truth = (start + ATMOSPHERE) * (before / after) ** kappa - ATMOSPHERE
        off = float(np.abs(air.plant.chamber_pressure - truth).max())
        rounding = KILO * ROUNDING * float(truth.max() + ATMOSPHERE) + 1e-7
        basis = "p V^kappa whatever the way; rounding, and 1e-17 kg through the tube"
        yield Measurement(f"{law} pressure, worst chamber", "kPa", 0.0, KILO * off, rounding, basis)


def choked_filling(drive: PneumaticDrive) -> Iterator[Measurement]:
    """A tank fills a volume through a choked valve."""
    duration = 0.15
    volume = drive.air().filled(duration, 0.8)
    air = drive.air(**NO_TUBE, **AT_ONCE, **ENDLESS_TANK, **drive.empty, manifold_volume=volume)
    tank = air.plant.tank_pressure + ATMOSPHERE
    air.plant.target[0] = air.config.supply_pressure
    samples = []
    for _ in range(3):
        air.hold(duration / 3)
        samples.append(float(air.plant.measured()[0]))
    # dp/dt = kappa R T C rho p_tank / V while p < b p_tank; Euler's steps are exact.
    flow = air.config.supply_conductance * air.density * tank  # [kg/s]
    truth = air.config.heat_in * air.gas_energy * flow / volume * duration
    basis = "linear while p < b p_tank, Euler is exact; the tank loses 1e-12 of its air"
    yield Measurement("pressure", "kPa", KILO * truth, KILO * samples[2], 1e-9 * KILO * truth, basis)
    yield Measurement(
        "pressure at a third of the time", "kPa", KILO * truth / 3, KILO * samples[0], 1e-9 * KILO * truth, basis
    )


def closed_valves(drive: PneumaticDrive) -> Iterator[Measurement]:
    """Pistons push the air to and fro behind shut valves."""
    air = drive.air(**SHUT, **ISOTHERMAL, rest_pressure=(0.2 * drive.config.supply_pressure,) * drive.valves)
    robot, tanks = air.mass_in_robot(), air.mass_in_tanks()
    for step in range(2000):
        angle = drive.middle + 0.4 * math.sin(2.0 * math.pi * step / 500) * np.ptp(drive.joint_limits, axis=1)
        air.hold(SUBSTEP, angle)
    basis = "m = p V / (R T), all isothermal; rounding, and valves open by 1e-13"
    yield Measurement("air in the robot", "g", robot, air.mass_in_robot(angle), 1e-8 * robot, basis)
    yield Measurement("air in the tanks", "g", tanks, air.mass_in_tanks(), 1e-8 * tanks, basis)


def tank_balance(drive: PneumaticDrive) -> Iterator[Measurement]:
    """The tanks fill the robot, which then is emptied to the air."""
    air = drive.air(**ISOTHERMAL)
    tanks, robot = air.mass_in_tanks(), air.mass_in_robot()
    air.plant.target[:] = air.config.supply_pressure  # never reached, so that nothing is let out
    air.hold(0.2)
    lost, gained = tanks - air.mass_in_tanks(), air.mass_in_robot() - robot
    rounding = ROUNDING * (tanks + robot)
    yield Measurement("air from the tanks in the robot", "g", lost, gained, rounding, "m = p V / (R T), rounding")
    air.plant.target[:] = 0.0
    # The lag lets the tanks feed on until the openings have passed zero, which takes a few of its time constants.
    air.hold(0.1)
    closed, venting = air.mass_in_tanks(), 2.0
    air.hold(venting)
    yield Measurement("air in the tanks while venting", "g", closed, air.mass_in_tanks(), 0.0, "shut off, to the bit")
    # Twice what the last, hyperbolic part alone would leave in that time: the first half gets it there.
    volumes, decay = air.volumes_of_valves(), air.decay()
    left = float((volumes / (decay * 0.5 * venting)).sum()) / air.gas_energy / KILO
    still = ATMOSPHERE * float(volumes.sum()) / air.gas_energy / KILO
    basis = "the atmosphere's, and e < 1 / (K t) more"
    yield Measurement("air that stays in the robot", "g", still, air.mass_in_robot(), left, basis)


def commanded_pressure(drive: PneumaticDrive) -> Iterator[Measurement]:
    """Every valve is commanded a pressure of its own."""
    target = drive.config.supply_pressure * np.linspace(0.6, 0.1, drive.valves)
    air = drive.air(tank_volume=1.0)
    air.plant.target[:] = target
    air.hold(2.0)
    # Near the target the slowest valve, which feeds most, closes in on it exponentially, and its tank is choked.
    config = air.config
    rate = air.gas_energy * config.supply_conductance * air.density * config.supply_pressure
    rate /= air.volumes_of_valves().max() * config.full_opening_error  # [1/s]
    left = KILO * (config.full_opening_error * math.exp(-rate) + ROUNDING * config.supply_pressure)
    basis = "a valve without a leak has no offset; what is left after half of the two seconds, rounding"
    off = float(np.abs(air.plant.measured() - target).max())
    yield Measurement("pressure of the worst valve", "kPa", 0.0, KILO * off, left, basis)
    off = float(np.abs(air.plant.chamber_pressure.ravel() - target[drive.valve_of_chamber]).max())
    yield Measurement("pressure in the worst chamber", "kPa", 0.0, KILO * off, left, basis)


def resting(drive: PneumaticDrive) -> Iterator[Measurement]:
    """Nothing is commanded."""
    air = drive.air()
    before = air.plant.chamber_pressure, air.plant.measured()
    air.hold(0.5)
    after = air.plant.chamber_pressure, air.plant.measured()
    drift = max(float(np.abs(a - b).max()) for a, b in zip(before, after, strict=True))
    yield Measurement("change of pressure", "Pa", 0.0, drift, 0.0, "the rest is an equilibrium to the bit")


def valve_step(drive: PneumaticDrive) -> Iterator[Measurement]:
    """A valve is opened fully, and fills a volume so large that the flow is choked throughout."""
    steps = round((drive.config.valve_dead_time + 20.0 * drive.config.valve_time_constant) / SUBSTEP)
    volume = drive.air().filled(steps * SUBSTEP, 0.8)
    air = drive.air(**NO_TUBE, **ENDLESS_TANK, **drive.empty, manifold_volume=volume)
    config = air.config
    flow = config.supply_conductance * air.density * (air.plant.tank_pressure + ATMOSPHERE)  # [kg/s]
    slope = config.heat_in * air.gas_energy * flow / volume  # [Pa/s] when it is open
    air.plant.target[0] = config.supply_pressure
    pressure = [float(air.plant.measured()[0])]
    for _ in range(steps):
        air.hold(SUBSTEP)
        pressure.append(float(air.plant.measured()[0]))
    opening = np.diff(pressure) / (slope * SUBSTEP)
    first = int(np.flatnonzero(opening)[0])
    tau, dead = config.valve_time_constant, config.valve_dead_time
    yield Measurement("dead time", "ms", dead / KILO, first * SUBSTEP / KILO, 1e-9, "whole substeps")
    lags = round(tau / SUBSTEP)
    q = 1.0 - SUBSTEP / tau
    basis = "first-order lag with its Euler bias, 1 - (1 - h/tau)^n; rounding of p / (S h)"
    for count in (1, 3):
        measured = float(opening[first + count * lags - 1])
        yield Measurement(f"opening after {count} tau", "", 1.0 - q ** (count * lags), measured, 1e-7, basis)
    left = len(opening) - first
    delay = left * SUBSTEP - (pressure[-1] - pressure[0]) / slope
    # The area above the opening: sum of h q^n = tau - h, and q^n that is still to come.
    bias = -SUBSTEP + tau * q**left
    yield Measurement(
        "lag (area above the step response)",
        "ms",
        (tau + bias) / KILO,
        delay / KILO,
        1e-6,
        "tau - h, Euler's; rounding of p / S",
    )


def emptying(drive: PneumaticDrive) -> Iterator[Measurement]:
    """Air is let out, choked at first and laminar in the end."""
    start, duration = 0.9 * drive.config.supply_pressure, 0.3
    # Halfway, as the logarithm goes, to where it is choked no more.
    rate = 0.5 * math.log((start + ATMOSPHERE) * drive.config.critical_ratio / ATMOSPHERE) / duration  # [1/s]
    one = drive.air()
    volume = one.gas_energy * one.config.exhaust_conductance * one.density / rate
    off = {}
    for substep in (SUBSTEP, SUBSTEP / 2):
        at_once: dict[str, Any] = {"max_substep": substep, "valve_time_constant": substep, "valve_dead_time": 0.0}
        air = drive.air(**NO_TUBE, **at_once, manifold_volume=volume, rest_pressure=(start,) * drive.valves)
        air.plant.target[0] = 0.0
        air.hold(duration)
        # dp/dt = -R T C rho p / V while p > p_air / b, isothermal; Euler leaves (1 - h rate)^n of it.
        pressure = KILO * (float(air.plant.measured()[0]) + ATMOSPHERE)
        full = KILO * (start + ATMOSPHERE)
        off[substep] = pressure - full * math.exp(-rate * duration)
        truth = full * (1.0 - rate * substep) ** round(duration / substep)
    basis = "exponential with its Euler bias, rounding"
    yield Measurement("absolute pressure while choked", "kPa", truth, pressure, 1e-9 * truth, basis)
    order = math.log2(off[SUBSTEP] / off[SUBSTEP / 2])
    yield Measurement(
        "order of convergence", "", 1.0, order, 2.0 * rate * SUBSTEP, "Euler; second order is h rate of it"
    )
    air = drive.air(**ISOTHERMAL)
    air.plant.target[:] = 0.0
    air.plant.target[:-1] = 0.4 * air.config.supply_pressure
    air.hold(0.2)
    air.plant.target[:] = 0.0
    begin, duration = 2.0, 2.0
    air.hold(begin)
    before = air.plant.measured()
    air.hold(duration)
    after = air.plant.measured()
    # de/dt = -K e² makes 1/e grow by K t. The valve's opening is late by its lag tau, which adds K tau ln(t2/t1), and
    # the chambers are late by their tubes, which takes away as much for theirs; e falls as 1/t.
    decay, tau, tubes = air.decay(), air.config.valve_time_constant, air.tube_lag()
    for valve in (0, drive.valves - 1):
        late = (tau - tubes[valve]) * math.log(before[valve] / after[valve])
        measured = float(1.0 / after[valve] - 1.0 / before[valve]) / duration / KILO
        truth = float(decay[valve]) * (1.0 + late / duration) / KILO
        second = (tau + tubes[valve]) ** 2 / begin**2 + SUBSTEP / begin
        basis = "hyperbolic decay, late by valve and tubes; the second order of that, and a step"
        yield Measurement(f"decay constant of valve {valve + 1}", "1/(kPa s)", truth, measured, second * truth, basis)


SCENES = (
    resting,
    sealed_piston,
    choked_filling,
    closed_valves,
    tank_balance,
    commanded_pressure,
    valve_step,
    emptying,
)


def pneumatic_checks(drive: PneumaticDrive) -> tuple[Check, ...]:
    """Return the checks of a pneumatic plant, for `run_check` or a backend's plugin."""
    return tuple(
        Check(scene.__name__, "air", (scene.__doc__ or "").splitlines()[0].rstrip("."), partial(scene, drive))
        for scene in SCENES
    )
