"""The robot as a backend: valve board and cameras on the network, and the clock on the wall.

It speaks the streams of the simulations, so that planner, recorder and metrics do not notice. What a simulation knows
and a robot cannot, the contact of ball and arm, is told from the cameras.
"""

import gc
import logging
import os
import select
import socket
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of
from imolo.config.model import Model, NonNegative, Positive
from imolo.contracts.backend import Backend, BackendPlugin
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.errors import BackendError, MessageError, NatNetError, TrialVoidError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.method.commands import Commands, to_microseconds
from imolo_drivers.address import parse_address
from imolo_drivers.board.board import BoardState
from imolo_drivers.board.client import BoardClient, LinkLostError
from imolo_drivers.board.handshake import ClientRole
from imolo_drivers.board.secret import read_secret
from imolo_drivers.board.server import PORT, monotonic_utime
from imolo_drivers.exposure_guard import ExposureGuard, ExposureLimits
from imolo_drivers.hit_detector import HitDetector, HitDetectorConfig
from imolo_drivers.marker_guard import MarkerGuard, MarkerGuardConfig
from imolo_drivers.natnet.calibration import Calibration
from imolo_drivers.natnet.client import LATE_FRAMES, NatNetClient
from imolo_drivers.natnet.config import NatNetConfig
from imolo_drivers.natnet.markers import Labels, find_labels, mocap_frame
from imolo_drivers.natnet.messages import Frame
from imolo_msgs import actuator_command_t, actuator_state_t, board_state_t, mocap_frame_t, trial_event_t

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

LIFE_SIGN = 20_000  # [µs] between two signs of life to the board, a fifth of its watchdog time
ASK_AFTER = 1.0  # [s] without being armed until a person is asked to


class HardwareOptions(Model):
    """Options of the robot; the defaults reach `imolo emulate` on this machine."""

    board: str = Field(f"127.0.0.1:{PORT}", description="HOST or HOST:PORT of the valve board")
    secret: Path | None = Field(None, description="file of mode 0600 with the secret that the board has, too")
    dry_run: bool = Field(False, description="do everything but move: the board keeps its valves vented")
    patience: Positive = Field(5.0, description="for board and cameras to answer before a trial [s]")
    arm_patience: Positive = Field(300.0, description="for a person to arm before a trial [s]")
    board_silence: Annotated[float, Field(ge=0.05)] = Field(
        0.2, description="without pressures for longer a trial is void [s], assumed: twice the watchdog time"
    )
    clock_jump: Positive = Field(
        0.002, description="of the board's clock that voids a trial [s], assumed: two switches"
    )
    cameras: NatNetConfig = NatNetConfig()
    calibration: Path | None = Field(
        None, description="YAML that ties the cameras' frame to ours, see docs/hardware.md; none: axes turned alone"
    )
    camera_latency: NonNegative = Field(
        0.005, description="exposure to arrival where the cameras do not tell the exposure [s], assumed"
    )
    camera_patience: Positive = Field(
        0.25, description="without frames for longer a trial is void [s], assumed: the tracker's patience"
    )
    exposures: ExposureLimits = ExposureLimits()
    markers: MarkerGuardConfig = MarkerGuardConfig()
    landed_margin: NonNegative = Field(0.004, description="above its height when it stands, of a foot that lands [m]")
    hits: HitDetectorConfig = HitDetectorConfig()


class HardwareBackend:
    """Runs one trial on the robot, in real time; the clock begins when the robot is armed."""

    def __init__(self, config: ExperimentConfig, options: HardwareOptions) -> None:
        """Prepare; nothing is connected before `start`.

        Raises:
            ConfigError: The address of the board cannot be read.
            CalibrationError: The calibration cannot be read.
        """
        self._config, self._options = config, options
        self._body = body_of(config.robot)
        self._channels = config.simulation.actuators.channels
        self._address = parse_address(options.board)
        self._calibration = Calibration.load(options.calibration) if options.calibration else Calibration()
        self._begin: int | None = None
        self._board: BoardClient | None = None
        self._cameras: NatNetClient | None = None
        self._labels: Labels = {}
        self._happened: set[EventName] = set()
        self._exposures = ExposureGuard(options.exposures, 0.0)
        self._guard = MarkerGuard(options.markers)
        self._wrong_labels = False
        self._detector = HitDetector(options.hits, config.tracker, self._body)
        self._pressure = actuator_state_t()
        self._asked = self._heard_board = 0
        self._newest_state = 0
        self._first_state = -1
        self._frame_number = self._newest_frame = 0  # in the trial, and as the cameras count
        self._onset: int | None = None
        self._cameras_lost = False

    @property
    def utime(self) -> int:
        """Time since the trial began [µs]."""
        return 0 if self._begin is None else monotonic_utime() - self._begin

    def start(self, bus: Bus, trial: Trial) -> None:
        """Connect to board and cameras, wait until a person has armed, and let the clock begin.

        Raises:
            BackendError: Board or cameras do not answer or do not fit, or nobody arms.
            NatNetError: The cameras cannot be understood.
            TrialVoidError: A fault or a person ended the arming before the clock began.
        """
        self._bus, self._trial = bus, trial
        self._detector.warm_up()
        # A collection takes longer than the robot's time between two frames; it can wait until the trial is over.
        gc.collect()
        gc.disable()
        try:
            self._connect()
            self._wait_for_the_person()
        except BaseException:
            self.close()
            raise
        bus.subscribe(channels.ACTUATOR_COMMAND, self._on_command)
        self._begin = self._heard_board = monotonic_utime()
        self._exposures = ExposureGuard(self._options.exposures, self._begin * 1e-6)

    def advance(self, until_utime: int) -> None:
        """Wait until `until_utime` [µs] and publish what comes meanwhile; returns early with every frame.

        Raises:
            TrialVoidError: Board or cameras are lost, the board has vented, or a clock has jumped.
        """
        board, cameras = self._links()
        try:
            while True:
                left = self._next_due(until_utime) - monotonic_utime()
                select.select([board.fileno(), cameras.fileno()], (), (), max(left * 1e-6, 0.0))
                self._hear_board(board)
                if self._hear_cameras(cameras) or self.utime >= until_utime:
                    return
        except LinkLostError as error:
            raise TrialVoidError(str(error)) from error
        except NatNetError as error:
            raise TrialVoidError(f"the cameras cannot be understood: {error}") from error

    def close(self) -> None:
        """Vent, and let board and cameras go."""
        gc.enable()
        board, self._board = self._board, None
        if board is not None:
            try:
                board.disarm("the end of the trial")
            except LinkLostError:
                pass  # the board has vented by itself
            finally:
                board.close()
        cameras, self._cameras = self._cameras, None
        if cameras is not None:
            counts = cameras.lost, cameras.unreadable, self._exposures.refused.total()
            logger.info("%d camera frames lost, %d packets unreadable, %d exposures refused", *counts)
            cameras.close()

    def _next_due(self, until_utime: int) -> int:
        """Return when there is something to do even if nothing comes [µs], such as to tell of a silence."""
        silence_limit, patience = self._options.cameras.silence_limit, self._options.camera_patience
        camera_limit = self._exposures.heard + (patience if self._cameras_lost else min(silence_limit, patience))
        return min(
            (self._begin or 0) + until_utime,
            self._asked + LIFE_SIGN,
            self._heard_board + to_microseconds(self._options.board_silence),
            int(camera_limit * 1e6) + 1,  # never too early, which would be once too often
        )

    def _links(self) -> tuple[BoardClient, NatNetClient]:
        if self._board is None or self._cameras is None:
            raise BackendError("the backend has not been started")
        return self._board, self._cameras

    def _connect(self) -> None:
        options = self._options
        name = f"imolo {os.getpid()} on {socket.gethostname()}"
        self._board = board = BoardClient(
            *(self._address, ClientRole.CONTROLLER, name, options.patience, options.dry_run),
            secret=read_secret(options.secret) if options.secret else b"",
        )
        if board.welcome.board_robot != self._config.robot.name:
            raise BackendError(
                f"the board at {options.board} moves robot {board.welcome.board_robot!r}, the config names "
                f"{self._config.robot.name!r}; set robot.name or connect to the right robot"
            )
        if board.welcome.num_board_channels != len(self._channels):
            raise BackendError(
                f"the board at {options.board} has {board.welcome.num_board_channels} channels, the robot "
                f"{len(self._channels)}"
            )
        board.synchronise()
        self._cameras = cameras = NatNetClient(options.cameras, _now)
        if not self._idle(lambda: cameras.definitions is not None and not cameras.is_lost(_now()), options.patience):
            raise BackendError(cameras.missing(options.patience))
        if cameras.definitions is not None:
            self._labels = find_labels(options.cameras.labels.of(self._body), cameras.definitions)

    def _wait_for_the_person(self) -> None:
        board, cameras = self._links()
        trial, announced = self._trial, board.welcome.controller_session
        board.announce(trial.kind.value, trial.index, trial.seed)
        if not self._idle(lambda: board.announced, self._options.patience):
            raise BackendError("the board does not confirm the trial")
        # In a throw the robot only watches.
        armed = partial(_is_armed, board, announced)
        if trial.kind is not TrialKind.THROW and not self._idle(armed, ASK_AFTER):
            logger.warning(
                "%s trial %d waits: bring the robot to its ready pose, then `imolo arm %s`",
                *(trial.kind.value, trial.index, self._options.board),
            )
            if not self._idle(armed, self._options.arm_patience):
                raise BackendError(f"nobody armed the robot for {self._options.arm_patience:g} s; see `imolo arm`")
        if not self._idle(lambda: not cameras.is_lost(_now()), self._options.patience):
            raise BackendError("the cameras stopped while the robot was made ready")

    def _idle(self, until: Callable[[], bool], patience: float) -> bool:
        """Keep both links alive until something is so, for `patience` [s] at most; return whether it is."""
        board = self._board
        end = _now() + patience
        while not until():
            if _now() > end:
                return False
            links = [link.fileno() for link in (board, self._cameras) if link is not None]
            select.select(links, (), (), LIFE_SIGN * 1e-6)
            if board is not None:
                self._ask_time(board)
                board.poll()
                if board.state.num_armed:
                    self._check_armed(board.state)
            if self._cameras is not None:
                self._cameras.poll()
        return True

    def _ask_time(self, board: BoardClient) -> None:
        now = monotonic_utime()
        if now - self._asked >= LIFE_SIGN:
            self._asked = now
            board.ask_time()

    def _hear_board(self, board: BoardClient) -> None:
        self._ask_time(board)
        for state in board.poll():
            self._tell_pressure(board, state)
        now = monotonic_utime()
        if len(board.refusals) > 0:
            refusal = board.refusals.popleft()
            logger.warning("the board refused (%s): %s", refusal.refusal_code, refusal.refusal_reason)
        if board.jumped > to_microseconds(self._options.clock_jump):
            raise TrialVoidError(f"the clock of the board jumped by {board.jumped / 1000:.1f} ms")
        if now - self._heard_board >= to_microseconds(self._options.board_silence):
            raise TrialVoidError(f"the board has been silent for {(now - self._heard_board) / 1000:.0f} ms")

    def _tell_pressure(self, board: BoardClient, state: board_state_t) -> None:
        self._heard_board = monotonic_utime()
        utime = state.measured_utime - self._shift(board)
        if utime > self._newest_state:
            self._newest_state = utime
            if self._first_state < 0:
                self._first_state = state.state_number
            pressure = self._pressure
            pressure.utime = utime
            pressure.state_sequence = state.state_number - self._first_state + 1
            pressure.num_measured = len(state.measured_value)
            pressure.measured = list(state.measured_value)
            self._bus.publish(channels.ACTUATOR_STATE, pressure)
        if state.started_utime and self._onset is not None:
            started = state.started_utime - self._shift(board)
            late = f"{started - self._onset} us after the commanded onset"
            self._announce_once(EventName.ONSET, started, np.zeros(3), late)
        self._check_armed(state)

    def _check_armed(self, state: board_state_t) -> None:
        if self._trial.kind is not TrialKind.THROW and state.board_state != BoardState.ARMED:
            name = BoardState(state.board_state).name.lower()
            raise TrialVoidError(f"the board is {name}: {state.state_cause}")

    def _hear_cameras(self, cameras: NatNetClient) -> bool:
        """Publish the frames that have come; return whether there are any."""
        frames = cameras.poll()
        now = _now()  # of no frame that came by then may the exposure be later
        told = [self._tell_frame(cameras, frame, now) for frame in frames]
        heard, options = self._exposures.heard, self._options
        silence = f"no camera frame for {1e3 * (now - heard):.0f} ms"
        if now < heard + options.cameras.silence_limit:
            self._cameras_lost = False
        elif not self._cameras_lost:
            self._cameras_lost = True
            logger.warning("%s at %d us", silence, self.utime)
        if now >= heard + options.camera_patience:
            raise TrialVoidError(silence + (f"; {self._exposures.problem}" if self._exposures.problem else ""))
        return any(told)

    def _tell_frame(self, cameras: NatNetClient, frame: Frame, now: float) -> bool:
        """Publish a frame; return whether its exposure can be true."""
        exposed, error = cameras.exposure_time(frame) or (_now() - self._options.camera_latency, 0.0)
        if not self._exposures.accept(exposed, error, now):
            if self._exposures.is_news:
                logger.warning("%s, at %d us; it is left out", self._exposures.problem, self.utime)
            return False
        utime = round(exposed * 1e6) - (self._begin or 0)
        message = mocap_frame(frame, utime, self._labels, self._calibration)
        message.frame_number = self._number(frame.number)
        self._guard.repair(message)
        if not self._wrong_labels and (self._guard.renamed or self._guard.removed):
            self._wrong_labels = True
            logger.warning("markers jumped to where others were at %d us; their labels are corrected", utime)
        self._bus.publish(channels.MOCAP, message)
        self._judge(message)
        return True

    def _number(self, number: int) -> int:
        """Number a frame of the trial from 1, frames that were lost included; a take in a loop is numbered on."""
        step, self._newest_frame = number - self._newest_frame, number
        self._frame_number += step if self._frame_number and 0 < step <= LATE_FRAMES else 1
        return self._frame_number

    def _judge(self, frame: mocap_frame_t) -> None:
        """Tell what the cameras show to have happened."""
        for event in self._detector.update(frame):
            self._announce_once(event.name, event.utime, event.position, event.detail)
        standing, margin = self._body.standing_markers, self._options.landed_margin
        for marker in frame.markers:
            if marker.marker_position[2] < standing.get(marker.marker_id, -np.inf) + margin:
                place = np.array(marker.marker_position)
                self._announce_once(EventName.ROBOT_LANDED, frame.utime, place, f"marker {marker.marker_id}")

    def _on_command(self, message: actuator_command_t) -> None:
        """Send commands to the board, on its clock."""
        board, _ = self._links()
        shift = self._shift(board)
        try:
            commands = Commands.from_message(message, self._channels)
            onset, switches = commands.onset_utime + shift, tuple(time + shift for time in commands.switch_utime)
            shifted = Commands(onset, switches, commands.targets)
            board.command(shifted.to_message(message.utime + shift, message.command_sequence))
        except (MessageError, struct.error) as error:
            logger.warning("refused a valve command at %d us: %s", message.utime, error)
        except LinkLostError as error:
            raise TrialVoidError(str(error)) from error
        else:
            self._onset = commands.onset_utime

    def _shift(self, board: BoardClient) -> int:
        """Return the clock of the board less that of the trial [µs]."""
        return (self._begin or 0) + board.offset.utime

    def _announce_once(self, event: EventName, utime: int, position: Array, detail: str) -> None:
        if event in self._happened:
            return
        self._happened.add(event)
        message = trial_event_t()
        message.utime, message.trial, message.event = utime, self._trial.index, event.value
        message.robot, message.backend = self._config.robot.name, self._config.backend.name
        message.event_position = position.tolist()
        message.detail = detail
        self._bus.publish(channels.TRIAL, message)


def _is_armed(board: BoardClient, session: int) -> bool:
    return bool(board.state.armed_session == session)


def _now() -> float:
    """Return the clock that nobody sets [s]."""
    return monotonic_utime() * 1e-6


def _create(config: ExperimentConfig, options: Model) -> Backend:
    return HardwareBackend(config, HardwareOptions.model_validate(options.model_dump()))


BACKEND = BackendPlugin(
    summary="the robot, by TCP and NatNet", options=HardwareOptions, create=_create, simulated=False
)
