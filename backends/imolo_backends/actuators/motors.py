"""Electric actuators: a motor on every joint that is held at its target by a PD law, within its torque limit."""

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import Field, model_validator

from imolo.config.disturbance import DisturbanceConfig
from imolo.config.experiment import ExperimentConfig
from imolo.config.model import Model, NonNegative, Positive
from imolo.config.simulation import SimulationConfig
from imolo.contracts.actuators import Actuators, ActuatorsConfig, Channel
from imolo.contracts.urdf import Joint
from imolo.errors import ConfigError, did_you_mean
from imolo.method.motion import PhasedMotion
from imolo_backends.compiled import CFunction, c_function

Array = NDArray[np.float64]


class Motor(Model):
    """The motor of one joint, seen from the joint's side of its gear.

    Attributes:
        name: For people; that of its joint is a good one, and if one motor bears a joint's name, all must.
        unit: Of its target: rad, or m where the joint slides; forces [N] then take the place of torques.
        stiffness: Gain of the position error [N·m/rad].
        damping: Gain of the velocity [N·m·s/rad].
        torque_limit: Most that it gives [N·m].
        speed_limit: Fastest that its target moves [rad/s].
        low: Lowest target [rad].
        high: Highest target [rad].
        rest: Target before the onset and after the end of a motion [rad].
    """

    name: str
    unit: Literal["rad", "m"] = "rad"
    stiffness: Positive
    damping: NonNegative
    torque_limit: Positive
    speed_limit: Positive
    low: float
    high: float
    rest: float = 0.0

    @model_validator(mode="after")
    def _rest_is_in_range(self) -> Self:
        if not self.low <= self.rest <= self.high:
            raise ValueError(
                f"rest of motor {self.name!r} is {self.rest:g} {self.unit}; give {self.low:g} to {self.high:g}"
            )
        return self


class MotorDisturbance(DisturbanceConfig):
    """How much an electric robot differs from one trial to the next."""

    profiles: ClassVar[dict[str, dict[str, float]]] = {
        "none": {},
        "realistic": {"delay": 0.0003, "torque_scale": 0.005, "joint_angle": 0.001},
    }

    delay: NonNegative = Field(0.0, description="of each motor's delay [s]")
    torque_scale: NonNegative = Field(0.0, description="of each motor's gains, relative [-]")


class MotorsConfig(ActuatorsConfig):
    """The motors of a robot."""

    motors: Annotated[tuple[Motor, ...], Field(min_length=1)] = Field(description="one per joint, in their order")
    delay: NonNegative = Field(0.002, description="of a command [s], assumed: a servo loop at 500 Hz")
    encoder_noise: NonNegative = Field(1e-5, description="sd of the measured angle [rad], assumed: 18 bits per turn")

    @model_validator(mode="after")
    def _names_are_distinct(self) -> Self:
        names = [motor.name for motor in self.motors]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two motors are named {name!r}; give each a name of its own")
        return self

    def check_joints(self, joints: Sequence[Joint]) -> None:
        """See `ActuatorsConfig.check_joints`: the order decides, so names must not say otherwise."""
        names, joint_names = [motor.name for motor in self.motors], [joint.name for joint in joints]
        if len(names) != len(joint_names):
            raise ConfigError(
                f"there are {len(names)} motors for {len(joint_names)} joints; give one for each of: "
                f"{', '.join(joint_names)}"
            )
        for name, joint in zip(names, joint_names, strict=True):
            if name != joint and (set(names) & set(joint_names) or did_you_mean(name, joint_names)):
                raise ConfigError(
                    f"motor {name!r} stands where the joint is {joint!r}{did_you_mean(name, joint_names)}; give the "
                    f"motors in the order of the joints: {', '.join(joint_names)}"
                )
        for motor, moved in zip(self.motors, joints, strict=True):
            if motor.unit != moved.unit:
                way = "slides" if moved.unit == "m" else "turns"
                raise ConfigError(f"motor {motor.name!r}: joint {moved.name!r} {way}; give it `unit: {moved.unit}`")

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The motors; released, they return to rest."""
        return tuple(Channel(m.name, m.unit, m.low, m.high, rest=m.rest, released=m.rest) for m in self.motors)

    @property
    def sensor_noise(self) -> float:
        """Standard deviation of an encoder [rad]."""
        return self.encoder_noise

    def settled_torque(self, target: Array, joint_angle: Array) -> Array:
        """Return the PD law at rest, within the torque limits [N·m], shape (J,)."""
        stiffness, limit = np.array([(motor.stiffness, motor.torque_limit) for motor in self.motors]).T
        torque: Array = np.clip(stiffness * (target - joint_angle), -limit, limit)
        return torque

    def draw(self, disturbance: DisturbanceConfig, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw what is added to the delay of each motor [s], and what its gains are scaled by, shape (J,) each."""
        scale = disturbance if isinstance(disturbance, MotorDisturbance) else MotorDisturbance(profile="none")
        count = len(self.motors)
        delay = rng.normal(0.0, 1.0, count) * scale.delay
        return delay, 1.0 + rng.normal(0.0, 1.0, count) * scale.torque_scale

    def create(self, joint_limits: Array, joint_angle: Array, timestep: float, drawn: Any = None) -> Actuators:
        """Switch the motors on, their targets at rest."""
        count = len(self.motors)
        delay, scale = (np.zeros(count), np.ones(count)) if drawn is None else drawn
        return Motors(self, timestep, joint_angle, np.maximum(self.delay + delay, 0.0), scale)


class MotorSimulation(SimulationConfig):
    """What surrounds an electric robot."""

    actuators: MotorsConfig
    disturbance: MotorDisturbance = MotorDisturbance()


class MotorExperiment(ExperimentConfig):
    """An experiment with an electric robot."""

    motion: PhasedMotion
    simulation: MotorSimulation


class Motors:
    """The motors of one trial.

    The target of each moves at most by its speed limit, so that a switched target is a ramp; the torque is that of a PD
    law about it, within the torque limit.
    """

    def __init__(self, config: MotorsConfig, timestep: float, joint_angle: Array, delay: Array, scale: Array) -> None:
        """Hold the joints where they are.

        Args:
            config: Parameters.
            timestep: Of the engine [s].
            joint_angle: At the start [rad], shape (J,).
            delay: Of each motor [s], shape (J,).
            scale: Of the gains of each motor [-], shape (J,).
        """
        motors = config.motors
        self._parameters = np.array(
            [
                (m.stiffness * s, m.damping * s, m.torque_limit, m.speed_limit)
                for m, s in zip(motors, scale, strict=True)
            ]
        )
        steps = np.rint(delay / timestep).astype(np.int64)
        rest = np.array([motor.rest for motor in motors])
        self._delayed = np.tile(rest, (int(steps.max()) + 1, 1))
        self._counters = np.concatenate(([0], steps)).astype(np.int64)
        self._angle = np.array(joint_angle)
        self._setpoint = np.array(joint_angle, dtype=np.float64)
        self.target = rest.copy()
        self.joint_torque = np.zeros(len(motors))
        memory = self._delayed, self._counters, self._setpoint
        self._motors = (self._parameters, *memory, timestep, self.target, self.joint_torque, self._angle)

    def step(self, joint_angle: Array, joint_velocity: Array) -> None:
        """Advance by one engine step under `target`, then set `joint_torque`."""
        _advance(*self._motors, joint_angle, joint_velocity)

    def compiled_step(self, joint_angle: Array, joint_velocity: Array) -> CFunction:
        """Return what does the same as `step` with these two arrays."""
        return c_function(_advance, *self._motors, joint_angle, joint_velocity)

    def measured(self) -> Array:
        """Return the joint angles at the last step [rad], shape (J,)."""
        return self._angle.copy()


@njit(cache=True)
def _advance(
    parameters: Array,
    delayed: Array,
    counters: NDArray[np.int64],
    setpoint: Array,
    timestep: float,
    target: Array,
    torque: Array,
    measured: Array,
    angle: Array,
    velocity: Array,
) -> None:
    ring, row = delayed.shape[0], counters[0]
    for joint in range(len(torque)):
        delayed[row, joint] = target[joint]
        measured[joint] = angle[joint]
        wanted = delayed[(row - counters[1 + joint]) % ring, joint]
        stiffness, damping, most, speed = parameters[joint]
        way = speed * timestep
        before = setpoint[joint]
        setpoint[joint] += min(way, max(-way, wanted - before))
        # The law knows how fast its target moves, or it would lag behind by damping / stiffness.
        pull = stiffness * (setpoint[joint] - angle[joint])
        pull += damping * ((setpoint[joint] - before) / timestep - velocity[joint])
        torque[joint] = min(most, max(-most, pull))
    counters[0] = (row + 1) % ring
