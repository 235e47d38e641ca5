"""A board whose turns and whose clock a test takes in its own hands, and clients that send single frames to it."""

import contextlib
import socket
from collections.abc import Callable, Iterator
from typing import Any

from board_link import LOOPBACK, SETTINGS, eventually

from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.framing import Frame, FrameDecoder, FrameType, encode_frame
from imolo_drivers.board.handshake import ClientRole, make_hello, prove_arming, prove_hello
from imolo_drivers.board.server import BoardServer
from imolo_drivers.board.valve_io import SimulatedValves
from imolo_msgs import board_arm_t, board_clock_t, board_proof_t

START = 1_000_000  # [µs]
TURNS = 2000  # until something must have happened


class Peer:
    """A client without a mind of its own."""

    def __init__(self, board: "BoardByHand", host: str) -> None:
        self._board = board
        self._link = socket.create_connection(board.server.address, 5.0, source_address=(host, 0))
        self._link.setblocking(False)
        self._decoder = FrameDecoder()
        self._frames: list[Frame] = []
        self.sequence = 0
        self.nonce = b""
        self.is_closed = False

    def send(self, *messages: Any) -> None:
        data = b""
        for message in messages:
            data += encode_frame(message, self.sequence, 0)
            self.sequence += 1
        self._link.sendall(data)

    def frames(self, frame_type: FrameType) -> list[Any]:
        """Return all messages of a type that have come."""
        with contextlib.suppress(BlockingIOError):
            try:
                while data := self._link.recv(65536):
                    self._frames += self._decoder.feed(data)
                self.is_closed = True
            except ConnectionError:
                self.is_closed = True
        return [frame.message for frame in self._frames if frame.type is frame_type]

    def refusals(self) -> list[str]:
        return [message.refusal_code for message in self.frames(FrameType.REFUSAL)]

    def ask(self, times: int = 1) -> None:
        self.send(*[board_clock_t() for _ in range(times)])

    def arm(self, session: int, secret: bytes = b"") -> None:
        message = board_arm_t()
        message.arm_session, message.arm, message.arm_person = session, 1, "person"
        message.arm_seen_utime = self.frames(FrameType.WELCOME)[0].entered_at_welcome
        message.arm_proof = prove_arming(secret, self.nonce, self.sequence, message)
        self.send(message)

    def close(self) -> None:
        self._link.close()


class BoardByHand:
    """A board that takes a turn when it is told to, on a clock that the test sets."""

    def __init__(self, **settings: Any) -> None:
        self.now, self.sensors_block = START, False
        self.said: list[str] = []
        self.valves = SimulatedValves()
        config = BoardConfig.model_validate({**SETTINGS, **settings})
        self.server = BoardServer(config, self.valves, LOOPBACK, self.said.append, lambda: self.now)
        self.peers: list[Peer] = []

    @property
    def state(self) -> str:
        return self.server.board.state.name

    def turn(self, step: int) -> None:
        """Take a turn `step` [µs] later; the clock stands still until the thread of the sensors has had its turn."""
        self.now += step
        self.server.turn(0.001)
        assert self.sensors_block or eventually(lambda: not self.server._sensors._is_busy)

    def until(self, true: Callable[[], object], step: int = 100) -> None:
        """Take turns, `step` [µs] apart, until something is so."""
        for _ in range(TURNS):
            if true():
                return
            self.turn(step)
        raise AssertionError("it does not happen")

    def connect(self, host: str = "127.0.0.1") -> Peer:
        peer = Peer(self, host)
        self.peers.append(peer)
        return peer

    def admit(self, role: ClientRole, secret: bytes = b"", host: str = "127.0.0.1") -> Peer:
        """Return a client that the board has welcomed, or refused."""
        peer = self.connect(host)
        hello = make_hello(role, "test")
        peer.send(hello)
        self.until(lambda: peer.frames(FrameType.CHALLENGE))
        peer.nonce = peer.frames(FrameType.CHALLENGE)[0].challenge_nonce
        proof = board_proof_t()
        proof.hello_proof = prove_hello(secret, peer.nonce, hello)
        peer.send(proof)
        self.until(lambda: peer.frames(FrameType.WELCOME) or peer.refusals())
        return peer

    def close(self) -> None:
        for peer in self.peers:
            peer.close()
        self.server.close()


@contextlib.contextmanager
def board_by_hand(**settings: Any) -> Iterator[BoardByHand]:
    board = BoardByHand(**settings)
    try:
        yield board
    finally:
        board.close()


def armed_controller(board: BoardByHand, secret: bytes = b"") -> Peer:
    """Return a controller that a person has armed."""
    controller = board.admit(ClientRole.CONTROLLER, secret)
    operator = board.admit(ClientRole.OPERATOR, secret)
    operator.arm(board.server.board.session, secret)
    board.until(lambda: board.state == "ARMED")
    operator.close()
    return controller
