"""The valve board without its sockets: who may move the robot, what its valves are given, and when they vent.

A state machine that is told the time, so that it can be tried with any clock. The board starts vented. A person arms
the session of one controller; from then on the valves hold their rest targets until commands come. Whatever loses
control vents and latches: silence of the link, of the planner while a motion runs, a clock that goes back, a broken
converter.
"""

import math
from collections.abc import Sequence
from enum import IntEnum

from imolo.errors import BackendError
from imolo.method.commands import to_microseconds
from imolo_drivers.board.command import Motion, Targets, clamp, is_newer, read_command, slew
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.refusal import RefusalCode, RefusedError
from imolo_drivers.board.sensor_reader import Reading
from imolo_drivers.board.valve_io import ValveIO
from imolo_msgs import actuator_command_t, board_state_t

NEVER = 2**62  # [µs]
SLEW_INTERVAL = 1000  # [µs] between two steps of a target that may not jump
VENT_EARLY = 0.1  # of the watchdog time before it is over, so that a late wake-up still vents within it


class BoardState(IntEnum):
    """Whether the valves follow commands."""

    VENTED = board_state_t.VENTED
    ARMED = board_state_t.ARMED
    LATCHED = board_state_t.LATCHED


class Board:
    """Holds the newest commands of the one controller and gives the valves their targets.

    Attributes:
        state: Whether the valves follow commands.
        cause: Why they do not; empty while they do.
        entered: Since when that is so [µs].
        session: Connection of the controller; 0 if there is none.
        dry_run: Whether nothing moves in this session.
    """

    def __init__(self, config: BoardConfig, valves: ValveIO, utime: int) -> None:
        """Vent.

        Args:
            config: Limits and times.
            valves: The wires.
            utime: Clock of the board [µs].
        """
        self.state, self.cause = BoardState.VENTED, "just started"
        self.session, self.dry_run = 0, config.dry_run
        self._config, self._valves = config, valves
        self._watchdog = to_microseconds(config.watchdog * (1.0 - VENT_EARLY))
        self._window = to_microseconds(config.time_window)
        self._vented: Targets = (0.0,) * len(config.channels)
        self._rest = clamp([channel.rest for channel in config.channels], config)
        self._slew_limit = [config.slew_limit(channel) for channel in config.channels]
        self._is_slewing = False
        self._utime = self._heard = self.entered = utime
        self._message = self._new_message()
        self._given: Sequence[float] | None = None
        self._motion: Motion | None = None
        self._fed = 0
        self.tick(utime)

    def connect(self, session: int, dry_run: bool, utime: int) -> None:
        """Accept a controller; nothing moves before a person arms its session.

        Raises:
            RefusedError: There is another one.
        """
        if self.session:
            raise RefusedError(RefusalCode.BUSY, "another controller is connected; one at a time")
        self.session, self._heard = session, utime
        self.dry_run = dry_run or self._config.dry_run
        self._message = self._new_message()

    def disconnect(self, utime: int, cause: str) -> None:
        """Vent, the controller being gone; latch if it did not disarm before."""
        self.session = 0
        if self.state is BoardState.ARMED:
            self.latch(utime, cause)

    def arm(self, session: int, utime: int) -> None:
        """Let a person allow the controller of this session to move the robot.

        Raises:
            RefusedError: It is not the session of the connected controller.
        """
        if not self.session:
            raise RefusedError(RefusalCode.SESSION, "there is no controller to arm; start it first")
        if session != self.session:
            raise RefusedError(RefusalCode.SESSION, "the controller has connected anew meanwhile; look again, then arm")
        # An operator who arms once more must not stand in for a controller that has fallen silent.
        if self.state is not BoardState.ARMED:
            self._forget_motion()
            self.state, self.cause, self.entered = BoardState.ARMED, "", utime
            self._message.num_armed += 1
            self.heard(utime)
        self.tick(utime)

    def disarm(self, utime: int, cause: str) -> None:
        """Vent because somebody wants it."""
        if self.state is BoardState.ARMED:
            self._vent(BoardState.VENTED, utime, cause)

    def latch(self, utime: int, cause: str) -> None:
        """Vent because of a fault, and stay so until a person arms again."""
        self._vent(BoardState.LATCHED, utime, cause)

    def heard(self, utime: int) -> None:
        """Note a frame of the controller; it shows that the link is there, and feeds no motion."""
        self._heard = utime

    def command(self, message: actuator_command_t, utime: int) -> None:
        """Follow commands from now on; the newest ones win.

        Raises:
            RefusedError: They cannot or must not be followed; those in force go on, and the watchdog is not fed.
        """
        try:
            motion = self._check(message, utime)
        except RefusedError:
            self._message.num_refused += 1
            raise
        self._message.num_clamped += motion.is_clamped
        self._motion, self._fed = motion, utime
        self._message.accepted_sequence, self._message.accepted_utime = message.command_sequence, utime
        self.tick(utime)

    def sense(self, reading: Reading, utime: int) -> None:
        """Take what the sensors said; without an answer of theirs nothing moves."""
        if reading.fault or len(reading.measured) not in (0, len(self._vented)):
            self.latch(utime, reading.fault or f"the sensors told {len(reading.measured)} values")
        self._message.measured_utime = reading.utime
        measured = reading.measured if len(reading.measured) == len(self._vented) else [math.nan] * len(self._vented)
        self._message.measured_value = measured

    def tick(self, utime: int) -> None:
        """Do what is due at `utime` [µs]: watch, switch, and give the valves their targets."""
        if utime < self._utime:
            self.latch(utime, f"the clock of the board went back by {self._utime - utime} us")
        elapsed, self._utime = max(utime - self._utime, 0), utime
        self._watch(utime)
        wanted, given = self._target(utime), self._message.given_target
        if wanted != given:
            steps = [limit * elapsed * 1e-6 if limit else math.inf for limit in self._slew_limit]
            wanted, reached = slew(wanted, given, steps), wanted
            self._is_slewing = wanted != reached
        self._give(wanted)

    def next_due(self) -> int:
        """Return when `tick` has something to do next [µs]; `NEVER` if nothing is planned."""
        if self.state is not BoardState.ARMED:
            return NEVER
        due = self._heard + self._watchdog + 1
        if self._is_slewing:
            due = min(due, self._utime + SLEW_INTERVAL)
        if self._motion is not None and self._utime < self._motion.end_utime:
            due = min(due, self._fed + self._watchdog + 1, self._motion.next_change(self._utime))
        return due

    def tell(self) -> board_state_t:
        """Return the state; the same message every time."""
        message = self._message
        message.state_number += 1
        message.board_state, message.state_cause, message.entered_utime = self.state, self.cause, self.entered
        message.armed_session = self.session if self.state is BoardState.ARMED else 0
        return message

    def _new_message(self) -> board_state_t:
        message = board_state_t()
        message.num_state_channels = len(self._vented)
        message.given_target, message.measured_value = self._vented, [math.nan] * len(self._vented)
        return message

    def _check(self, message: actuator_command_t, utime: int) -> Motion:
        if self.state is not BoardState.ARMED:
            raise RefusedError(RefusalCode.NOT_ARMED, f"the board is {self.state.name.lower()}: {self.cause}")
        newest = self._message.accepted_sequence
        if self._motion is not None and not is_newer(message.command_sequence, newest):
            reason = f"command {message.command_sequence} is not newer than {newest}, which is in force"
            raise RefusedError(RefusalCode.STALE, reason)
        motion = read_command(message, self._config)
        for time in (motion.onset_utime, motion.end_utime):
            if abs(time - utime) > self._window:
                raise RefusedError(
                    RefusalCode.TIMES,
                    f"the command speaks of {time} us, but it is {utime} us; give times on the clock of the board",
                )
        return motion

    def _watch(self, utime: int) -> None:
        if self.state is not BoardState.ARMED:
            return
        silent, limit = utime - self._heard, self._watchdog
        unfed = utime - self._fed if self._motion is not None and utime < self._motion.end_utime else 0
        if unfed > limit:
            self.latch(utime, f"no valid command for {unfed / 1000:.1f} ms while a motion ran")
        elif silent > limit:
            self.latch(utime, f"nothing heard of the controller for {silent / 1000:.1f} ms")

    def _target(self, utime: int) -> Targets:
        message, motion = self._message, self._motion
        if self.state is not BoardState.ARMED:
            return self._vented
        if motion is None or utime < motion.onset_utime:
            return self._rest
        phase = motion.phase(utime)
        if phase != message.phase_in_force:
            message.phase_in_force, message.switched_utime = phase, utime
            message.started_utime = message.started_utime or utime
        return motion.target[phase - 1] if phase else self._vented

    def _vent(self, state: BoardState, utime: int, cause: str) -> None:
        if self.state is BoardState.LATCHED:
            return  # the first fault is the one to know
        self.state, self.cause, self.entered = state, cause, utime
        self._forget_motion()
        self._utime = utime
        self._give(self._vented)

    def _give(self, target: Targets) -> None:
        self._message.given_target = target
        real = self._vented if self.dry_run else target
        if real == self._given:
            return
        self._given = None
        try:
            self._valves.write(real)
        except BackendError as error:
            # Vents at the next tick, and again until it succeeds.
            self.state, self.cause, self.entered = BoardState.LATCHED, str(error), self._utime
            self._forget_motion()
            self._message.given_target = self._vented
        else:
            self._given = real

    def _forget_motion(self) -> None:
        self._motion, self._is_slewing = None, False
        message = self._message
        message.phase_in_force = message.accepted_sequence = 0
        message.started_utime = message.switched_utime = message.accepted_utime = 0
