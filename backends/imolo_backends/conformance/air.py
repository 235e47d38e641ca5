"""Pneumatics and drag: the plant that every simulated backend shares; the drag flies through the engine.

Reference: ISO 6358 for flows through valves and tubes, Richer & Hurmuzlu 2000 for chambers; `kappa` is a heat exponent.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from imolo.config.simulation import BallConfig, PneumaticsConfig
from imolo.conformance import Measurement
from imolo.contracts.engine import Array, EngineState, Scene
from imolo_backends.actuators.plant import ATMOSPHERE, GAS_CONSTANT, REFERENCE_DENSITY, Plant
from imolo_backends.actuators.plant_kernel import CHAMBERS, JOINTS, VALVE_OF_CHAMBER, VALVES
from imolo_backends.conformance.bodies import ASIDE, GRAVITY, WEIGHTLESS, ball_scene
from imolo_backends.conformance.subject import SceneCheck, Subject, at_timestep, observed_order
from imolo_robots.liberobot.body import JOINT_LIMITS, READY_JOINT_ANGLE, foam_ball

SUBSTEP = 1e-4  # [s]
MIDDLE = JOINT_LIMITS.mean(axis=1)
READY = np.array(READY_JOINT_ANGLE)
BALL = BallConfig()
ROUNDING = 1e-11  # relative, of some ten thousand operations in double precision
NO_TUBE: dict[str, Any] = {"tube_diameter": 1e-9}  # [m] lets 1e-17 kg through
ISOTHERMAL: dict[str, Any] = {"heat_in": 1.0, "heat_out": 1.0, "heat_volume": 1.0}
ENDLESS_TANK: dict[str, Any] = {"tank_volume": 1e9}  # [m³]
AT_ONCE: dict[str, Any] = {"valve_dead_time": 0.0, "valve_time_constant": SUBSTEP}
SHUT: dict[str, Any] = {"full_opening_error": 1e15}  # [Pa] a valve that no error opens
KILO = 1e-3


class Air:
    """A plant whose joints are led and whose ball is far away."""

    def __init__(self, angle: Array = MIDDLE, **values: Any) -> None:
        self.config = PneumaticsConfig(**values)
        self.plant = Plant(self.config, BALL, SUBSTEP, JOINT_LIMITS, angle)
        self._still = np.zeros(JOINTS)
        self._calm = np.zeros(3)

    def hold(self, duration: float, angle: Array = MIDDLE) -> None:
        """Hold the joints [rad] for a duration [s]."""
        for _ in range(round(duration / SUBSTEP)):
            self.plant.step(angle, self._still, self._calm)

    def volumes(self, angle: Array = MIDDLE) -> tuple[Array, Array]:
        """Return the volumes of the chambers, shape (2, 8), and behind the valves, shape (8,) [m³] (Sec. V-A)."""
        config = self.config
        half_tube = math.pi / 4 * config.tube_diameter**2 * config.tube_length / 2
        bore = np.array([config.leg_bore] * 6 + [config.arm_bore] * 2)
        lever = config.moment_arm * np.array([config.leg_reduction] * 6 + [1.0] * 2)
        stroke = lever * np.array([angle - JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1] - angle])
        chambers = config.dead_volume + half_tube + math.pi / 4 * bore**2 * stroke
        tubes = np.bincount(VALVE_OF_CHAMBER, minlength=VALVES)
        return np.asarray(chambers), np.asarray(config.manifold_volume + half_tube * tubes)

    def mass_in_robot(self, angle: Array = MIDDLE) -> float:
        """Return the air in chambers, tubes and manifolds [g]."""
        chambers, manifolds = self.volumes(angle)
        energy = ((self.plant.chamber_pressure + ATMOSPHERE) * chambers).sum()
        energy += ((self.plant.valve_pressure + ATMOSPHERE) * manifolds).sum()
        return float(energy) / self.gas_energy / KILO

    def mass_in_tanks(self) -> float:
        """Return the air in the tanks [g]."""
        return (self.plant.tank_pressure + ATMOSPHERE) * self.config.tank_volume / self.gas_energy / KILO

    def volumes_of_valves(self) -> Array:
        """Return the volume that each valve feeds [m³], shape (8,)."""
        chambers, manifolds = self.volumes()
        return np.asarray(np.bincount(VALVE_OF_CHAMBER, chambers.ravel(), VALVES) + manifolds)

    def decay(self) -> Array:
        """Return K of the last of emptying [1/(Pa·s)], shape (8,).

        Opening and laminar flow both fall with the error e, so that de/dt = -K e², all isothermal.
        """
        config = self.config
        x = (config.laminar_ratio - config.critical_ratio) / (1.0 - config.critical_ratio)
        laminar = config.exhaust_conductance * REFERENCE_DENSITY * math.sqrt(1.0 - x**2) / (1.0 - config.laminar_ratio)
        return self.gas_energy * laminar / (config.full_opening_error * self.volumes_of_valves())

    @property
    def gas_energy(self) -> float:
        """R T [J/kg]."""
        return GAS_CONSTANT * self.config.temperature


def sealed_piston(subject: Subject) -> Iterator[Measurement]:
    """A piston squeezes and widens a sealed chamber."""
    start = 0.2e6  # [Pa] gauge
    for kappa, law in ((1.0, "isothermal"), (1.2, "polytropic"), (1.4, "adiabatic")):
        air = Air(**NO_TUBE, rest_pressure=(start,) * VALVES, heat_volume=kappa)
        before, _ = air.volumes()
        for share in (0.1, 0.9, 0.35, 0.0, 1.0, 0.2):
            angle = JOINT_LIMITS[:, 0] + share * np.ptp(JOINT_LIMITS, axis=1)
            air.hold(SUBSTEP, angle)
        after, _ = air.volumes(angle)
        truth = (start + ATMOSPHERE) * (before / after) ** kappa - ATMOSPHERE
        for name, joint in (("leg", 1), ("arm", 6)):
            yield Measurement(
                f"{law} pressure, {name}",
                "kPa",
                KILO * float(truth[0, joint]),
                KILO * float(air.plant.chamber_pressure[0, joint]),
                KILO * ROUNDING * float(truth[0, joint] + ATMOSPHERE) + 1e-7,
                "p V^kappa whatever the way; rounding, and 1e-17 kg through the tube",
            )


def choked_filling(subject: Subject) -> Iterator[Measurement]:
    """A tank fills a volume through a choked valve."""
    volume, duration = 1e-3, 0.15
    air = Air(**NO_TUBE, **AT_ONCE, **ENDLESS_TANK, manifold_volume=volume)
    tank = air.plant.tank_pressure + ATMOSPHERE
    air.plant.target[0] = air.config.supply_pressure
    samples = []
    for _ in range(3):
        air.hold(duration / 3)
        samples.append(float(air.plant.valve_pressure[0]))
    # dp/dt = kappa R T C rho p_tank / V while p < b p_tank; Euler's steps are exact.
    flow = air.config.supply_conductance * REFERENCE_DENSITY * tank  # [kg/s]
    truth = air.config.heat_in * air.gas_energy * flow / volume * duration
    basis = "linear while p < b p_tank, Euler is exact; the tank loses 1e-12 of its air"
    yield Measurement("pressure", "kPa", KILO * truth, KILO * samples[2], 1e-9 * KILO * truth, basis)
    yield Measurement(
        "pressure at a third of the time", "kPa", KILO * truth / 3, KILO * samples[0], 1e-9 * KILO * truth, basis
    )


def closed_valves(subject: Subject) -> Iterator[Measurement]:
    """Pistons push the air to and fro behind shut valves."""
    air = Air(**SHUT, **ISOTHERMAL, rest_pressure=(0.2e6,) * VALVES)
    robot, tanks = air.mass_in_robot(), air.mass_in_tanks()
    for step in range(2000):
        angle = MIDDLE + 0.4 * math.sin(2.0 * math.pi * step / 500) * np.ptp(JOINT_LIMITS, axis=1)
        air.hold(SUBSTEP, angle)
    basis = "m = p V / (R T), all isothermal; rounding, and valves open by 1e-10"
    yield Measurement("air in the robot", "g", robot, air.mass_in_robot(angle), 1e-8 * robot, basis)
    yield Measurement("air in the tanks", "g", tanks, air.mass_in_tanks(), 1e-8 * tanks, basis)


def tank_balance(subject: Subject) -> Iterator[Measurement]:
    """The tanks fill the robot, which then is emptied to the air."""
    air = Air(**ISOTHERMAL)
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


def commanded_pressure(subject: Subject) -> Iterator[Measurement]:
    """Every valve is commanded a pressure of its own, and then the rest pressure."""
    target = np.array([0.6e6, 0.4e6, 0.1e6, 0.6e6, 0.4e6, 0.1e6, 0.3e6, 0.05e6])
    air = Air(tank_volume=1.0)
    air.plant.target[:] = target
    air.hold(2.0)
    # Near the target the slowest valve, that of eight chambers, closes in on it exponentially, and its tank is choked.
    config = air.config
    rate = air.gas_energy * config.supply_conductance * REFERENCE_DENSITY * config.supply_pressure
    rate /= air.volumes_of_valves()[7] * config.full_opening_error  # [1/s]
    left = KILO * (config.full_opening_error * math.exp(-rate) + ROUNDING * config.supply_pressure)
    basis = "a valve without a leak has no offset; what is left after half of the two seconds, rounding"
    for valve in (0, 2, 6, 7):
        measured = KILO * float(air.plant.valve_pressure[valve])
        yield Measurement(f"pressure of valve {valve + 1}", "kPa", KILO * float(target[valve]), measured, left, basis)
    off = np.abs(air.plant.chamber_pressure.ravel() - target[VALVE_OF_CHAMBER])
    yield Measurement(f"worst of the {CHAMBERS} chambers", "kPa", 0.0, KILO * float(off.max()), left, basis)


def resting(subject: Subject) -> Iterator[Measurement]:
    """Nothing is commanded."""
    air = Air(READY)
    before = air.plant.chamber_pressure, air.plant.valve_pressure
    air.hold(0.5, READY)
    after = air.plant.chamber_pressure, air.plant.valve_pressure
    drift = max(float(np.abs(a - b).max()) for a, b in zip(before, after, strict=True))
    yield Measurement("change of pressure", "Pa", 0.0, drift, 0.0, "the rest is an equilibrium to the bit")


def valve_step(subject: Subject) -> Iterator[Measurement]:
    """A valve is opened fully, and fills a volume so large that the flow is choked throughout."""
    volume = 5e-3
    air = Air(**NO_TUBE, **ENDLESS_TANK, manifold_volume=volume)
    config = air.config
    flow = config.supply_conductance * REFERENCE_DENSITY * (air.plant.tank_pressure + ATMOSPHERE)  # [kg/s]
    slope = config.heat_in * air.gas_energy * flow / volume  # [Pa/s] when it is open
    air.plant.target[0] = config.supply_pressure
    pressure = [float(air.plant.valve_pressure[0])]
    for _ in range(3100):
        air.hold(SUBSTEP)
        pressure.append(float(air.plant.valve_pressure[0]))
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
    steps = len(opening) - first
    delay = steps * SUBSTEP - (pressure[-1] - pressure[0]) / slope
    # The area above the opening: sum of h q^n = tau - h, and q^steps that is still to come.
    bias = -SUBSTEP + tau * q**steps
    yield Measurement(
        "lag (area above the step response)",
        "ms",
        (tau + bias) / KILO,
        delay / KILO,
        1e-6,
        "tau - h, Euler's; rounding of p / S",
    )


def emptying(subject: Subject) -> Iterator[Measurement]:
    """Air is let out, choked at first and laminar in the end."""
    volume, start, duration = 1e-3, 0.8e6, 0.3
    off = {}
    for substep in (SUBSTEP, SUBSTEP / 2):
        at_once: dict[str, Any] = {"max_substep": substep, "valve_time_constant": substep, "valve_dead_time": 0.0}
        air = Air(**NO_TUBE, **at_once, manifold_volume=volume, rest_pressure=(start,) * VALVES)
        air.plant.target[0] = 0.0
        air.hold(duration)
        # dp/dt = -R T C rho p / V while p > p_air / b, isothermal; Euler leaves (1 - h rate)^n of it.
        rate = air.gas_energy * air.config.exhaust_conductance * REFERENCE_DENSITY / volume  # [1/s]
        pressure = KILO * (float(air.plant.valve_pressure[0]) + ATMOSPHERE)
        full = KILO * (start + ATMOSPHERE)
        off[substep] = pressure - full * math.exp(-rate * duration)
        truth = full * (1.0 - rate * substep) ** round(duration / substep)
    basis = "exponential with its Euler bias, rounding"
    yield Measurement("absolute pressure while choked", "kPa", truth, pressure, 1e-9 * truth, basis)
    order = observed_order(off[SUBSTEP], off[SUBSTEP / 2])
    yield Measurement(
        "order of convergence", "", 1.0, order, 2.0 * rate * SUBSTEP, "Euler; second order is h rate of it"
    )
    air = Air(**ISOTHERMAL)
    air.plant.target[:] = 0.0
    air.plant.target[:7] = 0.4e6
    air.hold(0.2)
    air.plant.target[:] = 0.0
    times = (2.0, 4.0)
    air.hold(times[0])
    before = air.plant.valve_pressure
    air.hold(times[1] - times[0])
    # de/dt = -K e² makes 1/e grow by K t; the valve's opening is late by its lag tau, which adds K tau ln(t2/t1).
    lag = air.config.valve_time_constant * math.log(times[1] / times[0])
    grown = (1.0 / air.plant.valve_pressure - 1.0 / before) / (times[1] - times[0])
    for valve in (0, 7):
        truth = float(air.decay()[valve]) * (1.0 + lag / (times[1] - times[0])) / KILO
        measured = float(grown[valve]) / KILO
        basis = "hyperbolic decay late by tau; half of that for the tubes, which are late as well"
        yield Measurement(
            f"decay constant of valve {valve + 1}", "1/(kPa s)", truth, measured, 0.25 * lag * truth, basis
        )


def ball_drag(subject: Subject) -> Iterator[Measurement]:
    """A ball falls through air, and is thrown up."""
    speed = math.sqrt(2.0 * BALL.mass * GRAVITY / (BALL.air_density * BALL.drag_coefficient * math.pi * BALL.radius**2))
    length = speed**2 / GRAVITY
    coarse, fine, duration, start = 1e-3, 5e-4, 1.0, 20.0
    falling = ball_scene(foam_ball((0.0, 0.0, start)))
    # In units of `speed` and `length`, with s the time and eps the step: du/ds = 1 - u² is tanh s. The force is held
    # for a step, so that every engine does Euler steps in u, which add eps ln(cosh s) / cosh² s. The way adds their
    # integral, and half a step's worth of speed where the position follows with the new velocity (order 1).
    ahead = 0.5 if subject.order == 1 else 0.0
    ways = {}
    for timestep in (coarse, fine):
        state = fly(subject, at_timestep(falling, timestep), duration)
        ways[timestep] = start - float(state.ball_position[2])
    s, eps = duration * GRAVITY / speed, fine * GRAVITY / speed
    ln_cosh = math.log(math.cosh(s))
    basis = "tanh with its bias of order dt; what remains is of order dt²"
    truth = speed * (math.tanh(s) + eps * ln_cosh / math.cosh(s) ** 2)
    yield Measurement("speed of fall", "m/s", truth, -float(state.ball_velocity[2]), speed * eps**2, basis)
    exact = length * ln_cosh
    bias = length * eps * (math.tanh(s) * (1.0 + ahead + ln_cosh) - s)
    yield Measurement("way of fall", "m", exact + bias, ways[fine], length * eps**2, basis)
    order = observed_order(ways[coarse] - exact, ways[fine] - exact)
    yield Measurement(
        "order of convergence", "", 1.0, order, 4.0 * eps, "a force held for a step; second order is eps of it"
    )
    up = 6.0
    thrown = ball_scene(foam_ball((0.0, 0.0, start), (0.0, 0.0, up)), timestep=fine)
    # du/ds = -(1 + u²) is tan(phi - s); the top is where s = phi, and flat, so that half a step aside does not matter.
    phi = math.atan(up / speed)
    state = fly(subject, thrown, phi * speed / GRAVITY)
    rise = length * (0.5 * math.log(1.0 + (up / speed) ** 2) + eps * (phi - (1.0 + ahead) * math.tan(phi)))
    yield Measurement("height of rise", "m", rise, float(state.ball_position[2]) - start, length * eps**2, basis)


def drag_alone(subject: Subject) -> Iterator[Measurement]:
    """A ball flies slantwise through air without weight."""
    velocity, timestep, duration = np.array([-6.0, 0.4, 3.0]), 5e-4, 1.0
    start = np.array(ASIDE)
    ball = foam_ball(ASIDE, tuple(velocity.tolist()))
    state = fly(subject, ball_scene(ball, timestep=timestep, gravity=WEIGHTLESS), duration)
    k = 0.5 * BALL.air_density * BALL.drag_coefficient * math.pi * BALL.radius**2 / BALL.mass  # [1/m]
    speed = float(np.linalg.norm(velocity))
    slower = 1.0 + k * speed * duration
    # dv/dt = -k v²; Euler's steps take h k v² ln(slower) / slower² more, and the position its integral.
    eps = k * speed * timestep
    truth = speed * (1.0 / slower - eps * math.log(slower) / slower**2)
    basis = "v / (1 + k v t) with its bias of order dt; what remains is of order dt²"
    measured = float(np.linalg.norm(state.ball_velocity))
    yield Measurement("speed", "m/s", truth, measured, speed * eps**2, basis)
    ahead = 0.5 * (1.0 / slower - 1.0) if subject.order == 1 else 0.0
    way = (math.log(slower) + eps * ((math.log(slower) + 1.0) / slower - 1.0 + ahead)) / k
    moved = state.ball_position - start
    along = velocity / speed
    yield Measurement("way", "m", way, float(moved @ along), eps**2 / k, basis)
    aside = float(np.linalg.norm(moved - (moved @ along) * along))
    yield Measurement("distance from the straight line", "m", 0.0, aside, 1e-9, "drag is along the velocity; rounding")


def fly(subject: Subject, scene: Scene, duration: float) -> EngineState:
    """Let the ball of a scene fly through the plant's air for a duration [s]."""
    plant = Plant(PneumaticsConfig(), BALL, scene.timestep, JOINT_LIMITS, READY)
    still = np.zeros(JOINTS)
    with subject.run(scene) as run:
        for _ in range(round(duration / scene.timestep)):
            plant.step(READY, still, run.engine.motion()[2])
            run.engine.step(run.no_torque, plant.ball_force)
        return run.engine.read()


SCENES: tuple[SceneCheck, ...] = (
    resting,
    sealed_piston,
    choked_filling,
    closed_valves,
    tank_balance,
    commanded_pressure,
    valve_step,
    emptying,
    ball_drag,
    drag_alone,
)
