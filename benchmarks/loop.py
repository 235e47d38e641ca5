"""What everything around an engine costs: a whole trial beside the engine alone on the same way."""

import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.bare import recording
from benchmarks.measurement import Measurement
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import config_for
from imolo.contracts.trial import Trial, TrialKind
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.method.motion import MotionTemplate
from imolo.trials.trial import SLICE, run_trial
from imolo_msgs import mocap_frame_t

TARGETS = {"mujoco": 1.25, "pybullet": 1.2, "dart": 1.12, "ode": 1.25, "drake": 1.2, "sapien": 1.2}
REPEATS = 7
DURATION = 1.1  # [s] a throw, as long as the ball flies
THETA, ONSET = (0.06, 0.28), 0.5  # [s] the robot waits as long as for a real ball


class FixedMotion:
    """Commands one motion in every frame, as a planner does."""

    def __init__(self, motion: MotionTemplate) -> None:
        """Prepare the motion."""
        self._commands = motion.commands(THETA, round(ONSET * 1e6))

    def attach(self, bus: Bus) -> None:
        """Join the bus."""
        self._bus = bus
        bus.subscribe(channels.MOCAP, self._on_frame)

    def _on_frame(self, frame: mocap_frame_t) -> None:
        message = self._commands.to_message(frame.utime, frame.frame_number)
        self._bus.publish(channels.ACTUATOR_COMMAND, message)


def run(engine: str) -> list[Measurement]:
    """Run a throw at which the robot jumps, again and again, and the engine alone in between.

    Both do the same every time, so that of each slice the shortest processor time counts, which other programs, that
    empty the caches, lengthened least.

    Raises:
        RuntimeError: The two do not do the same.
    """
    config = config_for(engine)
    steps = round(SLICE * 1e-6 / config.simulation.timestep)
    with tempfile.TemporaryDirectory() as folder:
        log_path = Path(folder) / "trial.lcmlog"
        time_slices(config, log_path)  # compiles, and takes the start-up check out of the recording
        with recording(engine) as recorded:
            time_slices(config, log_path)
        times = [(time_slices(config, log_path), recorded.replay(steps)[1:]) for _ in range(REPEATS)]
    count = len(recorded.joint_torque) - steps
    whole, alone = (np.min(part, axis=0).sum() / count for part in zip(*times, strict=True))
    subject = f"loop, {engine}"
    return [
        Measurement(subject, "whole step", 1e6 * whole, "µs"),
        Measurement(subject, "engine alone", 1e6 * alone, "µs"),
        Measurement(subject, "ratio", whole / alone, "", TARGETS[engine]),
    ]


def time_slices(config: ExperimentConfig, log_path: Path) -> NDArray[np.float64]:
    """Return how long each slice of a trial but the first takes [s], all that goes with it included."""
    begun = [0.0]
    controller, trial = FixedMotion(config.motion), Trial(TrialKind.HIT, 0, config.seed)
    run_trial(config, trial, controller, log_path, DURATION, lambda _: begun.append(time.process_time()))
    return np.diff(begun[1:])
