"""Frames made by chance, most of them whole and signed, against the board's program, beside a robot that moves."""

import random
import re
from pathlib import Path
from typing import Any

import pytest
from board_link import LOOPBACK, SETTINGS, command
from test_framing import _mutate, _seeds, sealed

from imolo_drivers.board.board import BoardState
from imolo_drivers.board.command import make_command
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.connection import Connection
from imolo_drivers.board.framing import PAYLOADS, encode_frame
from imolo_drivers.board.handshake import ClientRole, make_hello
from imolo_drivers.board.server import BoardServer
from imolo_drivers.board.valve_io import SimulatedValves
from imolo_msgs import board_proof_t, board_trial_t

EXTREME = (0, 1, -1, 2**31 - 1, -(2**31), 2**63 - 1, -(2**63))
TEXTS = ("", "controller", "operator", "\x1b[2J" * 300, "\x01" * 1100, "\N{GRINNING FACE}" * 500, "%s{0}\n\r")
STEP = 500  # [µs] between two frames
PAGE = 4096  # [bytes]


class MemoryLink:
    """A link whose other end reads everything."""

    def __init__(self) -> None:
        self.arrived = b""

    def recv(self, _: int) -> bytes:
        data, self.arrived = self.arrived, b""
        return data

    def send(self, data: bytes) -> int:
        return len(data)

    def fileno(self) -> int:
        return -1

    def setblocking(self, _: bool) -> None: ...

    def setsockopt(self, *_: int) -> None: ...

    def close(self) -> None: ...


class Fuzz:
    """A board with a stranger, an operator and an armed controller, each of whom says anything."""

    def __init__(self, seed: int) -> None:
        self.chance, self.now, self.trials = random.Random(seed), 1_000_000, 0
        self.said: list[str] = []
        self.valves = SimulatedValves()
        config = BoardConfig.model_validate({**SETTINGS, "silence": 60.0})
        self.server = BoardServer(config, self.valves, LOOPBACK, self.hear, lambda: self.now, self.note)
        self.seeds = [*_seeds(), encode_frame(make_hello(ClientRole.CONTROLLER, "x"), 0, 0)]
        self.links: dict[str, Connection] = {}
        self.dropped = self.armed = 0

    def hear(self, line: str) -> None:
        assert line.isprintable()
        assert len(line) <= 300
        # A fault that the board did not foresee is told by the name of its class.
        assert not re.search(r": \w+(Error|Exception): ", line), line

    def note(self, _: board_trial_t) -> None:
        self.trials += 1

    def round(self) -> None:
        """Let somebody say something, and look at the board."""
        self.now += STEP
        name = self.chance.choice(("stranger", "operator", "controller"))
        connection = self.links.get(name)
        if connection is None or connection not in self.server._connections:
            self.dropped += 1
            connection = self.links[name] = self._admit(name)
        connection.link.arrived = self._frames(connection)  # type: ignore[attr-defined]
        while connection in self.server._connections and (
            connection.link.arrived or connection.decoder.has_frame  # type: ignore[attr-defined]
        ):
            self.server._guard(connection, self.server._receive)
        self.server.board.tick(self.now)
        if self.server.board.state is BoardState.ARMED:
            self.armed += 1
        else:
            assert not any(self.valves.pressure)
        if self.chance.random() < 0.05 and self.server.board.session:
            self.server.board.arm(self.server.board.session, self.now)

    def _admit(self, name: str) -> Connection:
        connection = Connection(MemoryLink(), ("203.0.113.1", 1), self.now)  # type: ignore[arg-type]
        self.server._make_room(self.server._connections, 8)
        self.server._connections.append(connection)
        if name == "stranger":
            return connection
        for message in (make_hello(ClientRole(name), "x"), board_proof_t()):
            if isinstance(message, board_proof_t):
                message.hello_proof = bytes(32)
            connection.link.arrived = encode_frame(message, 0, 0)  # type: ignore[attr-defined]
            connection._received = None
            self.server._guard(connection, self.server._receive)
        connection.allowance.rate = connection.allowance._left = 10**12  # noise is another test's
        connection.allowance.burst = 10**12
        return connection

    def _frames(self, connection: Connection) -> bytes:
        kind = self.chance.randrange(4)
        if kind == 0:
            return _mutate(self.chance, self.seeds)
        number = (connection._received or 0) + self.chance.choice((1, 1, 1, 2, 0, 2**31))
        if kind == 1:
            message = command(self.now, self.chance.choice(EXTREME) % 2**31, self.chance.choice((1e5, 1e9)))
        elif kind == 2:
            width = self.chance.randrange(12)
            rows = [[self.chance.choice((0.0, 1e5, float("nan"), float("inf"), -1.0))] * width] * self.chance.randrange(
                4
            )
            times = [self.now + self.chance.choice(EXTREME) // 2**20 for _ in rows]
            message = make_command(self.chance.randrange(2**32), self.now, times, rows)
        else:
            message = self._scrambled()
        return encode_frame(message, number, 0) if self.chance.random() < 0.9 else sealed(12, b"")

    def _scrambled(self) -> Any:
        """Return a message whose numbers and texts are the worst there are."""
        message = self.chance.choice(list(PAYLOADS.values()))()
        for name, kind, sides in zip(message.__slots__, message.__typenames__, message.__dimensions__, strict=True):
            if name.startswith("num_") and kind == "int32_t":
                continue
            if sides is None and kind in ("int64_t", "int32_t", "int8_t"):
                bits = int(kind[3:-2])
                setattr(message, name, (self.chance.choice(EXTREME) + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1))
            elif sides is None and kind == "string":
                setattr(message, name, self.chance.choice(TEXTS))
            elif kind == "byte":
                setattr(message, name, self.chance.randbytes(32))
        return message


def resident() -> int:
    """Return the memory of this program [bytes]."""
    return PAGE * int(Path("/proc/self/statm").read_text().split()[1])


def fuzz(rounds: int, seed: int) -> int:
    """Return by how much memory grew after the first tenth of the rounds [bytes]."""
    one = Fuzz(seed)
    warm = 0
    for number in range(rounds):
        one.round()
        if number == rounds // 10:
            warm = resident()
    grown = resident() - warm
    one.server.close()
    assert one.armed > rounds // 100
    assert one.dropped > rounds // 100
    assert one.trials > rounds // 10_000
    assert len(one.server._connections) == 0
    return grown


def test_board_outlives_fuzzed_frames() -> None:
    fuzz(10_000, seed=1)


@pytest.mark.slow
def test_board_outlives_a_million_fuzzed_frames_in_the_memory_that_it_had() -> None:
    # 900,000 frames that each kept 16 bytes would be 14 MB.
    assert fuzz(1_000_000, seed=2) < 14_000_000
