"""How long the planner thinks: a mocap message in, its commands out, in one process."""

import time
from pathlib import Path

import numpy as np

from benchmarks.learned import Learned
from benchmarks.measurement import Measurement
from imolo.campaigns.campaign import hit_tasks, run_tasks
from imolo.contracts.trial import EventName
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import Log, read_log
from imolo.method.planner import Planner
from imolo.method.plugin import planner_config
from imolo.method.table import LookupTable

TARGET = 1000.0  # [µs] for 99 of 100 decisions
REPEATS = 20
BALLS = 6


def run(learned: Learned, method: str, table: LookupTable, folder: Path) -> list[Measurement]:
    """Record a few balls with the planner, and play their mocap frames to it again and again.

    The garbage collector runs, as it does in a trial.
    """
    table_path = folder / f"{method}.npz"
    table.save(table_path)
    tasks = hit_tasks(learned.config, folder / method, method, table_path)[:BALLS]
    run_tasks(tasks, jobs=-1)
    config = learned.config
    bus = Bus()
    planner = Planner(table, learned.ball_models[method], planner_config(config, method), config.tracker)
    planner.attach(bus)
    commands: list[object] = []
    bus.subscribe(channels.ACTUATOR_COMMAND, commands.append)
    logs = [read_log(task.log_path) for task in tasks]
    for log in logs:
        _answer_times(bus, log)  # compiles and warms up
    times = np.concatenate([_answer_times(bus, log) for _ in range(REPEATS) for log in logs])
    if not commands:
        raise RuntimeError(f"the planner found no motion for {BALLS} balls")
    median, p99, longest = np.percentile(1e6 * times, (50.0, 99.0, 100.0)).tolist()
    subject = f"decision, {method}"
    return [
        Measurement(subject, "median", median, "µs"),
        Measurement(subject, "99th percentile", p99, "µs", TARGET),
        Measurement(subject, f"longest of {len(times)}", longest, "µs"),
    ]


def _answer_times(bus: Bus, log: Log) -> list[float]:
    """Return how long each frame of a trial took to be decoded and answered [s]."""
    start = next(event for event in log.messages[channels.TRIAL] if event.event == EventName.START)
    _publish_and_drain(bus, channels.TRIAL, start)
    return [_publish_and_drain(bus, channels.MOCAP, frame) for frame in log.messages[channels.MOCAP]]


def _publish_and_drain(bus: Bus, channel: str, message: object) -> float:
    bus.publish(channel, message)
    begin = time.perf_counter()
    bus.drain()
    return time.perf_counter() - begin
