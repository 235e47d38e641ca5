"""What everything around an engine costs: a whole trial beside the engine alone on the same way."""

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.bare import recording
from benchmarks.measurement import Measurement
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import config_for
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.method.motion import MotionTemplate
from imolo.trials.trial import run_trial
from imolo_msgs import mocap_frame_t, trial_event_t

TARGETS = {"mujoco": 1.25, "pybullet": 1.2, "dart": 1.12, "ode": 1.25, "drake": 1.2, "sapien": 1.2}
REPEATS = 7
DURATION = 1.1  # [s] a throw, as long as the ball flies
THETA, ONSET = (0.06, 0.28), 0.5  # [s] the robot waits as long as for a real ball

# Of this process, since other programs share the machine.
clock = time.process_time


class TimedMotion:
    """Commands one motion in every frame, as a planner does, and measures from the trial's start to its end."""

    def __init__(self, motion: MotionTemplate) -> None:
        self._commands = motion.commands(THETA, round(ONSET * 1e6))
        self.elapsed = 0.0

    def attach(self, bus: Bus) -> None:
        """Join the bus."""
        self._bus = bus
        bus.subscribe(channels.TRIAL, self._on_trial)
        bus.subscribe(channels.MOCAP, self._on_frame)

    def _on_trial(self, event: trial_event_t) -> None:
        if event.event == EventName.START:
            self._begin = clock()
        elif event.event == EventName.END:
            self.elapsed = clock() - self._begin

    def _on_frame(self, frame: mocap_frame_t) -> None:
        message = self._commands.to_message(frame.utime, frame.frame_number)
        self._bus.publish(channels.ACTUATOR_COMMAND, message)


def run(engine: str) -> list[Measurement]:
    """Run a throw at which the robot jumps, again and again, and the engine alone in between.

    Raises:
        RuntimeError: The two do not do the same.
    """
    config = config_for(engine)
    with tempfile.TemporaryDirectory() as folder:
        log_path = Path(folder) / "trial.lcmlog"
        run_timed(config, log_path)  # compiles, and takes the start-up check out of the recording
        with recording(engine) as recorded:
            run_timed(config, log_path)
        times = np.array([(run_timed(config, log_path), recorded.replay(clock)) for _ in range(REPEATS)])
    whole, alone = 1e6 * np.median(times, axis=0) / len(recorded.joint_torque)
    ratio = float(np.median(times[:, 0] / times[:, 1]))
    subject = f"loop, {engine}"
    return [
        Measurement(subject, "whole step", float(whole), "µs"),
        Measurement(subject, "engine alone", float(alone), "µs"),
        Measurement(subject, "ratio", ratio, "", TARGETS[engine]),
    ]


def run_timed(config: ExperimentConfig, log_path: Path) -> float:
    """Return how long a trial takes once everything is loaded [s]."""
    controller = TimedMotion(config.motion)
    run_trial(config, Trial(TrialKind.HIT, 0, config.seed), controller, log_path, DURATION)
    return controller.elapsed
