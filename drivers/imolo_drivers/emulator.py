"""`imolo emulate`: board and Motive as seen from the network, with a simulated robot behind them in real time.

The board is the real program; only its converters lead into the simulation. In the place of the person who throws, the
emulator throws the ball of the trial that a controller announces, when the robot is armed.
"""

import gc
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import backend_options, backend_plugin, body_of
from imolo.contracts.backend import Backend
from imolo.contracts.robot import Body
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.errors import BackendError, DivergenceError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.method.commands import Commands
from imolo_drivers.board.board import BoardState
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.server import BoardServer, monotonic_utime
from imolo_drivers.natnet.calibration import Calibration
from imolo_drivers.natnet.config import NatNetServerConfig
from imolo_drivers.natnet.messages import (
    AssetDefinition,
    AssetMarkerDefinition,
    Frame,
    LabelledMarker,
    ModelDefinitions,
)
from imolo_drivers.natnet.server import NatNetServer
from imolo_msgs import actuator_state_t, board_trial_t, marker_t, mocap_frame_t, trial_event_t

logger = logging.getLogger(__name__)

MODEL_ID = 1  # of the robot in Motive
LONGEST_TURN = 0.001  # [s] of the simulation between two looks at the network
GIVE_UP = 0.1  # [s] behind the clock on the wall from which lost time is not made up for
FRAME_NUMBERS = 2**31  # that a packet can hold: 207 days at 120 Hz
FOREVER = 1_000_000_000  # [µs] for which the valves hold what they were given last
ARM_AFTER = 200_000  # [µs] a person takes longer
IDLE = Trial(TrialKind.TRAINING, 0, 0)  # the robot rests in its ready pose, and nobody throws


def definitions_of(body: Body) -> ModelDefinitions:
    """Return a robot as Motive describes it."""
    markers = tuple(AssetMarkerDefinition(one.name, 1 + one.marker_id, (0.0, 0.0, 0.0)) for one in body.markers)
    return ModelDefinitions((AssetDefinition(body.name, 0, MODEL_ID, (), markers),))


class EmulatedValves:
    """Converters that lead to the valves of a simulation on the bus `bus`."""

    def __init__(self, channels: int) -> None:
        """Lead nowhere before `connect`; `channels` is their number."""
        self._backend: Backend | None = None
        self._given: Sequence[float] = (0.0,) * channels
        self._measured: Sequence[float] = (0.0,) * channels
        self._sequence = 0

    def connect(self, backend: Backend, bus: Bus, catch_up: Callable[[], None]) -> None:
        """Lead to another robot, which gets the targets that are in force.

        Args:
            backend: Its simulation.
            bus: Where that listens.
            catch_up: Lets the simulation run until now.
        """
        self._backend, self._bus, self._catch_up = backend, bus, catch_up
        bus.subscribe(channels.ACTUATOR_STATE, self._measure)
        self._tell()

    def write(self, pressure: Sequence[float]) -> None:
        """Give the simulated valves their targets from now on."""
        self._given = tuple(pressure)
        if self._backend is not None:
            self._catch_up()
            self._tell()

    def read(self) -> Sequence[float]:
        """Return what the simulated sensors measured last."""
        return self._measured

    def close(self) -> None:
        """Do nothing."""

    def _tell(self) -> None:
        assert self._backend is not None
        self._sequence += 1
        now = self._backend.utime
        commands = Commands(now, (now + FOREVER,), np.array([self._given]))
        self._bus.publish(channels.ACTUATOR_COMMAND, commands.to_message(now, self._sequence))
        self._bus.drain()

    def _measure(self, message: actuator_state_t) -> None:
        self._measured = message.measured


@dataclass(frozen=True)
class _Scene:
    """A simulated robot, and the bus on which it listens and speaks."""

    trial: Trial
    backend: Backend
    bus: Bus


class EmulatedRobot:
    """A simulated robot behind a valve board and a Motive.

    Attributes:
        board: The board, on `board.address`.
        motive: The motion capture, on `motive.port`.
        lost: Time by which the simulation has fallen behind the clock on the wall for good [s].
    """

    def __init__(
        self,
        config: ExperimentConfig,
        board: BoardConfig,
        address: tuple[str, int],
        motive: NatNetServerConfig,
        armed: bool = False,
        say: Callable[[str], None] = lambda _: None,
        calibration: Calibration | None = None,
    ) -> None:
        """Load the engine, and listen.

        Args:
            config: Names the engine and everything around it.
            board: Of the board.
            address: Host and port that the board listens on.
            motive: Where the motion capture answers.
            armed: Whether to arm every controller that announces a trial, in the place of a person.
            say: Prints a line for the user.
            calibration: Where the frame of the motion capture lies; by default its axes are ours, turned.

        Raises:
            BackendError: The engine refuses the scene, or an address is taken.
            NatNetError: The address of the motion capture is taken.
        """
        plugin = backend_plugin(config)
        if not plugin.simulated:
            raise BackendError(f"{config.backend.name!r} is no engine; emulate a simulated backend, such as mujoco")
        self.lost = 0.0
        self._config, self._plugin, self._armed, self._say = config, plugin, armed, say
        self._calibration = calibration or Calibration()
        self._frames = self._first_frame = self._announced = 0
        self._waiting: _Scene | None = None
        self._valves = EmulatedValves(len(config.simulation.actuators.channels))
        self.motive = NatNetServer(motive, definitions=definitions_of(body_of(config.robot)))
        try:
            self._scene = self._prepare(IDLE)
            self._begin = monotonic_utime()
            self._join()
            self.board = BoardServer(board, self._valves, address, say, on_trial=self._announce)
        except BackendError:
            self.motive.close()
            raise

    def run(self, stop: Callable[[], bool]) -> None:
        """Run in real time until stopped."""
        # What is there now stays; to look through all of it takes the collector 100 ms.
        gc.collect()
        gc.freeze()
        try:
            while not stop():
                self.turn()
        finally:
            self.close()

    def turn(self) -> None:
        """Let the simulation and the network catch up with the clock on the wall."""
        self._catch_up()
        self.motive.poll(monotonic_utime() * 1e-6)
        self.board.turn(LONGEST_TURN)
        board, now, waiting = self.board.board, monotonic_utime(), self._waiting
        if waiting is None:
            if not board.session and self._scene.trial != IDLE:
                self._play(self._prepare(IDLE))
            return
        if self._armed and board.session and now > self._announced + ARM_AFTER:
            board.arm(board.session, now)
        if board.state is BoardState.ARMED or waiting.trial.kind is TrialKind.THROW:
            self._waiting = None
            self._play(waiting)

    def close(self) -> None:
        """Vent and leave the network."""
        self.board.close()
        self.motive.close()
        self._scene.backend.close()

    def _announce(self, message: board_trial_t) -> None:
        """Load the trial of a controller; its ball flies when the robot is armed."""
        try:
            kind = TrialKind(message.announced_kind)
        except ValueError:
            self._say(f"unknown kind of trial {message.announced_kind!r}; nothing will be thrown")
            return
        if min(message.announced_index, message.announced_seed) < 0:
            self._say("chance knows no trial with a number or seed below 0; nothing will be thrown")
            return
        self._waiting = self._prepare(Trial(kind, message.announced_index, message.announced_seed))
        self._announced = monotonic_utime()

    def _prepare(self, trial: Trial) -> _Scene:
        backend = self._plugin.create(self._config, backend_options(self._config))
        bus = Bus("memq://")
        backend.start(bus, trial)
        return _Scene(trial, backend, bus)

    def _play(self, scene: _Scene) -> None:
        """Put another robot behind the wires, at the time 0 of its simulation."""
        self._scene.backend.close()
        self._scene, self._begin, self._first_frame = scene, monotonic_utime(), self._frames
        self._join()

    def _join(self) -> None:
        self._scene.bus.subscribe(channels.MOCAP, self._show)
        self._scene.bus.subscribe(channels.TRIAL, self._tell_truth)
        self._valves.connect(self._scene.backend, self._scene.bus, self._catch_up)

    def _catch_up(self) -> None:
        now = monotonic_utime() - self._begin
        behind = (now - self._scene.backend.utime) * 1e-6
        if behind > GIVE_UP:
            self.lost += behind
            self._begin += round(behind * 1e6)
            return
        try:
            self._scene.backend.advance(now)
        except DivergenceError as error:
            self._say(f"{error}; the robot is put back")
            self._play(self._prepare(IDLE))
        self._scene.bus.drain()

    def _tell_truth(self, event: trial_event_t) -> None:
        """Print what only a simulation knows, to be held against what the cameras tell."""
        if event.event in (EventName.TOUCH, EventName.BALL_LANDED):
            self._say(f"in truth: {event.event} at {event.utime * 1e-6:.3f} s, {event.detail}")

    def _show(self, message: mocap_frame_t) -> None:
        """Send a frame as Motive does: in its own axes, numbered on from trial to trial."""
        self._frames = (self._first_frame + message.frame_number) % FRAME_NUMBERS
        exposed = (self._begin + message.utime) * 1e-6
        places = np.array([marker.marker_position for marker in message.markers]).reshape(-1, 3)
        markers = []
        unlabelled = 0
        for marker, place in zip(message.markers, self._calibration.to_motive(places).tolist(), strict=True):
            position = (place[0], place[1], place[2])
            if marker.marker_id == marker_t.UNLABELLED:
                unlabelled += 1
                markers.append(LabelledMarker(0, unlabelled, position))
            else:
                markers.append(LabelledMarker(MODEL_ID, 1 + marker.marker_id, position))
        ticks = self.motive.ticks(exposed)
        self.motive.send(Frame(self._frames, exposed, ticks, tuple(markers)))
