"""The compiled part of the pneumatics: one engine step of air, valves and cylinders.

Every joint has a cylinder with two chambers: J joints, 2 J chambers, first those that drive the angle up, V valves.
The state is flat so that a call costs little: a few long arrays instead of many short ones. `pneumatics.py` fills it.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Parts of the counters: substeps per step, next row of the ring, the numbers of joints and valves; then each valve's
# dead time in substeps and the valve that feeds each chamber.
SUBSTEPS, ROW, JOINTS, VALVES, PER_VALVE = range(5)

# Scalars of the parameter vector; then one value per joint of area, lever, lowest and highest angle, Coulomb and
# viscous friction, one per valve of the manifold's volume, one per chamber of the dead volume and half the tube.
(
    SUPPLY_FLOW,  # conductance times reference density [kg/(s·Pa)]
    EXHAUST_FLOW,
    TUBE_FLOW,
    CRITICAL_RATIO,
    LAMINAR_RATIO,
    FULL_OPENING_ERROR,
    VALVE_TIME_CONSTANT,
    HEAT_IN,
    HEAT_OUT,
    HEAT_VOLUME,
    GAS_ENERGY,  # R T [J/kg]
    ATMOSPHERE,
    TANK_VOLUME,
    FRICTION_SMOOTHING,
    SUBSTEP,
    SCALARS,
) = range(16)


@njit(cache=True)
def mass_flow(conductance: float, up: float, down: float, critical: float, laminar: float) -> float:
    """Return the mass flow between two absolute pressures [kg/s] by ISO 6358; positive from `up` to `down`.

    `conductance` is the sonic conductance times the reference density [kg/(s·Pa)]. Above the ratio `laminar` the flow
    is linear in the pressure difference, so that its slope stays finite at zero.
    """
    sign = 1.0
    if down > up:
        up, down = down, up
        sign = -1.0
    ratio = down / up
    if ratio <= critical:
        shape = 1.0
    elif ratio <= laminar:
        x = (ratio - critical) / (1.0 - critical)
        shape = math.sqrt(1.0 - x * x)
    else:
        x = (laminar - critical) / (1.0 - critical)
        shape = math.sqrt(1.0 - x * x) * (1.0 - ratio) / (1.0 - laminar)
    return sign * conductance * up * shape


@njit(cache=True)
def exponent(flow: float, heat_in: float, heat_out: float) -> float:
    """Return the heat exponent of a flow into a volume (Richer & Hurmuzlu 2000)."""
    return heat_in if flow > 0.0 else heat_out


@njit(cache=True)
def advance(
    parameters: Floats,
    state: Floats,
    delayed: Floats,
    counters: Integers,
    port: Floats,
    angle: Floats,
    velocity: Floats,
) -> None:
    """Advance air and valves by one engine step, then set the joint torques.

    Args:
        parameters: See the constants of this module.
        state: Changed in place: absolute pressures of chambers, manifolds and tank [Pa], the valves' openings (-1 fully
            to the air, +1 fully to the tank), the chambers' volumes at the last step [m³].
        delayed: Ring of past valve targets [Pa], changed in place, shape (L, V).
        counters: See the constants of this module.
        port: Gauge targets in [Pa], joint torques out [N·m], shape (V + J,).
        angle: Joint angles at the start of the step [rad], shape (J,).
        velocity: Joint velocities at the start of the step [rad/s], shape (J,).
    """
    joints, valves = counters[JOINTS], counters[VALVES]
    chambers = 2 * joints
    dead_steps, valve_of = PER_VALVE, PER_VALVE + valves
    area, lever = SCALARS, SCALARS + joints
    lowest, highest = lever + joints, lever + 2 * joints
    coulomb, viscous = highest + joints, highest + 2 * joints
    manifold_volume = viscous + joints
    dead_volume = manifold_volume + valves
    manifold_at, tank_at = chambers, chambers + valves
    opening_at = tank_at + 1
    volume_at = opening_at + valves

    critical = parameters[CRITICAL_RATIO]
    laminar = parameters[LAMINAR_RATIO]
    heat_in = parameters[HEAT_IN]
    heat_out = parameters[HEAT_OUT]
    heat_volume = parameters[HEAT_VOLUME]
    energy = parameters[GAS_ENERGY]
    atmosphere = parameters[ATMOSPHERE]
    h = parameters[SUBSTEP]
    ring = delayed.shape[0]
    raised = np.empty(valves)

    for substep in range(counters[SUBSTEPS]):
        row = counters[ROW]
        for valve in range(valves):
            delayed[row, valve] = port[valve]
        counters[ROW] = (row + 1) % ring

        # Valves: a proportional regulator with lag, between tank, manifold and air.
        tank = state[tank_at]
        drawn = 0.0
        for valve in range(valves):
            target = delayed[(row - counters[dead_steps + valve]) % ring, valve]
            manifold = state[manifold_at + valve]
            error = (target + atmosphere - manifold) / parameters[FULL_OPENING_ERROR]
            wanted = min(1.0, max(-1.0, error))
            opening = state[opening_at + valve]
            opening += (wanted - opening) * h / parameters[VALVE_TIME_CONSTANT]
            state[opening_at + valve] = opening
            if opening >= 0.0:
                flow = mass_flow(opening * parameters[SUPPLY_FLOW], tank, manifold, critical, laminar)
                drawn += flow
            else:
                flow = -mass_flow(-opening * parameters[EXHAUST_FLOW], manifold, atmosphere, critical, laminar)
            raised[valve] = exponent(flow, heat_in, heat_out) * flow

        # Chambers: what the piston does to the gas in closed form, then what flows through the tube.
        for chamber in range(chambers):
            joint = chamber % joints
            moved = angle[joint] + velocity[joint] * h * substep
            low, high = parameters[lowest + joint], parameters[highest + joint]
            stroke = moved - low if chamber < joints else high - moved
            swept = parameters[area + joint] * parameters[lever + joint] * max(stroke, 0.0)
            volume = parameters[dead_volume + chamber] + swept
            pressure = state[chamber]
            before = state[volume_at + chamber]
            if volume != before:
                pressure *= (before / volume) ** heat_volume
                state[volume_at + chamber] = volume
            valve = counters[valve_of + chamber]
            flow = mass_flow(parameters[TUBE_FLOW], state[manifold_at + valve], pressure, critical, laminar)
            state[chamber] = pressure + exponent(flow, heat_in, heat_out) * energy * flow * h / volume
            raised[valve] += exponent(-flow, heat_in, heat_out) * -flow

        for valve in range(valves):
            state[manifold_at + valve] += energy * raised[valve] * h / parameters[manifold_volume + valve]
        state[tank_at] = tank - exponent(-drawn, heat_in, heat_out) * energy * drawn * h / parameters[TANK_VOLUME]

    for joint in range(joints):
        difference = state[joint] - state[joints + joint]
        friction = parameters[coulomb + joint] * math.tanh(velocity[joint] / parameters[FRICTION_SMOOTHING])
        friction += parameters[viscous + joint] * velocity[joint]
        port[valves + joint] = difference * parameters[area + joint] * parameters[lever + joint] - friction
