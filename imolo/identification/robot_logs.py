"""Recordings of a robot: our own logs, played again under the same commands."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from imolo.campaigns.motion_recorder import NO_CHANCE
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of
from imolo.contracts.actuators import Channel
from imolo.contracts.robot import Body
from imolo.contracts.trial import EventName
from imolo.errors import DivergenceError, MessageError, TrainingDataError
from imolo.identification.experiment import Errors
from imolo.identification.joint_angles import MarkerFit
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.method.commands import Commands
from imolo.trials.recordings import last_plan, theta_of
from imolo.trials.rollout import roll_out

Array = NDArray[np.float64]
QuantityName = Literal["effector", "markers", "sensors"]

STANDS = 0.3  # [s] before the onset, at most: a ready pose has settled by then (docs/transfer.md)
AFTER_WINDOW = 0.02  # [s] since the effector may no longer meet a ball
SENSOR_STEP = 4e-3  # [s] between two readings that are compared, at least
FINER = 2.0  # frames played for each one recorded, for the spline between them


@dataclass(frozen=True, eq=False)
class RobotLog:
    """One motion of a robot; a `Recording`. Times are since its onset [s].

    Attributes:
        name: For people.
        commands: That were given.
        stands: How long it is known to have stood before.
        until: End of what is compared.
        markers: By label: time, shape (N,), and position [m], shape (N, 3).
        sensor_time: Of the actuators' sensors, shape (S,).
        measured: What they read, in the unit of the channel, shape (S, C).
        effector: Label of the marker that is a quantity of its own.
        not_finite: Number of samples that were left out since they are no numbers.
    """

    name: str
    commands: Commands
    stands: float
    until: float
    markers: Mapping[int, tuple[Array, Array]]
    sensor_time: Array
    measured: Array
    effector: int
    not_finite: int = 0

    def play(self, config: ExperimentConfig) -> Errors:
        """Let the robot move under the same commands, and return what differs: positions [m] and readings."""
        shift = round(self.stands * 1e6) - self.commands.onset_utime
        switches = tuple(time + shift for time in self.commands.switch_utime)
        commands = Commands(round(self.stands * 1e6), switches, self.commands.targets)
        beyond = 2.0 / config.simulation.mocap.rate + abs(config.simulation.mocap.clock_offset)
        played = roll_out(config, commands, self.stands + self.until + beyond)
        off: dict[bool, list[Array]] = {True: [], False: []}
        for label, (time, position) in self.markers.items():
            path = played.markers[label]
            if not np.isfinite(path).all():
                raise DivergenceError(f"marker {label} is not finite")
            off[label == self.effector].append(CubicSpline(played.time - self.stands, path)(time) - position)
        errors = {"effector": off[True], "markers": off[False]}
        result = {name: np.concatenate(parts) for name, parts in errors.items() if parts}
        if len(self.sensor_time):
            read = _at(self.sensor_time, played.sensor_time - self.stands, played.measured)
            result["sensors"] = (read - self.measured) / sensor_unit(config.simulation.actuators.channels)[1]
        return result

    @property
    def digest(self) -> str:
        """Hash of all that was recorded."""
        total = hashlib.sha256(repr((self.commands, self.stands, self.until)).encode())
        for array in (self.sensor_time, self.measured, *(part for one in self.markers.values() for part in one)):
            total.update(np.ascontiguousarray(array).tobytes())
        return total.hexdigest()

    def joint_paths(self, fit: MarkerFit) -> tuple[Array, Array]:
        """Return times, shape (N,), and joint angles [rad], shape (N, J), that the markers show."""
        frames: dict[float, dict[int, Array]] = {}
        for label, (times, positions) in self.markers.items():
            for time, position in zip(times.tolist(), positions, strict=True):
                frames.setdefault(time, {})[label] = position
        seen = sorted(frames)
        return np.array(seen), fit.joint_angles([frames[time] for time in seen])


@dataclass(frozen=True, eq=False)
class ActuatorLog:
    """The actuators of one motion alone, their joints led as the cameras saw them move; a `Recording`.

    Attributes:
        log: What was recorded.
        angle_time: Since the onset [s], shape (N,).
        angle: [rad], shape (N, J).
    """

    log: RobotLog
    angle_time: Array
    angle: Array

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.log.name}, actuators"

    @cached_property
    def _path(self) -> CubicSpline:
        return CubicSpline(self.angle_time, self.angle)

    def play(self, config: ExperimentConfig) -> Errors:
        """Lead the joints, and return what the sensors read less what they read then."""
        log, step = self.log, config.simulation.timestep
        body = body_of(config.robot)
        count = round(log.until / step) + 1
        time = np.arange(count, dtype=np.float64) * step
        inside = np.clip(time + config.simulation.mocap.clock_offset, self.angle_time[0], self.angle_time[-1])
        angle = np.clip(self._path(inside), *body.joint_limits.T)
        velocity = self._path(inside, 1)
        channels = config.simulation.actuators.channels
        targets = _targets(log.commands, time, [c.rest for c in channels], [c.released for c in channels])
        actuators = config.simulation.actuators.create(body.joint_limits, angle[0], step)
        measured = np.empty((count, len(channels)))
        for index in range(count):
            measured[index] = actuators.measured()
            actuators.target[:] = targets[index]
            actuators.step(angle[index], velocity[index])
        return {"sensors": (_at(log.sensor_time, time, measured) - log.measured) / sensor_unit(channels)[1]}


@lru_cache(maxsize=256)
def actuators_alone(log: RobotLog, body: Body) -> ActuatorLog:
    """Return the actuators of a motion, their joints as the markers show them."""
    return ActuatorLog(log, *log.joint_paths(MarkerFit(body)))


def sensor_unit(actuators: Sequence[Channel]) -> tuple[str, Array]:
    """Return the unit in which sensors are compared, and its size in the unit of each channel, shape (C,).

    That of the channels, or per cent of the largest range in the same unit where they have several.
    """
    units = [channel.unit for channel in actuators]
    if len(set(units)) == 1:
        return units[0], np.ones(len(units))
    return "% of range", np.array([largest_range([c for c in actuators if c.unit == unit]) for unit in units]) / 100.0


def largest_range(actuators: Sequence[Channel]) -> float:
    """Return the largest range of channels that have a unit in common."""
    return max(channel.high - channel.low for channel in actuators)


def _targets(commands: Commands, time: Array, rest: list[float], released: list[float]) -> Array:
    ends = (np.array(commands.switch_utime) - commands.onset_utime) * 1e-6
    rows = np.vstack((commands.targets, np.array(released)))
    targets: Array = rows[np.searchsorted(ends, time + 1e-9, side="right")]
    targets[time < 0.0] = rest
    return targets


def _at(times: Array, time: Array, values: Array) -> Array:
    return np.stack([np.interp(times, time, column) for column in values.T], axis=1)


def repeatable(config: ExperimentConfig) -> ExperimentConfig:
    """Return a config whose motions go the same every time, seen exactly and more often than by the cameras."""
    content: dict[str, Any] = config.model_dump()
    simulation = content["simulation"]
    rate = min(FINER * config.simulation.mocap.rate, 1.0 / config.simulation.timestep)
    simulation["disturbance"] = NO_CHANCE["disturbance"]
    simulation["mocap"].update(NO_CHANCE["mocap"], ghost=0.0, latency=0.0, rate=rate)
    simulation["truth_rate"] = 10.0  # not looked at
    return type(config).model_validate(content)


def read_motion(log: Log, name: str, config: ExperimentConfig, duration: float | None) -> RobotLog:
    """Return the motion that a log shows.

    Args:
        log: The log.
        name: For people.
        config: Of its robot.
        duration: Since the onset [s]; if not given, until the effector can no longer meet a ball, or the commands end.

    Raises:
        TrainingDataError: It shows none that can be played again.
    """
    body = body_of(config.robot)
    commands = _commands(log, config)
    onset = commands.onset_utime
    until = duration or _end_of_motion(log, commands, config)
    for event in log.messages[channels.TRIAL]:
        if event.event in (EventName.TOUCH, EventName.ROBOT_LANDED, EventName.END) and event.utime > onset:
            until = min(until, (event.utime - onset) * 1e-6)
    starts = [event.utime for event in log.messages[channels.TRIAL] if event.event == EventName.START]
    stands = min(STANDS, (onset - starts[0]) * 1e-6) if starts and starts[0] < onset else STANDS
    markers, not_finite = {}, 0
    for marker in body.markers:
        time, place = marker_samples(log, marker.marker_id, onset)
        inside, finite = (time >= 0.0) & (time <= until), np.isfinite(place).all(axis=1)
        not_finite += int((inside & ~finite).sum())
        if (inside & finite).any():
            markers[marker.marker_id] = time[inside & finite], place[inside & finite]
    sensor_time, measured = sensor_samples(log, onset)
    inside, finite = (sensor_time >= 0.0) & (sensor_time <= until), np.isfinite(measured).all(axis=1)
    not_finite += int((inside & ~finite).sum())
    sensor_time, measured = sensor_time[inside & finite], measured[inside & finite]
    if len(sensor_time) > 1:
        stride = max(1, round(SENSOR_STEP / float(np.median(np.diff(sensor_time)))))
        sensor_time, measured = sensor_time[::stride], measured[::stride]
    return RobotLog(name, commands, stands, until, markers, sensor_time, measured, body.learning_marker, not_finite)


def marker_samples(log: Log, label: int, onset: int) -> tuple[Array, Array]:
    """Return times since the onset [s], shape (N,), and positions [m], shape (N, 3), of a marker."""
    samples = {
        frame.utime: marker.marker_position
        for frame in log.messages[channels.MOCAP]
        for marker in frame.markers
        if marker.marker_id == label
    }
    return (np.array(list(samples), dtype=np.float64) - onset) * 1e-6, np.array(list(samples.values())).reshape(-1, 3)


def sensor_samples(log: Log, onset: int) -> tuple[Array, Array]:
    """Return times since the onset [s], shape (S,), and readings, shape (S, C); NaN where some are missing."""
    states = log.messages[channels.ACTUATOR_STATE]
    time = (np.array([state.utime for state in states], dtype=np.float64) - onset) * 1e-6
    width = max((state.num_measured for state in states), default=0)
    rows = [state.measured if state.num_measured == width else [np.nan] * width for state in states]
    return time, np.array(rows).reshape(len(states), width)


def _commands(log: Log, config: ExperimentConfig) -> Commands:
    messages = log.messages[channels.ACTUATOR_COMMAND]
    if not messages:
        raise TrainingDataError("holds no ACTUATOR_COMMAND, so that nothing says what moved the robot")
    try:
        given = [Commands.from_message(one, config.simulation.actuators.channels) for one in messages]
    except MessageError as error:
        raise TrainingDataError(f"has commands that this robot cannot follow: {error}") from error
    for command, message in zip(given, messages, strict=True):
        # What is commanded anew must agree with what was done until then (Fig. 4e).
        if message.utime > command.onset_utime and not given[-1].matches_until(command, message.utime):
            raise TrainingDataError("has commands that contradict what the robot had done by then")
    return given[-1]


def _end_of_motion(log: Log, commands: Commands, config: ExperimentConfig) -> float:
    plan = last_plan(log)
    theta = () if plan is None else theta_of(plan, config.motion)
    end = (commands.end_utime - commands.onset_utime) * 1e-6
    return min(end, config.motion.swing_of(theta) + config.training.sampled_to + AFTER_WINDOW) if theta else end
