"""A valve board that runs beside a test, on a real socket, and clients of it."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from imolo_drivers.board.client import BoardClient
from imolo_drivers.board.command import make_command
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.handshake import ClientRole
from imolo_drivers.board.server import BoardServer, monotonic_utime
from imolo_drivers.board.valve_io import SimulatedValves
from imolo_msgs import actuator_command_t

PATIENCE = 60.0  # [s] for what must happen at all; how fast it is is measured in benchmarks/hardware.py
LOOPBACK = ("127.0.0.1", 0)
NUM_VALVES = 8  # of the default robot
VENTED = (0.0,) * NUM_VALVES
SETTINGS = {"rise_limit": 0.0}  # whose default is on: most claims are about what is given at once


class RunningBoard:
    """A board in a thread; `jump` moves its clock."""

    def __init__(self, config: BoardConfig, address: tuple[str, int] = LOOPBACK) -> None:
        self.said: list[str] = []
        self.trials: list[Any] = []
        self.jump = 0
        self.valves = SimulatedValves()
        self.server = BoardServer(config, self.valves, address, self.said.append, self.clock, self.trials.append)
        self.address = self.server.address
        self.failure: BaseException | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def state(self) -> str:
        return self.server.board.state.name

    @property
    def cause(self) -> str:
        return self.server.board.cause

    def clock(self) -> int:
        return monotonic_utime() + self.jump

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive(), "the board hangs"
        assert self.failure is None, f"the board crashed: {self.failure!r}"

    def _run(self) -> None:
        try:
            self.server.run(self._stop.is_set)
        except BaseException as error:  # noqa: BLE001
            self.failure = error


@contextlib.contextmanager
def running_board(address: tuple[str, int] = LOOPBACK, **settings: Any) -> Iterator[RunningBoard]:
    config = BoardConfig.model_validate({**SETTINGS, **settings})
    # Longer than a board may wait: a busy machine can hold up both sides for any time.
    patience = {name: 60.0 for name in ("watchdog", "silence") if name not in settings}
    board = RunningBoard(config.model_copy(update=patience), address)
    try:
        yield board
    finally:
        board.stop()


@contextlib.contextmanager
def controller(board: RunningBoard, armed: bool = True, **settings: Any) -> Iterator[BoardClient]:
    client = BoardClient(board.address, ClientRole.CONTROLLER, "test", **{"patience": PATIENCE, **settings})
    try:
        if armed:
            arm(board)
            client.synchronise(3)
        yield client
    finally:
        client.close()


def arm(board: RunningBoard, session: int | None = None) -> BoardClient:
    """Arm as a person would; return the operator's connection, closed."""
    operator = BoardClient(board.address, ClientRole.OPERATOR, "person", PATIENCE)
    try:
        wanted = operator.welcome.controller_session if session is None else session
        operator.arm(wanted, "person")
        assert operator.wait(lambda: bool(operator.state.armed_session or operator.refusals), PATIENCE)
    finally:
        operator.close()
    return operator


def eventually(true: Callable[[], bool]) -> bool:
    end = time.monotonic() + PATIENCE
    while not true():
        if time.monotonic() > end:
            return False
        time.sleep(0.001)
    return True


def command(
    onset: int,
    sequence: int = 1,
    pressure: float = 3e5,
    lengths: tuple[int, ...] = (100_000, 400_000),
    num_channels: int = NUM_VALVES,
) -> Any:
    """Return commands whose phase i has i times `pressure` everywhere, on the clock of the board."""
    switches = np.cumsum([onset, *lengths])[1:].tolist()
    target = np.outer(np.arange(1, len(lengths) + 1), np.full(num_channels, pressure))
    return make_command(sequence, onset, switches, target.tolist())


def bad_command(onset: int, fault: str, sequence: int = 2) -> actuator_command_t:
    message = command(onset, sequence)
    if fault == "not finite":
        message.target[1][2] = float("nan")
    elif fault == "5 MPa":
        message.target[1][2] = 5e6
    elif fault == "negative":
        message.target[0][0] = -1.0
    elif fault == "backwards":
        message.switch_utime.reverse()
    elif fault == "no phases":
        message.num_phases, message.switch_utime, message.target = 0, [], []
    elif fault == "another clock":
        message.switch_utime[-1] += 3_600_000_000
    return message
