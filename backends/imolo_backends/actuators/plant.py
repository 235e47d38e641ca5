"""The plant: cylinders, tubes, valves, tanks, actuator friction and the ball's drag, once for every engine."""

import math
from dataclasses import dataclass

import numpy as np

from imolo.config.simulation import BallConfig, PneumaticsConfig
from imolo.contracts.engine import Array
from imolo_backends.actuators import plant_kernel as k

ATMOSPHERE = 101_325.0  # [Pa] absolute
GAS_CONSTANT = 287.05  # of dry air [J/(kg·K)]
REFERENCE_DENSITY = 1.185  # of ISO 6358's reference air, 20 °C, 100 kPa, 65 % humidity [kg/m³]
REFERENCE_TEMPERATURE = 293.15  # [K], ISO 6358
LEG_JOINTS = 6


def tube_conductance(diameter: float, length: float) -> float:
    """Return the sonic conductance of a plastic tube [m³/(s·Pa)] from its inner diameter and length [m].

    The empirical formula of ISO 6358-3 in SI units.
    """
    return 0.029 * diameter**2 / math.sqrt(length / diameter**1.25 + 510.0)


@dataclass(frozen=True)
class PlantDisturbance:
    """What is different in this trial.

    Attributes:
        valve_dead_time: Added to each valve's dead time [s], shape (8,).
        supply_pressure: Added to the pressure of the filled tanks [Pa].
    """

    valve_dead_time: Array
    supply_pressure: float


class Plant:
    """Air, valves and actuators of one trial, and the drag on the ball.

    `step` takes what the engine's joints do and fills `joint_torque` and `ball_force`, which the engine reads.
    """

    def __init__(
        self,
        pneumatics: PneumaticsConfig,
        ball: BallConfig,
        timestep: float,
        joint_limits: Array,
        joint_angle: Array,
        disturbance: PlantDisturbance | None = None,
    ) -> None:
        """Fill the tanks and bring every chamber to its rest pressure.

        Args:
            pneumatics: Parameters.
            ball: Gives the drag.
            timestep: Of the engine [s]; split into substeps of at most `pneumatics.max_substep`.
            joint_limits: Lowest and highest angle of each joint [rad], shape (8, 2); the ends of the pistons' strokes.
            joint_angle: At the start [rad], shape (8,).
            disturbance: Of this trial; None for an undisturbed one.
        """
        changes = disturbance or PlantDisturbance(np.zeros(k.VALVES), 0.0)
        substeps = max(1, math.ceil(timestep / pneumatics.max_substep - 1e-9))
        self._parameters = _parameters(pneumatics, ball, timestep / substeps, joint_limits)
        dead_time = np.maximum(pneumatics.valve_dead_time + changes.valve_dead_time, 0.0)
        dead_steps = np.rint(dead_time * substeps / timestep).astype(np.int64)
        rest = np.array(pneumatics.rest_pressure)
        self._counters = np.concatenate(([substeps, 0], dead_steps)).astype(np.int64)
        self._delayed = np.tile(rest, (int(dead_steps.max()) + 1, 1))
        self._state = np.zeros(k.STATE_SIZE)
        self._state[k.TANK_PRESSURE] = pneumatics.supply_pressure + changes.supply_pressure + ATMOSPHERE
        self._state[k.MANIFOLD_PRESSURE : k.TANK_PRESSURE] = rest + ATMOSPHERE
        self._state[k.CHAMBER_PRESSURE : k.MANIFOLD_PRESSURE] = rest[k.VALVE_OF_CHAMBER] + ATMOSPHERE
        self._state[k.CHAMBER_VOLUME : k.STATE_SIZE] = self._volumes(joint_angle)
        self._port = np.zeros(k.PORT_SIZE)
        self.target = self._port[k.TARGET : k.TORQUE]
        self.joint_torque = self._port[k.TORQUE : k.BALL_FORCE]
        self.ball_force = self._port[k.BALL_FORCE : k.PORT_SIZE]
        self.target[:] = rest

    def step(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """Advance the air by one engine step under `target`, then set `joint_torque` and `ball_force`."""
        k.advance(
            self._parameters,
            self._state,
            self._delayed,
            self._counters,
            self._port,
            joint_angle,
            joint_velocity,
            ball_velocity,
        )

    @property
    def valve_pressure(self) -> Array:
        """Gauge pressure behind each valve [Pa], shape (8,)."""
        return self._state[k.MANIFOLD_PRESSURE : k.TANK_PRESSURE] - ATMOSPHERE

    @property
    def chamber_pressure(self) -> Array:
        """Gauge pressure of each chamber [Pa], shape (2, 8): driving the joint angles up, and down."""
        return (self._state[k.CHAMBER_PRESSURE : k.MANIFOLD_PRESSURE] - ATMOSPHERE).reshape(2, k.JOINTS)

    @property
    def tank_pressure(self) -> float:
        """Gauge pressure of the tanks [Pa]."""
        return float(self._state[k.TANK_PRESSURE]) - ATMOSPHERE

    def _volumes(self, joint_angle: Array) -> Array:
        p = self._parameters
        swept_by_angle = p[k.AREA : k.LEVER] * p[k.LEVER : k.LOWEST_ANGLE]
        up = np.maximum(joint_angle - p[k.LOWEST_ANGLE : k.HIGHEST_ANGLE], 0.0)
        down = np.maximum(p[k.HIGHEST_ANGLE : k.COULOMB] - joint_angle, 0.0)
        swept = np.concatenate((swept_by_angle * up, swept_by_angle * down))
        return np.asarray(p[k.DEAD_VOLUME : k.PARAMETER_SIZE] + swept)


def _parameters(pneumatics: PneumaticsConfig, ball: BallConfig, substep: float, joint_limits: Array) -> Array:
    def per_joint(leg: float, arm: float) -> Array:
        return np.array([leg] * LEG_JOINTS + [arm] * (k.JOINTS - LEG_JOINTS))

    half_tube = 0.25 * math.pi * pneumatics.tube_diameter**2 * pneumatics.tube_length / 2
    bore = per_joint(pneumatics.leg_bore, pneumatics.arm_bore)
    density = REFERENCE_DENSITY * math.sqrt(REFERENCE_TEMPERATURE / pneumatics.temperature)
    parameters = np.zeros(k.PARAMETER_SIZE)
    parameters[k.SUPPLY_FLOW] = density * pneumatics.supply_conductance
    parameters[k.EXHAUST_FLOW] = density * pneumatics.exhaust_conductance
    parameters[k.TUBE_FLOW] = density * tube_conductance(pneumatics.tube_diameter, pneumatics.tube_length)
    parameters[k.CRITICAL_RATIO] = pneumatics.critical_ratio
    parameters[k.LAMINAR_RATIO] = pneumatics.laminar_ratio
    parameters[k.FULL_OPENING_ERROR] = pneumatics.full_opening_error
    parameters[k.VALVE_TIME_CONSTANT] = pneumatics.valve_time_constant
    parameters[k.HEAT_IN] = pneumatics.heat_in
    parameters[k.HEAT_OUT] = pneumatics.heat_out
    parameters[k.HEAT_VOLUME] = pneumatics.heat_volume
    parameters[k.GAS_ENERGY] = GAS_CONSTANT * pneumatics.temperature
    parameters[k.ATMOSPHERE] = ATMOSPHERE
    parameters[k.TANK_VOLUME] = pneumatics.tank_volume
    parameters[k.FRICTION_SMOOTHING] = pneumatics.friction_smoothing
    parameters[k.DRAG] = 0.5 * ball.air_density * ball.drag_coefficient * math.pi * ball.radius**2
    parameters[k.SUBSTEP] = substep
    parameters[k.AREA : k.LEVER] = 0.25 * math.pi * bore**2
    # The reduction lets the piston travel further per joint angle, and so multiplies the torque.
    parameters[k.LEVER : k.LOWEST_ANGLE] = per_joint(
        pneumatics.moment_arm * pneumatics.leg_reduction, pneumatics.moment_arm
    )
    parameters[k.LOWEST_ANGLE : k.HIGHEST_ANGLE] = joint_limits[:, 0]
    parameters[k.HIGHEST_ANGLE : k.COULOMB] = joint_limits[:, 1]
    parameters[k.COULOMB : k.VISCOUS] = per_joint(pneumatics.leg_coulomb_friction, pneumatics.arm_coulomb_friction)
    parameters[k.VISCOUS : k.MANIFOLD_VOLUME] = per_joint(
        pneumatics.leg_viscous_friction, pneumatics.arm_viscous_friction
    )
    tubes = np.bincount(k.VALVE_OF_CHAMBER, minlength=k.VALVES)
    parameters[k.MANIFOLD_VOLUME : k.DEAD_VOLUME] = pneumatics.manifold_volume + half_tube * tubes
    parameters[k.DEAD_VOLUME : k.PARAMETER_SIZE] = pneumatics.dead_volume + half_tube
    return parameters
