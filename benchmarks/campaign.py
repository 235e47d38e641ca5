"""What a second process brings: the same trials in one process and in as many as there are cores, in turns."""

import os
import time
from pathlib import Path

import numpy as np

from benchmarks.measurement import Measurement
from imolo.campaigns.campaign import learning_tasks, run_tasks
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import config_for

REPEATS = 3
LEAST_SPEED_UP = 1.8  # on 2 cores
CORES = 2


def run(folder: Path) -> list[Measurement]:
    """Run the learning trials of the default experiment again and again; only a quiet machine gives its best."""
    config = config_for("mujoco")
    # Compiles, and starts the processes, which a campaign does once.
    for jobs in (1, CORES):
        _elapsed(config, folder / f"warm_{jobs}", jobs)
    times = np.array(
        [[_elapsed(config, folder / f"{jobs}_{repeat}", jobs) for jobs in (1, CORES)] for repeat in range(REPEATS)]
    )
    share = float(np.median(times[:, 1] / times[:, 0]))
    subject = f"campaign, {CORES} processes"
    return [
        Measurement(subject, "trials in one process", float(np.median(times[:, 0])), "s"),
        Measurement(subject, "time over that of one process", share, "", 1.0 / LEAST_SPEED_UP),
        Measurement(subject, "load of the machine meanwhile, all programs", os.getloadavg()[0], ""),
    ]


def _elapsed(config: ExperimentConfig, folder: Path, jobs: int) -> float:
    tasks = learning_tasks(config, folder)
    begin = time.perf_counter()
    run_tasks(tasks, jobs)
    return time.perf_counter() - begin
