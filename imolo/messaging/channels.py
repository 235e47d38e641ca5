"""The one table of channels: who says what to whom, and how often."""

from dataclasses import dataclass
from typing import Any

import imolo_msgs

ACTUATOR_COMMAND = "ACTUATOR_COMMAND"
ACTUATOR_STATE = "ACTUATOR_STATE"
ROBOT = "ROBOT"
MOCAP = "MOCAP"
BALL_STATE = "BALL_STATE"
PLAN = "PLAN"
TRIAL = "TRIAL"
TRUTH_ROBOT = "TRUTH_ROBOT"
TRUTH_BALL = "TRUTH_BALL"
HEARTBEAT = "HEARTBEAT"
STEP_REQUEST = "STEP_REQUEST"
STEP_ANSWER = "STEP_ANSWER"
THROW_REQUEST = "THROW_REQUEST"
THROW_REPORT = "THROW_REPORT"


@dataclass(frozen=True)
class Channel:
    """A channel of the bus.

    Attributes:
        name: At most 63 characters, the limit of LCM.
        message_type: Generated class of its messages.
        rate: How often it speaks, in words.
        sender: Who publishes on it.
    """

    name: str
    message_type: type[Any]
    rate: str
    sender: str


def _by_name(*channels: Channel) -> dict[str, Channel]:
    return {channel.name: channel for channel in channels}


STREAMS = _by_name(
    Channel(ROBOT, imolo_msgs.robot_t, "the start of every trial", "runner"),
    Channel(
        ACTUATOR_COMMAND, imolo_msgs.actuator_command_t, "every mocap frame while a motion runs", "planner, trainer"
    ),
    Channel(ACTUATOR_STATE, imolo_msgs.actuator_state_t, "1 kHz (config)", "backend"),
    Channel(MOCAP, imolo_msgs.mocap_frame_t, "120 Hz (config)", "backend"),
    Channel(BALL_STATE, imolo_msgs.ball_state_t, "every mocap frame with a flying ball", "planner"),
    Channel(PLAN, imolo_msgs.plan_t, "every mocap frame", "planner"),
    Channel(TRIAL, imolo_msgs.trial_event_t, "events", "runner, backend"),
    Channel(TRUTH_ROBOT, imolo_msgs.truth_robot_t, "240 Hz (config)", "simulated backend"),
    Channel(TRUTH_BALL, imolo_msgs.truth_ball_t, "240 Hz (config)", "simulated backend"),
)
"""What every trial speaks, in one process or in many; a log holds nothing else."""

SESSION = _by_name(
    Channel(HEARTBEAT, imolo_msgs.heartbeat_t, "10 Hz", "every program of a session"),
    Channel(STEP_REQUEST, imolo_msgs.step_request_t, "every frame in lock-step, every start of a trial", "backend"),
    Channel(STEP_ANSWER, imolo_msgs.step_answer_t, "every step_request_t", "planner"),
    Channel(THROW_REQUEST, imolo_msgs.throw_request_t, "until reported", "imolo throw"),
    Channel(THROW_REPORT, imolo_msgs.throw_report_t, "events", "backend"),
)
"""What the programs of a live session say to each other beside it, see docs/live.md."""

CHANNELS = STREAMS | SESSION
