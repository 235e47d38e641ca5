"""The trainer: plays one motion, so that the robot can learn from it (Sec. IV-A)."""

from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.method.commands import Commands, to_microseconds
from imolo.method.motion import MotionTemplate, Theta
from imolo_msgs import mocap_frame_t, plan_t

# After the first frame [s]. A ball comes half a second after the start, when the robot has long settled into its ready
# pose. Motions learned at 0.02 s ended up to 20 or 30 mm from those; from 0.3 s on they agree to 1.5 mm
# (docs/transfer.md).
ONSET_DELAY = 0.3
START_MARGIN = ONSET_DELAY + 0.08  # [s] more than to the onset and from the last sample to its arrival


class MotionPlayer:
    """Starts the motion of a given theta at the first mocap frame and tells it in PLAN, as the planner does."""

    def __init__(self, template: MotionTemplate, theta: Theta) -> None:
        """Prepare a motion.

        Raises:
            ConfigError: Theta is out of range.
        """
        self._template = template
        self._theta = theta
        self._commands: Commands | None = None
        self._sequence = 0
        template.commands(theta, 0)

    def attach(self, bus: Bus) -> None:
        """Join the bus."""
        self._bus = bus
        bus.subscribe(channels.MOCAP, self._on_frame)

    def _on_frame(self, frame: mocap_frame_t) -> None:
        if self._commands is None:
            self._commands = self._template.commands(self._theta, frame.utime + to_microseconds(ONSET_DELAY))
        self._sequence += 1
        self._bus.publish(channels.ACTUATOR_COMMAND, self._commands.to_message(frame.utime, self._sequence))
        plan = plan_t()
        plan.utime = frame.utime
        plan.answered_frame = frame.frame_number
        plan.state = plan_t.STARTED if self._sequence == 1 else plan_t.KEPT
        plan.num_parameters, plan.theta = len(self._theta), list(self._theta)
        plan.effector = 0
        plan.plan_onset_utime = self._commands.onset_utime
        plan.hit_utime = self._commands.onset_utime + to_microseconds(self._template.swing_of(self._theta))
        self._bus.publish(channels.PLAN, plan)
