"""The planner at the other end of the network, as the controller of a trial.

Backend and recorder of a trial are on a bus of their own, as in a single process; these controllers carry the backend's
messages to the network and the planner's messages back. So a trial in lock-step is the same to the byte, and in either
mode a trial's log is judged by the same code.
"""

import struct
import time
from abc import ABC, abstractmethod
from typing import Any, NoReturn

import numpy as np

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import create_task
from imolo.contracts.trial import EventName
from imolo.errors import TrialVoidError
from imolo.live.clock import Pace
from imolo.live.identity import Role
from imolo.live.lockstep import Asker
from imolo.live.node import Node
from imolo.live.program import Console, Stop
from imolo.live.streams import Latency, Streams
from imolo.messaging import channels
from imolo.messaging.bus import UNREADABLE, Bus
from imolo.messaging.channels import CHANNELS
from imolo.method.commands import Commands
from imolo.trials.trial import SLICE
from imolo_msgs import actuator_command_t, trial_event_t

PLANNER_SAYS = (channels.ACTUATOR_COMMAND, channels.BALL_STATE, channels.PLAN)
UNANSWERED = 0.2  # [s] without an answer to any frame until a robot is vented, assumed: 24 frames
VENTED = 0.3  # [s] that a trial goes on without its planner, so that its log shows the pressures fall
_UTIME = struct.Struct(">8xq")  # behind the fingerprint


class RemotePlanner(ABC):
    """What lock-step and real time have in common.

    Attributes:
        streams: How the streams of the session do.
        latency: From a frame to its answer.
        frames: Number of frames so far.
        outcome: How the ball of this trial ended; empty as long as it flies.
        lost: How this trial lost its planner and went on without; empty where it did not.
    """

    paced = False

    def __init__(self, config: ExperimentConfig, bus: Bus, node: Node, stop: Stop, console: Console) -> None:
        """Join the network; `begin` and `attach` follow for every trial."""
        self._task = create_task(config)
        self._channels = config.simulation.actuators.channels
        self.streams, self.latency = Streams(), Latency()
        self.frames = 0
        self.outcome = self.lost = ""
        self._bus, self._node, self._stop, self._console = bus, node, stop, console
        self._asker = Asker(bus, node.instance, self._watch)
        self._inside: Bus | None = None
        self._planner = 0
        self._void = ""

    def begin(self) -> None:
        """Prepare for the next trial.

        Raises:
            TrialVoidError: There is no planner.
        """
        planner = self._node.peer(Role.PLANNER)
        if planner is None:
            raise TrialVoidError("there is no planner")
        self._planner = planner.instance
        self._void = self.outcome = self.lost = ""
        self.streams.begin_trial()

    def attach(self, bus: Bus) -> None:
        """Join the bus of the trial."""
        self._inside = bus
        bus.subscribe_raw(self._relay)

    def leave(self) -> None:
        """Leave the bus of the trial."""
        self._inside = None

    @abstractmethod
    def after_slice(self, utime: int) -> None:
        """Look after the network between two slices of a trial that is at `utime` [µs].

        Raises:
            TrialVoidError: The trial cannot go on.
        """

    @abstractmethod
    def describe(self) -> str:
        """Return how the clock does, in words."""

    @abstractmethod
    def _relay(self, channel: str, data: bytes) -> None:
        """Carry a message of the trial to the network."""

    def _on_event(self, data: bytes) -> None:
        event = trial_event_t.decode(data)
        if self._task.ends(event) and not self.outcome:
            self.outcome = f"{event.event} at {event.utime * 1e-6:.3f} s, {event.detail}"
        if event.event == EventName.END:
            try:
                self._ask(channels.TRIAL, data)
            except TrialVoidError:
                # All that the planner could have said has been heard.
                self._console.say("the planner did not hear the end of the trial")
        elif event.event == EventName.START or not self.paced:
            self._ask(channels.TRIAL, data, event.event == EventName.START)

    def _ask(self, channel: str, data: bytes, first: bool = False) -> None:
        """Ask the planner and let the trial hear what it says."""
        if self._void or self._inside is None:
            return  # what is left of a trial that was broken off
        begin = time.perf_counter()
        try:
            answers = self._asker.ask(self._planner, channel, data, first, self.paced)
        except TrialVoidError as void:
            self._void = str(void)
            raise
        if channel == channels.MOCAP:
            self.latency.add(time.perf_counter() - begin)
        for said, message in answers:
            if said not in PLANNER_SAYS:
                self._give_up(f"the planner speaks on {said!r}; it may on {', '.join(PLANNER_SAYS)}")
            self._inside.publish_raw(said, message)

    def _watch(self) -> None:
        """Keep the heart beating; break the trial off if it cannot go on."""
        self._node.tend()
        if self._stop:
            self._give_up("stopped by the user")
        if lost := self._planner_lost():
            self._give_up(lost)

    def _give_up(self, reason: str) -> NoReturn:
        self._void = reason
        raise TrialVoidError(reason)

    def _planner_lost(self) -> str:
        return "" if self._node.works_with(Role.PLANNER, self._planner) else "the planner was lost"


class LockstepPlanner(RemotePlanner):
    """The trial stands still until the planner has answered."""

    def after_slice(self, utime: int) -> None:
        """Hear the network, then go on at once."""
        self._bus.wait(0.0)
        self._watch()

    def describe(self) -> str:
        """Return how often the planner had to be asked again."""
        return f"lock-step, {self._asker.resent} of {self._asker.asked} questions asked again"

    def _relay(self, channel: str, data: bytes) -> None:
        self._bus.publish_raw(channel, data)
        self.streams.count(channel, data)
        if channel == channels.TRIAL:
            self._on_event(data)
        elif channel == channels.MOCAP:
            self.frames += 1
            self._ask(channel, data)


class RealtimePlanner(RemotePlanner):
    """The trial waits for the clock on the wall alone.

    Where its planner is lost, or another program commands as well, the robot is vented and the trial void.

    Attributes:
        pace: How well the backend keeps up.
        late_frames: Number of frames that were sent after their time.
        ignored: Number of commands that answer no frame of their trial, or cannot be read.
    """

    paced = True

    def __init__(self, config: ExperimentConfig, bus: Bus, node: Node, stop: Stop, console: Console) -> None:
        """Join the network; `begin` and `attach` follow for every trial."""
        super().__init__(config, bus, node, stop, console)
        self.pace = Pace(bus.wait)
        self.late_frames = self.ignored = 0
        self._utime = 0
        self._vented: int | None = None
        self._command: actuator_command_t | None = None
        self._answered = 0.0
        self._sent: dict[int, float] = {}
        bus.subscribe_newest(channels.ACTUATOR_COMMAND, self._on_command, self._count_skipped)
        for channel in (channels.BALL_STATE, channels.PLAN):
            bus.subscribe_raw(self._on_reason, channel)

    def begin(self) -> None:
        """Prepare for the next trial."""
        super().begin()
        self.pace.restart()
        self._utime, self._vented, self._command = 0, None, None
        self._sent = {}

    def after_slice(self, utime: int) -> None:
        """Wait for the clock on the wall, and hear the network meanwhile."""
        self.pace.hold(utime)
        self._utime = utime
        self._node.tend()
        if self._stop:
            self._give_up("stopped by the user")
        if self._vented is None:
            lost = self._planner_lost()
            if lost:
                self._vent(utime, lost)
        elif utime >= self._vented + round(VENTED * 1e6):
            self._give_up(self.lost)

    def _planner_lost(self) -> str:
        if self.lost:
            return self.lost
        silence = time.perf_counter() - self._answered
        if self._sent and silence > UNANSWERED:
            return f"the planner has not answered a frame for {silence:.1f} s"
        return super()._planner_lost()

    def describe(self) -> str:
        """Return how many slices and frames were late."""
        pace = self.pace
        text = (
            f"real time, late {self.late_frames}/{self.frames} frames, {pace.overruns}/{pace.slices} slices "
            f"(worst {1e3 * pace.worst:.1f} ms), {pace.heavy} heavy, "
            f"busy {100.0 * pace.computed / max(pace.played, 1e-3):.0f} %"
        )
        text += f", {self.ignored} commands refused" if self.ignored else ""
        return text + (f", {pace.lost:.1f} s lost" if pace.lost else "")

    def _relay(self, channel: str, data: bytes) -> None:
        if channel not in PLANNER_SAYS:  # which come from the network
            self._bus.publish_raw(channel, data)
            self.streams.count(channel, data)
        if channel == channels.TRIAL:
            self._on_event(data)
        elif channel == channels.MOCAP:
            self.frames += 1
            self.late_frames += self.pace.lateness(self._utime + SLICE) > 0.0
            now = time.perf_counter()
            self._answered = self._answered if self._sent else now
            self._sent[_UTIME.unpack_from(data)[0]] = now

    def _on_reason(self, channel: str, data: bytes) -> None:
        if self._inside is not None and self._answer_to_a_frame(channel, data) is not None:
            self._answered = time.perf_counter()
            self.streams.count(channel, data)
            self._inside.publish_raw(channel, data)

    def _on_command(self, channel: str, data: bytes) -> None:
        now = time.perf_counter()
        if self._inside is None or self._vented is not None or not self._is_from_our_planner(data):
            return
        command = self._answer_to_a_frame(channel, data)
        if command is None:
            self.ignored += 1
            return
        self.streams.count(channel, data)
        self.latency.add(now - self._sent[command.utime])
        self._command = command
        self._inside.publish_raw(channel, data)

    def _count_skipped(self, data: bytes) -> None:
        if self._inside is None or self._vented is not None or self._is_from_our_planner(data):
            self.streams.count(channels.ACTUATOR_COMMAND, data)

    def _is_from_our_planner(self, data: bytes) -> bool:
        """Return whether a command is the planner's; one of somebody else ends the trial, whatever it commands."""
        command = self._read(channels.ACTUATOR_COMMAND, data)
        if command is not None and command.commander != self._planner:
            self.lost = self.lost or (
                f"stop the other program on this bus, or give another --bus: commander {command.commander} commands "
                f"the robot beside planner {self._planner}"
            )
        return not self.lost

    def _answer_to_a_frame(self, channel: str, data: bytes) -> Any | None:
        """Return a message that belongs to this trial, None for one that does not: every trial begins at 0 again."""
        message = self._read(channel, data)
        return message if message is not None and message.utime in self._sent else None

    def _read(self, channel: str, data: bytes) -> Any | None:
        try:
            return CHANNELS[channel].message_type.decode(data)
        except UNREADABLE:
            self._bus.pass_over(channel)
            return None

    def _vent(self, utime: int, lost: str) -> None:
        """Let the air out of a robot in motion; one at rest stays at rest."""
        self._vented, self.lost = utime, lost
        if self._command is None or self._inside is None:
            self._console.say(f"{lost} at {utime * 1e-6:.3f} s; the robot is at rest and stays so")
            return
        released = np.array([[channel.released for channel in self._channels]])
        newer = self._command.command_sequence + 1
        vent = Commands(utime - 1, (utime,), released).to_message(utime, newer, self._planner)
        self._inside.publish(channels.ACTUATOR_COMMAND, vent)
        self._bus.publish(channels.ACTUATOR_COMMAND, vent)
        self._console.say(f"{lost} at {utime * 1e-6:.3f} s; all channels are released")
