"""Execute motions without a ball on one backend, and read where the hand was."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from imolo.campaigns.campaign import TrialTask, log_name, run_tasks
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import TrainingDataError
from imolo.messaging.log import read_log
from imolo.method.forward_model import TrainingData
from imolo.method.motion import MotionTemplate, Theta
from imolo.trials.recordings import last_plan, marker_track
from imolo.trials.trainer import START_MARGIN

Array = NDArray[np.float64]

NO_CHANCE: dict[str, Any] = {
    "disturbance": {"profile": "none"},
    "mocap": {"marker_noise": 0.0, "marker_dropout": 0.0, "frame_dropout": 0.0, "unlabelled": 0.0},
}
"""What of `simulation` makes motions go the same every time and be seen exactly."""


@dataclass(frozen=True, eq=False)
class Recording:
    """The hand of one motion.

    Attributes:
        theta: Of the motion.
        time: Since the onset [s], shape (N,), increasing.
        position: Of the hand in the world frame [m], shape (N, 3).
    """

    theta: Theta
    time: Array
    position: Array

    def covers(self, time: float) -> bool:
        """Return whether the hand was recorded before and after a time since the onset [s]."""
        return len(self.time) >= 4 and bool(self.time[0] <= time <= self.time[-1])

    def hand(self, time: float) -> Array:
        """Return the hand at a time since the onset [s], by a cubic through the frames [m], shape (3,)."""
        return np.asarray(CubicSpline(self.time, self.position)(time))


@dataclass(frozen=True)
class Window:
    """When an effector may meet the ball, since the start of the swing [s]; the bounds are excluded."""

    start: float
    stop: float

    def samples(self, recordings: Sequence[Recording], motion: MotionTemplate) -> TrainingData:
        """Return the tuples (s, t, theta) of the frames in the window."""
        theta, time, position = [], [], []
        for recording in recordings:
            since = recording.time - motion.swing_of(recording.theta)
            inside = (since > self.start) & (since < self.stop)
            theta += [recording.theta] * int(inside.sum())
            time.append(recording.time[inside])
            position.append(recording.position[inside])
        return TrainingData(
            np.array(theta).reshape(-1, len(motion.parameters)), np.concatenate(time), np.concatenate(position)
        )


def without_chance(config: ExperimentConfig) -> ExperimentConfig:
    """Return a config whose motions go the same every time and are seen exactly."""
    content = config.model_dump()
    content["simulation"].update(NO_CHANCE)
    # Sensors are not looked at, and every message costs time.
    content["simulation"].update(sensor_rate=config.simulation.mocap.rate, truth_rate=config.simulation.mocap.rate)
    return type(config).model_validate(content)


def record_motions(
    config: ExperimentConfig,
    motions: Sequence[tuple[Theta, float]],
    logs: Path,
    jobs: int,
    on_done: Callable[[int, int], object] = lambda *_: None,
) -> list[Recording]:
    """Execute motions and return their recordings in order.

    Chance in a motion depends on the seed and on its place among the motions, so one that is named twice goes
    differently each time if anything is left to chance.

    Args:
        config: Of the backend.
        motions: Each with the time since its onset until which it is recorded [s].
        logs: Folder to write the logs to.
        jobs: Number of processes.
        on_done: Told how many motions are done, and how many there are.

    Raises:
        ImoloError: A trial failed.
        TrainingDataError: A log does not show the hand.
    """
    training = config.training.model_copy(update={"motions": tuple(theta for theta, _ in motions)})
    config = config.model_copy(update={"training": training})
    trials = [Trial(TrialKind.TRAINING, index, config.seed) for index in range(len(motions))]
    tasks = [
        TrialTask(config, trial, logs / log_name(trial), duration=START_MARGIN + end)
        for trial, (_, end) in zip(trials, motions, strict=True)
    ]
    done = 0
    on_done(0, len(tasks))

    def count(_: TrialTask) -> None:
        nonlocal done
        done += 1
        on_done(done, len(tasks))

    run_tasks(tasks, jobs, count)
    return [_read(task, end) for task, (_, end) in zip(tasks, motions, strict=True)]


def _read(task: TrialTask, end: float) -> Recording:
    log = read_log(task.log_path)
    plan = last_plan(log)
    time, position = marker_track(log, body_of(task.config.robot).learning_marker)
    if plan is not None:
        time = time - plan.plan_onset_utime * 1e-6
        recording = Recording(tuple(plan.theta), time, position)
        if recording.covers(end):
            return recording
    raise TrainingDataError(f"{task.log_path} does not show the hand {end:.3f} s after the onset of a motion")
