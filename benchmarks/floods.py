"""How late the valve board vents while others do what they can to hold it up: `python -m benchmarks.floods [TRIES]`.

The board is a process with real-time priority, and so is the controller, which commands and then stops. A try lasts
from the moment at which its last command was sent to the moment at which the converters were told to vent.
"""

import contextlib
import ctypes
import multiprocessing
import os
import random
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from benchmarks.measurement import Measurement
from imolo.errors import BackendError
from imolo.machine.priority import BACKEND_PRIORITY, BOARD_PRIORITY, claim_priority, claimed_priority
from imolo_drivers.board.board import BoardState
from imolo_drivers.board.client import BoardClient
from imolo_drivers.board.command import make_command
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.framing import MAX_PAYLOAD, MAX_SHORT_PAYLOAD, encode_frame
from imolo_drivers.board.handshake import ClientRole, make_hello
from imolo_drivers.board.server import BoardServer, monotonic_utime
from imolo_drivers.board.valve_io import SimulatedValves
from imolo_msgs import board_clock_t

NUM_VALVES = 8  # of the default robot

Address = tuple[str, int]
CROWD = 4  # programs that flood, and busy loops
BLOCKED = 0.5  # [s] that a reading of the sensors takes in one row
COMMANDS, RATE = 3, 120.0  # of a try, and how often [Hz]
PATIENCE = 10.0  # [s]
TRIES = 100
PR_SET_PDEATHSIG = 1  # of Linux' prctl
SPAWN = multiprocessing.get_context("spawn")


class StampedValves(SimulatedValves):
    """Notes when it was told to vent [µs]."""

    def __init__(self, vented: Any, blocked: float) -> None:
        super().__init__()
        self._vented, self._blocked = vented, blocked

    def write(self, pressure: Sequence[float]) -> None:
        """Follow, and note the time."""
        super().write(pressure)
        if not any(pressure):
            self._vented.value = monotonic_utime()

    def read(self) -> Sequence[float]:
        """Block first."""
        time.sleep(self._blocked)
        return super().read()


def run(tries: int = TRIES) -> list[Measurement]:
    """Measure every row, beside nothing else and beside busy loops."""
    limit = 1e3 * BoardConfig().watchdog
    rows = []
    for busy in (0, CROWD):
        for name, (flood, blocked) in ROWS.items():
            late = _measure(flood, blocked, busy, tries)
            beside = f", beside {busy} busy loops" if busy else ""
            rows.append(Measurement(f"valve board: {name}{beside}", f"worst of {tries}", max(late), "ms", limit))
            print(f"{name + beside:55s} {np.median(late):6.1f} {max(late):6.1f} ms", flush=True)
    return rows


def _measure(flood: Callable[[Address], None] | None, blocked: float, busy: int, tries: int) -> list[float]:
    """Return how long the board took to vent [ms]."""
    vented = SPAWN.Value("q", 0, lock=False)
    ours, theirs = SPAWN.Pipe()
    with contextlib.ExitStack() as stack:
        stack.enter_context(_running(_board, theirs, vented, blocked))
        address = ours.recv()
        ready = SPAWN.Semaphore(0)
        for _ in range(busy):
            stack.enter_context(_running(_spin, ready))
        for _ in range(CROWD if flood else 0):
            stack.enter_context(_running(_flood, flood, address, ready))
        for _ in range(busy + (CROWD if flood else 0)):
            ready.acquire(timeout=PATIENCE)
        stack.enter_context(claimed_priority(BACKEND_PRIORITY))
        controller = BoardClient(address, ClientRole.CONTROLLER, "controller")
        stack.callback(controller.close)
        late: list[float] = []
        while len(late) < tries:
            took = _try(address, controller, vented, talks=bool(len(late) % 2))
            late += [1e-3 * took] if took is not None else []
        return late


def _try(address: Address, controller: BoardClient, vented: Any, talks: bool) -> int | None:
    """Command, stop, and return the time from the last command to the vent [µs]; None if it had vented before.

    Args:
        address: Of the board.
        controller: Commands.
        vented: When the board vented last [µs].
        talks: Whether the controller asks for the time after it has stopped.
    """
    _arm(address, controller)
    sent = 0
    onset = monotonic_utime()
    for sequence in range(1, 1 + COMMANDS):
        command = make_command(sequence, onset, (onset + 5_000_000,), np.full((1, NUM_VALVES), 1e5))
        sent = monotonic_utime()
        controller.command(command)
        controller.wait(lambda: False, 1.0 / RATE)
    end = time.monotonic() + PATIENCE
    while vented.value < sent:
        if time.monotonic() > end:
            raise RuntimeError("the board does not vent")
        if controller.state.board_state == BoardState.LATCHED and controller.state.entered_utime < sent:
            return None
        if talks:
            controller.ask_time()
        controller.wait(lambda: False, 0.02)
    return int(vented.value - sent)


def _arm(address: Address, controller: BoardClient) -> None:
    """Arm in the place of a person, who tries again where the crowd was quicker."""
    end = time.monotonic() + PATIENCE
    while not controller.state.armed_session:
        if time.monotonic() > end:
            raise RuntimeError("the board is not armed")
        with contextlib.suppress(BackendError):
            operator = BoardClient(address, ClientRole.OPERATOR, "person", PATIENCE)
            operator.arm(controller.welcome.controller_session, "person")
            controller.ask_time()
            controller.wait(lambda: bool(controller.state.armed_session), 0.05)
            operator.close()


@contextlib.contextmanager
def _running(target: Callable[..., None], *arguments: Any) -> Iterator[None]:
    process = SPAWN.Process(target=_until_we_end, args=(os.getpid(), target, *arguments), daemon=True)
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()


def _until_we_end(parent: int, target: Callable[..., None], *arguments: Any) -> None:
    """Do something in a process that ends with this one, however this one ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() == parent:
        target(*arguments)


def _board(port: Connection, vented: Any, blocked: float) -> None:
    # The sensors are given time, so that it is the watchdog that vents.
    server = BoardServer(BoardConfig(), StampedValves(vented, blocked), ("127.0.0.1", 0))
    if blocked:
        server._sensors._patience = 10_000_000
    granted = claim_priority(BOARD_PRIORITY)
    if not granted.startswith("real-time"):
        print(granted, flush=True)
    port.send(server.address)
    server.run(lambda: False)


def _spin(ready: Any) -> None:
    ready.release()
    while True:
        pass


def _flood(deed: Callable[[Address], None], address: Address, ready: Any) -> None:
    """Do something without end, whatever the board makes of it."""
    ready.release()
    while True:
        with contextlib.suppress(OSError, BackendError):
            deed(address)


def _operate(address: Address) -> BoardClient:
    return BoardClient(address, ClientRole.OPERATOR, "flood", 0.1)


def _ask(address: Address) -> None:
    with contextlib.closing(_operate(address)) as client:
        frames = b"".join(encode_frame(board_clock_t(), number, 0) for number in range(2, 100))
        while True:
            client._link.sendall(frames)
            client.poll()


def _arm_again(address: Address) -> None:
    with contextlib.closing(_operate(address)) as client:
        while True:
            client.arm(client.welcome.controller_session, "flood")
            client.poll()


def _command(address: Address) -> None:
    command = make_command(1, 0, range(1, 200), np.zeros((199, NUM_VALVES)))
    frame = encode_frame(command, 2, 0)
    assert len(frame) > 0.8 * MAX_PAYLOAD
    with contextlib.closing(_operate(address)) as client:
        while True:
            client._link.sendall(frame)


def _deaf(address: Address) -> None:
    client = _operate(address)
    while True:
        client.ask_time()
        time.sleep(0.005)


def _hello(address: Address) -> None:
    hello = make_hello(ClientRole.OPERATOR, "x")
    hello.hello_type = ["x"] * 280
    hello.num_hello_types, hello.hello_fingerprint = 280, [0] * 280
    assert len(hello.encode()) <= MAX_SHORT_PAYLOAD
    _send_and_read(address, encode_frame(hello, 0, 0))


def _garbage(address: Address) -> None:
    _send_and_read(address, random.randbytes(4096))


def _connect(address: Address) -> None:
    socket.create_connection(address, 0.1).close()


def _trickle(address: Address) -> None:
    links = [socket.create_connection(address, 0.1) for _ in range(4)]
    for byte in encode_frame(make_hello(ClientRole.OPERATOR, "x"), 0, 0):
        for link in links:
            link.sendall(bytes([byte]))


def _send_and_read(address: Address, data: bytes) -> None:
    with socket.create_connection(address, 0.1) as link:
        link.sendall(data)
        while link.recv(4096):
            pass


ROWS: dict[str, tuple[Callable[[Address], None] | None, float]] = {
    "nothing": (None, 0.0),
    "sensors that block 500 ms": (None, BLOCKED),
    "operators that ask the time": (_ask, 0.0),
    "operators that arm": (_arm_again, 0.0),
    "operators that command": (_command, 0.0),
    "operators that do not read": (_deaf, 0.0),
    "hellos of 4 kB": (_hello, 0.0),
    "bytes that are no frame": (_garbage, 0.0),
    "connections": (_connect, 0.0),
    "frames byte by byte": (_trickle, 0.0),
}

if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    run(int(sys.argv[1]) if len(sys.argv) > 1 else TRIES)
