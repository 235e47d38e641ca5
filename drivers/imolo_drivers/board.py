"""The valve board without its sockets: who may move the robot, what its valves are given, and when they vent.

A state machine that is told the time, so that it can be tried with any clock. The board starts vented. A person arms
the session of one controller; from then on the valves hold the rest pressures until commands come. Whatever loses
control vents and latches: silence of the link, of the planner while a motion runs, a clock that goes back, a broken
converter.
"""

from collections.abc import Sequence
from enum import IntEnum, StrEnum
from typing import Annotated

from pydantic import Field

from imolo.config.model import Model, NonNegative, Positive
from imolo.config.simulation import EightPressures, PneumaticsConfig
from imolo.errors import BackendError, ImoloError, MessageError
from imolo.method.commands import Commands, to_microseconds
from imolo_drivers.valve_io import NUM_VALVES, SUPPLY_PRESSURE, IioConfig, ValveIO
from imolo_msgs import actuator_command_t, board_state_t

VENTED_PRESSURE = (0.0,) * NUM_VALVES
NEVER = 2**62  # [µs]
VENT_MARGIN = 2000  # [µs] before the watchdog time is over, so that a late wake-up still vents within it


class BoardConfig(Model):
    """How the valve board keeps its robot safe."""

    name: str = Field("valve board", description="told to whoever connects")
    robot: str = Field("liberobot", description="told to whoever connects; a table of another robot is refused there")
    watchdog: Annotated[float, Field(ge=0.01, le=1.0)] = Field(
        0.1,
        description="without a valid command in a motion or any frame while armed, vent and latch within this time [s]",
    )
    pressure_limit: Annotated[float, Field(gt=0.0, le=SUPPLY_PRESSURE)] = Field(
        SUPPLY_PRESSURE, description="higher targets are clamped [Pa]; lower it for the first start"
    )
    rise_limit: NonNegative = Field(
        0.0,
        description="fastest rise of a target [Pa/s], falling is never slowed; 0 for none; set it for the first start",
    )
    rest_pressure: EightPressures = Field(
        PneumaticsConfig().rest_pressure, description="valves 1..8 while armed and without a motion [Pa]"
    )
    time_window: Positive = Field(
        10.0, description="a command whose times are farther from the clock of the board is refused [s], assumed"
    )
    state_rate: Annotated[float, Field(gt=0.0, le=1000.0)] = Field(
        1000.0, description="of measured pressures and state [Hz]"
    )
    silence: Annotated[float, Field(ge=0.2)] = Field(
        1.0, description="a connection that says nothing is closed [s], assumed; frees the board of half-open ones"
    )
    dry_run: bool = Field(False, description="do everything but move: the valves stay vented")
    iio: IioConfig | None = Field(None, description="the converters; none: simulated valves that follow at once")


class BoardState(IntEnum):
    """Whether the valves follow commands."""

    VENTED = board_state_t.VENTED
    ARMED = board_state_t.ARMED
    LATCHED = board_state_t.LATCHED


class RefusalCode(StrEnum):
    """Why a frame is not followed."""

    VERSION = "version"
    TYPES = "types"
    ROLE = "role"
    BUSY = "busy"
    NOT_ARMED = "not_armed"
    SESSION = "session"
    VALUES = "values"
    TIMES = "times"
    STALE = "stale"
    FRAME = "frame"
    SILENCE = "silence"


class RefusedError(ImoloError):
    """The board does not do what it was asked."""

    def __init__(self, code: RefusalCode, reason: str) -> None:
        """Keep the code for programs and the reason for people."""
        super().__init__(reason)
        self.code = code


class Board:
    """Holds the newest commands of the one controller and gives the valves their targets.

    Attributes:
        state: Whether the valves follow commands.
        cause: Why they do not; empty while they do.
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
        self._watchdog = to_microseconds(config.watchdog) - VENT_MARGIN
        self._window = to_microseconds(config.time_window)
        self._utime = self._heard = utime
        self._message = board_state_t()
        self._given: Sequence[float] | None = None
        self._commands: Commands | None = None
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
        self._message = board_state_t()

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
        if self.state is not BoardState.ARMED:
            self._forget_motion()
            self.state, self.cause = BoardState.ARMED, ""
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
            commands = self._check(message, utime)
        except RefusedError:
            self._message.num_refused += 1
            raise
        if (commands.target_pressure > self._config.pressure_limit).any():
            self._message.num_clamped += 1
        self._commands, self._fed = commands, utime
        self._message.accepted_sequence, self._message.accepted_utime = message.command_sequence, utime
        self.tick(utime)

    def tick(self, utime: int) -> None:
        """Do what is due at `utime` [µs]: watch, switch, and give the valves their targets."""
        if utime < self._utime:
            self.latch(utime, f"the clock of the board went back by {self._utime - utime} us")
        elapsed, self._utime = max(utime - self._utime, 0), utime
        self._watch(utime)
        wanted = self._target(utime)
        if self._config.rise_limit > 0.0:
            step, given = self._config.rise_limit * elapsed * 1e-6, self._message.given_pressure
            wanted = tuple(min(new, old + step) for new, old in zip(wanted, given, strict=True))
        self._give(wanted)

    def next_due(self) -> int:
        """Return when `tick` has something to do next [µs]; `NEVER` if nothing is planned."""
        if self.state is not BoardState.ARMED:
            return NEVER
        due = self._heard + self._watchdog + 1
        if self._commands is not None and self._utime < self._commands.end_utime:
            changes = (self._commands.onset_utime, *self._commands.switch_utime)
            due = min(due, self._fed + self._watchdog + 1, next(time for time in changes if time > self._utime))
        return due

    def tell(self, utime: int) -> board_state_t:
        """Measure the pressures and return the state at `utime` [µs]; the same message every time."""
        message = self._message
        try:
            message.measured_pressure = list(self._valves.read())
        except BackendError as error:
            message.measured_pressure = [float("nan")] * NUM_VALVES
            self.latch(utime, str(error))
        message.measured_utime = utime
        message.state_number += 1
        message.board_state, message.state_cause = self.state, self.cause
        message.armed_session = self.session if self.state is BoardState.ARMED else 0
        return message

    def _check(self, message: actuator_command_t, utime: int) -> Commands:
        if self.state is not BoardState.ARMED:
            raise RefusedError(RefusalCode.NOT_ARMED, f"the board is {self.state.name.lower()}: {self.cause}")
        newest = self._message.accepted_sequence
        if self._commands is not None and message.command_sequence <= newest:
            reason = f"command {message.command_sequence} is not newer than {newest}, which is in force"
            raise RefusedError(RefusalCode.STALE, reason)
        try:
            commands = Commands.from_message(message)
        except MessageError as error:
            raise RefusedError(RefusalCode.VALUES, str(error)) from error
        for time in (commands.onset_utime, commands.end_utime):
            if abs(time - utime) > self._window:
                raise RefusedError(
                    RefusalCode.TIMES,
                    f"the command speaks of {time} us, but it is {utime} us; give times on the clock of the board",
                )
        return commands

    def _watch(self, utime: int) -> None:
        if self.state is not BoardState.ARMED:
            return
        silent, limit = utime - self._heard, self._watchdog
        unfed = utime - self._fed if self._commands is not None and utime < self._commands.end_utime else 0
        if unfed > limit:
            self.latch(utime, f"no valid command for {unfed / 1000:.1f} ms while a motion ran")
        elif silent > limit:
            self.latch(utime, f"nothing heard of the controller for {silent / 1000:.1f} ms")

    def _target(self, utime: int) -> Sequence[float]:
        message = self._message
        if self.state is not BoardState.ARMED:
            return VENTED_PRESSURE
        target = None if self._commands is None else self._commands.target(utime)
        if self._commands is None or target is None:
            return self._clamp(self._config.rest_pressure)
        phase = sum(time <= utime for time in self._commands.switch_utime) + 1
        phase = 0 if phase > len(self._commands.switch_utime) else phase
        if phase != message.phase_in_force:
            message.phase_in_force, message.switched_utime = phase, utime
            message.started_utime = message.started_utime or utime
        return self._clamp(target.tolist())

    def _clamp(self, pressure: Sequence[float]) -> Sequence[float]:
        limit = self._config.pressure_limit
        return tuple(min(value, limit) for value in pressure)

    def _vent(self, state: BoardState, utime: int, cause: str) -> None:
        if self.state is BoardState.LATCHED:
            return  # the first fault is the one to know
        self.state, self.cause = state, cause
        self._forget_motion()
        self._utime = utime
        self._give(VENTED_PRESSURE)

    def _give(self, pressure: Sequence[float]) -> None:
        self._message.given_pressure = list(pressure)
        real = VENTED_PRESSURE if self.dry_run else pressure
        if real == self._given:
            return
        self._given = None
        try:
            self._valves.write(real)
        except BackendError as error:
            # Vents at the next tick, and again until it succeeds.
            self.state, self.cause = BoardState.LATCHED, str(error)
            self._forget_motion()
            self._message.given_pressure = list(VENTED_PRESSURE)
        else:
            self._given = real

    def _forget_motion(self) -> None:
        self._commands = None
        message = self._message
        message.phase_in_force = message.accepted_sequence = 0
        message.started_utime = message.switched_utime = message.accepted_utime = 0
