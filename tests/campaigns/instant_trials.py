"""Trials of a runner that writes a log in a millisecond."""

from pathlib import Path

import lcm

from imolo.campaigns.campaign import TrialTask, log_name
from imolo.campaigns.kept_trials import TrialTiming
from imolo.config.loading import config_for
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.messaging import channels
from imolo_msgs import trial_event_t

TRIALS = 3
CONFIG = config_for("mujoco")
EVENTS = 400  # some 30 kB


def play_at_once(task: TrialTask) -> TrialTiming:
    """Write the log of a trial, by its index alone."""
    task.log_path.parent.mkdir(parents=True, exist_ok=True)
    log = lcm.EventLog(str(task.log_path), "w", overwrite=True)
    try:
        for number in range(EVENTS):
            event = trial_event_t()
            event.utime, event.trial = number * 1000, task.trial.index
            event.event = (EventName.END if number == EVENTS - 1 else EventName.START).value
            log.write_event(event.utime, channels.TRIAL, event.encode())
    finally:
        log.close()
    return TrialTiming(simulated=0.4, elapsed=0.001, decisions=(0.1 * task.trial.index,))


def tasks(folder: Path) -> list[TrialTask]:
    trials = [Trial(TrialKind.THROW, index, CONFIG.seed) for index in range(TRIALS)]
    return [TrialTask(CONFIG, trial, folder / log_name(trial)) for trial in trials]
