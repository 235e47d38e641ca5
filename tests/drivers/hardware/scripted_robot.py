"""A board and a Motive without physics beside a test: the ball flies as told, and the cameras fail as told."""

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import backend_options, config_for, make_config
from imolo.contracts.planner import Controller
from imolo.contracts.registry import BACKENDS
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import Log, read_log
from imolo.method.motion import Theta
from imolo.trials.trainer import MotionPlayer
from imolo.trials.trial import run_trial
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.server import BoardServer, monotonic_utime
from imolo_drivers.board.valve_io import SimulatedValves
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
from imolo_msgs import board_trial_t, mocap_frame_t

PATIENCE = 10.0  # [s]
THETA: Theta = (0.5, 0.25)
RATE = 120.0  # [Hz]
MOST_HELD_UP = 6  # frames
NAMES = (
    *("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle"),
    *("right_hand", "left_hand", "right_shoulder", "left_shoulder", "right_toe", "left_toe"),
)
BODY = {
    label: np.array([-0.2 + 0.01 * label, 0.16 if "left" in name else -0.16, 0.5 + 0.03 * label])
    for label, name in enumerate(NAMES)
}
BODY[6], BODY[8] = np.array([0.35, -0.16, 1.2]), np.array([0.0, -0.16, 1.2])  # the right arm stretched forward
BODY[7] = np.array([-0.4, 0.16, 0.8])

LANDING = 0.842  # [s] after its start the ball lies on the floor

Faults = Callable[[float, list[LabelledMarker]], list[LabelledMarker] | None]


def no_fault(_: float, markers: list[LabelledMarker]) -> list[LabelledMarker]:
    return markers


class ScriptedRobot:
    """Runs in a thread. `faults` gets the time since the robot was armed [s] and may change or withhold a frame."""

    def __init__(self, board: BoardConfig, faults: Faults, armed: bool, version: tuple[int, int]) -> None:
        self.said: list[str] = []
        self.valves = SimulatedValves()
        self.server = BoardServer(board, self.valves, ("127.0.0.1", 0), self.said.append, on_trial=self._announce)
        self.motive = NatNetServer(NatNetServerConfig(command_port=0), version, definitions=_definitions())
        self.packets: list[bytes] = []
        self.exposed: Callable[[float], float] = float  # [s] what the cameras say of a frame of that time
        self.take = 2**31  # frames after which the cameras count anew
        self._throws = self._moves = False
        self._faults, self._armed, self._due, self._start = faults, armed, False, math.inf
        self._numbers, self._next = 0, time.monotonic()
        self.failure: BaseException | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive(), "the robot hangs"
        assert self.failure is None, f"the robot crashed: {self.failure!r}"

    def _announce(self, message: board_trial_t) -> None:
        self._due, self._throws = True, message.announced_kind != TrialKind.TRAINING
        self._moves = message.announced_kind != TrialKind.THROW

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self._turn()
        except BaseException as error:  # noqa: BLE001
            self.failure = error
        finally:
            self.server.close()
            self.motive.close()

    def _turn(self) -> None:
        self.server.turn(0.001)
        now = time.monotonic()
        self.motive.poll(now)
        board = self.server.board
        if self._due and board.session:
            self._due, self._start = False, now
            if self._armed and self._moves:
                board.arm(board.session, monotonic_utime())
        while self.packets:
            self.motive.send_packet(self.packets.pop())
        # On a busy machine frames are held up or lost, but none is exposed sooner after another than cameras can.
        self._next += max(int((now - self._next) * RATE) - MOST_HELD_UP, 0) / RATE
        while now >= self._next:
            self._send_frame(self._next)
            self._next += 1.0 / RATE

    def _send_frame(self, exposed: float) -> None:
        self._numbers += 1
        markers = self._faults(exposed - self._start, self._markers(exposed - self._start))
        if markers is not None:
            ticks = self.motive.ticks(self.exposed(exposed))
            self.motive.send(Frame(self._numbers % self.take, exposed, ticks, tuple(markers)))

    def _markers(self, elapsed: float) -> list[LabelledMarker]:
        """Return the resting robot, and a ball that falls onto the floor in front of it."""
        flight = min(max(elapsed - 0.1, 0.0), LANDING) if self._throws else 0.0
        ball = np.array([4.0 - 4.0 * flight, 0.5, 1.0 + 3.0 * flight - 4.905 * flight**2])
        return [*RESTING, marker(0, 1, ball)]


def marker(model: int, number: int, place: Any) -> LabelledMarker:
    position = Calibration().to_motive(np.reshape(place, (1, 3)))[0].tolist()
    return LabelledMarker(model, number, tuple(position))


RESTING = [marker(1, label + 1, place) for label, place in BODY.items()]


@contextlib.contextmanager
def scripted_robot(
    faults: Faults = no_fault, armed: bool = True, version: tuple[int, int] = (4, 1), **board: Any
) -> Iterator[ScriptedRobot]:
    # Longer than a board may wait, since a busy machine can hold up both sides.
    patience = {name: PATIENCE for name in ("watchdog", "silence") if name not in board}
    robot = ScriptedRobot(BoardConfig(**board).model_copy(update=patience), faults, armed, version)
    try:
        yield robot
    finally:
        robot.stop()


def config(robot: Any, **options: Any) -> ExperimentConfig:
    """Return a config of the hardware on the ports of a scripted robot, with patience for a busy machine."""
    patience: dict[str, Any] = dict.fromkeys(("patience", "board_silence", "camera_patience"), PATIENCE)
    patience["exposures"] = {"oldest": PATIENCE}
    host, port = robot.server.address
    cameras = {"command_port": robot.motive.port, **options.pop("cameras", {})}
    settings = {"name": "hardware", "board": f"{host}:{port}", "cameras": cameras, **patience, **options}
    return make_config({"backend": settings})


def play(
    chosen: ExperimentConfig,
    path: Any,
    controller: Controller,
    duration: float = 0.3,
    kind: TrialKind = TrialKind.TRAINING,
    after_slice: Callable[[int], None] = lambda _: None,
) -> Log:
    run_trial(chosen, Trial(kind, 0, 1), controller, path, duration, after_slice)
    return read_log(path)


def backend(chosen: ExperimentConfig) -> Any:
    return BACKENDS.load("hardware").create(chosen, backend_options(chosen))


class Watched:
    """A throw that goes on, however long the machine of this test holds up what comes."""

    def __init__(self, robot: ScriptedRobot) -> None:
        self.backend = backend(config(robot))
        self.frames: list[mocap_frame_t] = []
        self._bus = memory_bus()
        self._bus.subscribe(channels.MOCAP, self.frames.append)
        self.backend.start(self._bus, Trial(TrialKind.THROW, 0, 1))

    def advance_until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, "nothing came"
            self.backend.advance(self.backend.utime + 10_000)
            self._bus.drain()

    def see(self, count: int) -> None:
        before = len(self.frames)
        self.advance_until(lambda: len(self.frames) >= before + count)

    def close(self) -> None:
        self.backend.close()


def memory_bus() -> Bus:
    return Bus("memq://")


def _definitions() -> ModelDefinitions:
    markers = tuple(AssetMarkerDefinition(name, label + 1, (0.0, 0.0, 0.0)) for label, name in enumerate(NAMES))
    return ModelDefinitions((AssetDefinition("liberobot", 0, 1, (), markers),))


def player() -> MotionPlayer:
    return MotionPlayer(config_for("hardware").motion, THETA)


def events(log: Log) -> list[str]:
    return [event.event for event in log.messages[channels.TRIAL]]


def void(log_path: Path) -> str:
    """Return why the trial of a log is void."""
    end = read_log(log_path).messages[channels.TRIAL][-1]
    assert end.event == EventName.END
    return str(end.detail.partition("void: ")[2])
