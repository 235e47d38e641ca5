"""Feed a recorded session to a planner, and see whether it says what it said."""

from pathlib import Path

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import config_for, named_config
from imolo.contracts.planner import Planner
from imolo.contracts.registry import PLANNERS
from imolo.contracts.trial import EventName
from imolo.errors import BusError, ConfigError, did_you_mean
from imolo.inspect.diff import RunComparison, compare_runs
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import decode
from imolo.messaging.log_file import LogEvent, read_events

HEARD = (channels.TRIAL, channels.MOCAP)  # what a planner subscribes to
SAID = (channels.ACTUATOR_COMMAND, channels.PLAN, channels.BALL_STATE)  # what it publishes


def replay(log_path: Path, table_path: Path, method: str, config: str | None) -> RunComparison:
    """Replay a log to a planner in the order of the log, and compare its messages to the recorded ones, byte by byte.

    Args:
        log_path: Log of a trial.
        table_path: Table of the planner.
        method: Whose planner settings are used.
        config: What the trial ran with, a backend or the path of a YAML; None for the defaults.

    Raises:
        BusError: The log cannot be read, or holds no start of a trial.
        ConfigError: The config cannot be read, or has no such method.
        TableFileError: The table cannot be read, or is for another robot.
    """
    events = [event for event in read_events(log_path, (*HEARD, *SAID)) if event.channel in (*HEARD, *SAID)]
    trial_events = [decode(event.channel, event.data) for event in events if event.channel == channels.TRIAL]
    start = next((event for event in trial_events if event is not None and event.event == EventName.START), None)
    if start is None:
        raise BusError(f"{log_path} holds no start of a trial, so there is nothing to replay")
    chosen = _config(config, start.backend, start.robot)
    if method not in chosen.methods:
        raise ConfigError(
            f"unknown method {method!r}{did_you_mean(method, chosen.methods)}; known: {', '.join(chosen.methods)}"
        )
    plugin = PLANNERS.load(chosen.methods[method].controller.name)
    planner = plugin.create(chosen, method, table_path, lambda _: None)
    recorded = [event for event in events if event.channel in SAID]
    return compare_runs(recorded, answers(planner, events))


def answers(planner: Planner, events: list[LogEvent]) -> list[LogEvent]:
    """Return what a planner publishes when it hears the recorded events, stamped by the event it answers."""
    bus = Bus()
    planner.attach(bus)
    said: list[LogEvent] = []
    now = 0

    def keep(channel: str, data: bytes) -> None:
        if channel in SAID:
            said.append(LogEvent(len(said), now, channel, data, 0))

    bus.subscribe_raw(keep)
    for event in events:
        message = decode(event.channel, event.data) if event.channel in HEARD else None
        if message is None:
            continue
        now = event.utime
        bus.publish(event.channel, message)
        bus.drain()
    return said


def _config(config: str | None, backend: str, robot: str) -> ExperimentConfig:
    return config_for(backend, robot={"name": robot}) if config is None else named_config(config)
