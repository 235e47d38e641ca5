"""What can be read of a robot's motions and of a method's table, to hold against what was published of a real one.

Everything is measured on motions without chance: those of the config's training, and others that nothing is learned
from. The first method of the config is the one that is measured.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.stats import qmc

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of, create_task
from imolo.contracts.task import Throw
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import TrainingDataError
from imolo.method.forward_model import ForwardModel, TrainingData
from imolo.method.motion import Theta
from imolo.method.table import LookupTable
from imolo.trials.rollout import Rollout, roll_out

Array = NDArray[np.float64]

ONSET = 0.2  # [s] of standing before a motion; settles a ready pose
AFTER_WINDOW = 0.02  # [s]
LIFTED = 0.005  # [m] a foot this much above where it stood has left the ground
FLIGHT_STEP = 1e-3  # [s] of a ball's path
LONGEST_FLIGHT = 2.0  # [s]
SEEN = 0.1  # [s] a ball is watched before a motion may start


@dataclass(frozen=True)
class Motion:
    """One motion to play without chance.

    Attributes:
        config: Of the backend.
        theta: Its parameter.
    """

    config: ExperimentConfig
    theta: Theta

    def __str__(self) -> str:
        return f"{self.config.motion.label(self.theta)} in {self.config.backend.name}"

    def play(self) -> Rollout:
        """Play it, until a little after the window in which the effector may meet the ball."""
        config = self.config
        commands = config.motion.commands(self.theta, round(ONSET * 1e6))
        end = ONSET + config.motion.swing_of(self.theta) + config.training.sampled_to + AFTER_WINDOW
        return roll_out(config, commands, end)


def unseen_motions(config: ExperimentConfig, count: int, seed: int) -> list[Theta]:
    """Return motions spread over the range of the first method's table that nothing is learned from."""
    low, high = next(iter(config.methods.values())).grid.bounds(config.motion)
    share = qmc.Halton(len(low), rng=np.random.default_rng(seed)).random(count)
    return [config.motion.rounded(theta) for theta in (low + share * (high - low)).tolist()]


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured of one robot.

    Attributes:
        values: By name, SI units.
        reach: Middle of the predicted positions of the effector [m], shape (3,).
    """

    values: Mapping[str, float]
    reach: Array


def measure(
    config: ExperimentConfig, unseen: Sequence[Theta], rollouts: Sequence[Rollout], balls: int, aim_at_reach: bool
) -> Measured:
    """Measure all that a fact can name.

    `regression_error` and `regression_sd`: distance of the effector from its prediction on motions it was not learned
    from [m]; `spread_x`, `spread_y`, `spread_z`: middle half of the samples' positions [m]; `samples`: their number;
    `speed`: of the effector in the window [m/s]; `JOINT.low`, `JOINT.high`: angles of a joint in the window [rad];
    `feet_off`: share of motions whose feet have left the ground there; `reach_low`, `reach_high`: 10 % and 90 % of the
    predicted heights [m]; `sideways`: range of the predicted y, 10 % to 90 % [m]; `answered`: share of balls that meet
    an entry of the table.

    Args:
        config: Of the robot; its training motions come first among the rollouts.
        unseen: Motions that nothing is learned from.
        rollouts: Of the training motions and the unseen ones.
        balls: How many balls are thrown at the table.
        aim_at_reach: Whether the thrower is aimed at the middle of the reach, as an operator would.

    Raises:
        TrainingDataError: The effector is not seen in the window.
    """
    motions = [*config.training.motions, *unseen]
    samples = _samples(config, config.training.motions, rollouts)
    method = next(iter(config.methods.values()))
    model = ForwardModel(method.forward_model, config.motion).fit(samples.theta, samples.time, samples.position)
    table = LookupTable.build(model, method.grid, np.random.default_rng(config.seed), robot=config.robot.name)
    spread = np.subtract(*np.percentile(samples.position, [75, 25], axis=0))
    error, speed = _prediction_errors(config, model, unseen, rollouts[len(config.training.motions) :])
    predicted = np.percentile(table.position, [10, 50, 90], axis=0)
    values = {
        "regression_error": float(error.mean()),
        "regression_sd": float(error.std()),
        "samples": float(len(samples.time)),
        "speed": float(speed.mean()),
        "reach_low": float(predicted[0, 2]),
        "reach_high": float(predicted[2, 2]),
        "sideways": float(predicted[2, 1] - predicted[0, 1]),
        **{f"spread_{axis}": float(value) for axis, value in zip("xyz", spread, strict=True)},
        **_posture(config, motions, rollouts),
    }
    aimed = aimed_at(config, predicted[1]) if aim_at_reach else config
    values["answered"] = _answered(aimed, table, balls)
    return Measured(values, predicted[1])


def aimed_at(config: ExperimentConfig, reach: Array) -> ExperimentConfig:
    """Return a config whose thrower aims at a point [m], shape (3,)."""
    content = config.model_dump()
    content["simulation"]["thrower"]["aim_center"] = tuple(np.round(reach, 3).tolist())
    return type(config).model_validate(content)


def _window(config: ExperimentConfig, theta: Theta) -> tuple[float, float]:
    swing = ONSET + config.motion.swing_of(theta)
    return swing + config.training.sampled_from, swing + config.training.sampled_to


def _samples(config: ExperimentConfig, motions: Sequence[Theta], rollouts: Sequence[Rollout]) -> TrainingData:
    label = body_of(config.robot).learning_marker
    theta: list[Theta] = []
    times, positions = [], []
    for motion, rollout in zip(motions, rollouts, strict=False):
        start, stop = _window(config, motion)
        inside = (rollout.time > start) & (rollout.time < stop)
        theta += [motion] * int(inside.sum())
        times.append(rollout.time[inside] - ONSET)
        positions.append(rollout.markers[label][inside])
    if not theta:
        raise TrainingDataError("the effector is not seen in the window of the training samples")
    return TrainingData(np.array(theta), np.concatenate(times), np.concatenate(positions))


def _prediction_errors(
    config: ExperimentConfig, model: ForwardModel, motions: Sequence[Theta], rollouts: Sequence[Rollout]
) -> tuple[Array, Array]:
    """Return distances of predictions to the effector [m] and its speeds [m/s] at the times of the table."""
    label = body_of(config.robot).learning_marker
    since = next(iter(config.methods.values())).grid.time_since_swing.values()[::4]
    errors, speeds = [], []
    for theta, rollout in zip(motions, rollouts, strict=True):
        path = CubicSpline(rollout.time - ONSET, rollout.markers[label])
        at = config.motion.swing_of(theta) + since
        predicted = model.predict(np.tile(theta, (len(at), 1)), at)
        errors.append(np.linalg.norm(predicted - path(at), axis=1))
        speeds.append(np.linalg.norm(path(at, 1), axis=1))
    return np.concatenate(errors), np.concatenate(speeds)


def _posture(config: ExperimentConfig, motions: Sequence[Theta], rollouts: Sequence[Rollout]) -> dict[str, float]:
    body = body_of(config.robot)
    angles, off = [], []
    feet = list(body.standing_markers)
    for theta, rollout in zip(motions, rollouts, strict=True):
        start, stop = _window(config, theta)
        inside = (rollout.truth_time > start) & (rollout.truth_time < stop)
        angles.append(rollout.joint_angle[inside])
        seen = (rollout.time > start) & (rollout.time < stop)
        heights = [rollout.markers[label][:, 2] for label in feet]
        off.append(all(height[seen].min() > height[0] + LIFTED for height in heights))
    joint = np.concatenate(angles)
    found = {"feet_off": float(np.mean(off))} if feet else {}
    for name, column in zip(body.joint_names, joint.T, strict=True):
        found[f"{name}.low"], found[f"{name}.high"] = float(column.min()), float(column.max())
    return found


def _answered(config: ExperimentConfig, table: LookupTable, balls: int) -> float:
    """Return the share of balls for which the table has a motion at some frame, were they predicted without error."""
    task = create_task(config)
    step = config.simulation.mocap.rate**-1
    answered = 0
    for index in range(balls):
        throw = task.throw(Trial(TrialKind.HIT, index, config.seed))
        path = _flight(throw, task.drag() / task.ball.mass, throw.lift / task.ball.mass, step)
        times = np.arange(len(path)) * step
        first = round(SEEN / step)
        answered += any(
            table.query_path(path[now:], times[now:] - times[now]) is not None for now in range(first, len(path))
        )
    return answered / balls


def _flight(throw: Throw, drag: float, lift: Array, step: float) -> Array:
    """Return the ball at every frame until it lands [m], shape (N, 3), with drag [1/m] and lift [1/s], shape (3,)."""
    substeps = max(1, round(step / FLIGHT_STEP))
    small = step / substeps
    gravity = np.array([0.0, 0.0, -9.81])
    position, velocity, turn = throw.position, throw.velocity, np.cross(lift, -np.eye(3))
    path = [position]
    while path[-1][2] > 0.0 and len(path) * step < LONGEST_FLIGHT:
        for _ in range(substeps):
            acceleration = gravity + turn @ velocity - drag * np.linalg.norm(velocity) * velocity
            position = position + velocity * small + 0.5 * acceleration * small**2
            velocity = velocity + acceleration * small
        path.append(position)
    return np.array(path)
