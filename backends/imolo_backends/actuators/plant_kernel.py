"""The compiled part of the plant: one engine step of air, valves, actuators and the ball's drag.

The state is flat so that a call costs little: a few long arrays instead of many short ones. `plant.py` names the parts.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

VALVES = 8
JOINTS = 8
CHAMBERS = 16

# Parts of the state vector.
CHAMBER_PRESSURE = 0  # absolute [Pa]; 0-7 drive the joint angle up, 8-15 drive it down
MANIFOLD_PRESSURE = CHAMBER_PRESSURE + CHAMBERS  # absolute [Pa]
TANK_PRESSURE = MANIFOLD_PRESSURE + VALVES  # absolute [Pa]
OPENING = TANK_PRESSURE + 1  # -1 fully to the air, +1 fully to the tank
CHAMBER_VOLUME = OPENING + VALVES  # [m³] at the last step
STATE_SIZE = CHAMBER_VOLUME + CHAMBERS

# Parts of the input and output vector.
TARGET = 0  # gauge [Pa]
TORQUE = TARGET + VALVES  # [N·m]
BALL_FORCE = TORQUE + JOINTS  # [N]
PORT_SIZE = BALL_FORCE + 3

# Parts of the parameter vector: scalars, then one value per joint.
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
    DRAG,  # ½ rho Cd A [kg/m]
    SUBSTEP,
) = range(16)
PER_JOINT = 16
AREA = PER_JOINT  # [m²]
LEVER = AREA + JOINTS  # piston travel per joint angle [m/rad]
LOWEST_ANGLE = LEVER + JOINTS  # [rad]
HIGHEST_ANGLE = LOWEST_ANGLE + JOINTS
COULOMB = HIGHEST_ANGLE + JOINTS  # [N·m]
VISCOUS = COULOMB + JOINTS  # [N·m·s]
MANIFOLD_VOLUME = VISCOUS + JOINTS  # one per valve [m³]
DEAD_VOLUME = MANIFOLD_VOLUME + VALVES  # one per chamber, its half of the tube included [m³]
PARAMETER_SIZE = DEAD_VOLUME + CHAMBERS

# Valve that feeds each chamber (Fig. 6a). Joints: right hip, knee, ankle, left hip, knee, ankle, right and left
# shoulder. Up: bending a leg joint and raising an arm; down: extending a leg joint and lowering an arm.
VALVE_OF_CHAMBER = np.array([7, 7, 7, 7, 7, 7, 6, 6, 0, 1, 2, 3, 4, 5, 7, 7], dtype=np.int64)


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
    ball_velocity: Floats,
) -> None:
    """Advance air and valves by one engine step, then set the joint torques and the drag on the ball.

    Args:
        parameters: See the constants of this module, shape (PARAMETER_SIZE,).
        state: Changed in place, shape (STATE_SIZE,).
        delayed: Ring of past valve targets [Pa], changed in place, shape (L, 8).
        counters: Number of substeps per step, next row of the ring, and each valve's dead time in substeps, shape
            (10,).
        port: Targets in, torques and ball force out, shape (PORT_SIZE,).
        angle: Joint angles at the start of the step [rad], shape (8,).
        velocity: Joint velocities at the start of the step [rad/s], shape (8,).
        ball_velocity: [m/s], shape (3,).
    """
    critical = parameters[CRITICAL_RATIO]
    laminar = parameters[LAMINAR_RATIO]
    heat_in = parameters[HEAT_IN]
    heat_out = parameters[HEAT_OUT]
    heat_volume = parameters[HEAT_VOLUME]
    energy = parameters[GAS_ENERGY]
    atmosphere = parameters[ATMOSPHERE]
    h = parameters[SUBSTEP]
    ring = delayed.shape[0]
    raised = np.empty(VALVES)

    for substep in range(counters[0]):
        row = counters[1]
        for valve in range(VALVES):
            delayed[row, valve] = port[TARGET + valve]
        counters[1] = (row + 1) % ring

        # Valves: a proportional regulator with lag, between tank, manifold and air.
        tank = state[TANK_PRESSURE]
        drawn = 0.0
        for valve in range(VALVES):
            target = delayed[(row - counters[2 + valve]) % ring, valve]
            manifold = state[MANIFOLD_PRESSURE + valve]
            error = (target + atmosphere - manifold) / parameters[FULL_OPENING_ERROR]
            wanted = min(1.0, max(-1.0, error))
            opening = state[OPENING + valve]
            opening += (wanted - opening) * h / parameters[VALVE_TIME_CONSTANT]
            state[OPENING + valve] = opening
            if opening >= 0.0:
                flow = mass_flow(opening * parameters[SUPPLY_FLOW], tank, manifold, critical, laminar)
                drawn += flow
            else:
                flow = -mass_flow(-opening * parameters[EXHAUST_FLOW], manifold, atmosphere, critical, laminar)
            raised[valve] = exponent(flow, heat_in, heat_out) * flow

        # Chambers: what the piston does to the gas in closed form, then what flows through the tube.
        for chamber in range(CHAMBERS):
            joint = chamber % JOINTS
            moved = angle[joint] + velocity[joint] * h * substep
            if chamber < JOINTS:
                stroke = moved - parameters[LOWEST_ANGLE + joint]
            else:
                stroke = parameters[HIGHEST_ANGLE + joint] - moved
            swept = parameters[AREA + joint] * parameters[LEVER + joint] * max(stroke, 0.0)
            volume = parameters[DEAD_VOLUME + chamber] + swept
            pressure = state[CHAMBER_PRESSURE + chamber]
            before = state[CHAMBER_VOLUME + chamber]
            if volume != before:
                pressure *= (before / volume) ** heat_volume
                state[CHAMBER_VOLUME + chamber] = volume
            valve = VALVE_OF_CHAMBER[chamber]
            flow = mass_flow(parameters[TUBE_FLOW], state[MANIFOLD_PRESSURE + valve], pressure, critical, laminar)
            state[CHAMBER_PRESSURE + chamber] = (
                pressure + exponent(flow, heat_in, heat_out) * energy * flow * h / volume
            )
            raised[valve] += exponent(-flow, heat_in, heat_out) * -flow

        for valve in range(VALVES):
            state[MANIFOLD_PRESSURE + valve] += energy * raised[valve] * h / parameters[MANIFOLD_VOLUME + valve]
        state[TANK_PRESSURE] = tank - exponent(-drawn, heat_in, heat_out) * energy * drawn * h / parameters[TANK_VOLUME]

    for joint in range(JOINTS):
        difference = state[CHAMBER_PRESSURE + joint] - state[CHAMBER_PRESSURE + JOINTS + joint]
        friction = parameters[COULOMB + joint] * math.tanh(velocity[joint] / parameters[FRICTION_SMOOTHING])
        friction += parameters[VISCOUS + joint] * velocity[joint]
        port[TORQUE + joint] = difference * parameters[AREA + joint] * parameters[LEVER + joint] - friction

    speed = math.sqrt(ball_velocity[0] ** 2 + ball_velocity[1] ** 2 + ball_velocity[2] ** 2)
    for axis in range(3):
        port[BALL_FORCE + axis] = -parameters[DRAG] * speed * ball_velocity[axis]
