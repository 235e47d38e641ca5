"""Run one trial: a backend, a controller and a recorder on one bus, from start to end."""

from collections.abc import Callable
from pathlib import Path

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of, create_backend, create_task
from imolo.contracts.planner import Controller
from imolo.contracts.trial import EventName, Trial
from imolo.errors import TrialVoidError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import Recorder
from imolo_msgs import actuator_command_t, robot_t, trial_event_t

SLICE = 1000  # [µs] between two looks at the bus; commands take effect no later than this after their frame


class Bystander:
    """The controller of a trial in which the robot only watches."""

    def attach(self, bus: Bus) -> None:
        """Join the bus, to say nothing."""


def run_trial(
    config: ExperimentConfig,
    trial: Trial,
    controller: Controller,
    log_path: Path,
    duration: float,
    after_slice: Callable[[int], None] | None = None,
) -> float:
    """Run a trial in lock-step and record all of it.

    The trial ends a while after the event that ends its task, and at `duration` at the latest.

    Args:
        config: Names the backend and everything around it.
        trial: Which one.
        controller: What commands the robot.
        log_path: Log to write; complete up to the last message even if the trial fails.
        duration: Longest time [s].
        after_slice: Told the time of the backend after each slice [µs]; may wait, publish, or break the trial off.

    Returns:
        Duration of the trial [s].

    Raises:
        BackendError: The backend refused the scene, or diverged.
        BusError: The log cannot be written.
        TrialVoidError: The trial was broken off, or another program takes part in it; the log ends with the reason.
    """
    bus = Bus(config.bus)
    backend, task = create_backend(config), create_task(config)
    end, alone = round(duration * 1e6), True

    def shorten(event: trial_event_t) -> None:
        nonlocal end
        if task.ends(event):
            end = min(end, event.utime + round(config.campaign.tail * 1e6))

    def break_off(message: actuator_command_t | trial_event_t) -> None:
        nonlocal alone
        if not alone:
            return  # the end is still to be said
        alone = False
        what = "commands the robot" if isinstance(message, actuator_command_t) else "plays a trial"
        raise TrialVoidError(f"another program {what} on the bus {config.bus}; stop it, or give it another bus")

    with Recorder(bus, log_path, lambda: backend.utime):
        # Before the backend hears it, which would follow.
        bus.subscribe_foreign(channels.ACTUATOR_COMMAND, break_off)
        bus.subscribe_foreign(channels.TRIAL, break_off)
        bus.subscribe(channels.TRIAL, shorten)
        controller.attach(bus)
        backend.start(bus, trial)
        try:
            bus.publish(channels.TRIAL, _event(config, trial, EventName.START, backend.utime))
            bus.publish(channels.ROBOT, describe_robot(config, backend.utime))
            bus.drain()
            while backend.utime < end:
                backend.advance(min(backend.utime + SLICE, end))
                bus.drain()
                if after_slice is not None:
                    after_slice(backend.utime)
                    bus.drain()
            # A clock on the wall may have passed the end while the controller computed: what happened must be heard.
            backend.advance(end)
            bus.publish(channels.TRIAL, _event(config, trial, EventName.END, backend.utime))
            bus.settle(channels.TRIAL)
        except TrialVoidError as void:
            event = _event(config, trial, EventName.END, backend.utime)
            event.detail += f"; void: {void}"
            bus.publish(channels.TRIAL, event)
            _hear_out(bus)
            raise
        finally:
            backend.close()
            bus.close()
    return backend.utime * 1e-6


def _hear_out(bus: Bus) -> None:
    """Handle what a void trial still has to say; a second reason changes nothing."""
    while True:
        try:
            return bus.settle(channels.TRIAL)
        except TrialVoidError:
            continue


def describe_robot(config: ExperimentConfig, utime: int) -> robot_t:
    """Return what the numbers of the messages mean with the robot of a config."""
    body = body_of(config.robot)
    actuators, parameters = config.simulation.actuators.channels, config.motion.parameters
    message = robot_t()
    message.utime = utime
    message.robot_name, message.task_name = config.robot.name, config.task.name
    message.num_channels = len(actuators)
    message.channel_name = [channel.name for channel in actuators]
    message.channel_unit = [channel.unit for channel in actuators]
    message.channel_low = [channel.low for channel in actuators]
    message.channel_high = [channel.high for channel in actuators]
    message.channel_rest = [channel.rest for channel in actuators]
    message.channel_released = [channel.released for channel in actuators]
    message.num_robot_joints, message.joint_name = len(body.joint_names), list(body.joint_names)
    message.joint_unit = [joint.unit for joint in body.joints]
    message.num_robot_parameters = len(parameters)
    message.parameter_name = [parameter.name for parameter in parameters]
    message.parameter_unit = [parameter.unit for parameter in parameters]
    message.num_robot_effectors = len(body.effectors)
    message.effector_name = [effector.name for effector in body.effectors]
    message.effector_label = [body.effector_marker(index) for index in range(len(body.effectors))]
    message.num_robot_markers = len(body.markers)
    message.marker_label = [marker.marker_id for marker in body.markers]
    message.marker_name = [marker.name for marker in body.markers]
    return message


def _event(config: ExperimentConfig, trial: Trial, name: EventName, utime: int) -> trial_event_t:
    event = trial_event_t()
    event.utime = utime
    event.trial = trial.index
    event.event = name.value
    event.robot = config.robot.name
    event.backend = config.backend.name
    event.detail = f"{trial.kind.value}, seed {trial.seed}"
    return event
