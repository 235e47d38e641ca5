"""`imolo board`: the program of the valve board, one thread around one `select`, on the board's own clock."""

import gc
import secrets
import select
import socket
import time
from collections.abc import Callable
from typing import Any

from imolo.errors import BackendError
from imolo.method.commands import to_microseconds
from imolo_drivers.board import Board, BoardConfig, RefusalCode, RefusedError
from imolo_drivers.framing import VERSION, Frame, FrameDecoder, FrameError, FrameType, encode_frame
from imolo_drivers.handshake import ClientRole, type_mismatch
from imolo_drivers.valve_io import NUM_VALVES, ValveIO
from imolo_msgs import board_refusal_t, board_trial_t, board_welcome_t

PORT = 7705
MAX_CONNECTIONS = 8  # a controller and a few operators
RECEIVE = 16384  # [bytes] taken at once
UNSENT = 65536  # [bytes] kept for a client that does not read, until it is dropped
LONGEST_WAIT = 0.05  # [s] between two looks at whether to stop


def monotonic_utime() -> int:
    """Return the time of a clock that nobody sets [µs]."""
    return time.monotonic_ns() // 1000


class _Connection:
    """A client: what it has not finished saying, what it has not read, and who it is."""

    def __init__(self, link: socket.socket, peer: str, utime: int) -> None:
        self.link, self.peer, self.heard = link, peer, utime
        self.decoder = FrameDecoder()
        self.role: ClientRole | None = None
        self.session = 0
        self.received = -1
        self.sent = 0
        self.unsent = b""


class _DropError(Exception):
    """A connection is to be closed."""


class BoardServer:
    """Listens for clients and runs the board between their frames.

    Attributes:
        board: The state machine.
        address: Host and port that it listens on.
    """

    def __init__(
        self,
        config: BoardConfig,
        valves: ValveIO,
        address: tuple[str, int],
        say: Callable[[str], None] = lambda _: None,
        clock: Callable[[], int] = monotonic_utime,
        on_trial: Callable[[board_trial_t], None] = lambda _: None,
    ) -> None:
        """Vent, then listen.

        Args:
            config: Of the board.
            valves: The wires.
            address: Host and port to listen on; port 0 takes a free one.
            say: Prints a line for the log of the board.
            clock: Of the board [µs].
            on_trial: Told what a controller announces its session to be for.

        Raises:
            BackendError: The address cannot be listened on.
        """
        self._config, self._valves, self._say, self._clock, self._on_trial = config, valves, say, clock, on_trial
        self.board = Board(config, valves, clock())
        try:
            self._listener = socket.create_server(address)
        except OSError as error:
            valves.close()
            raise BackendError(
                f"cannot listen on {address[0]}:{address[1]}: {error.strerror}; is another board running?"
            ) from error
        self._listener.setblocking(False)
        host, port = self._listener.getsockname()[:2]
        self.address: tuple[str, int] = (host, port)
        self._connections: dict[int, _Connection] = {}
        self._interval = to_microseconds(1.0 / config.state_rate)
        self._next_state = clock() + self._interval
        self._silence = to_microseconds(config.silence)
        self._controller = ""
        self._told = (self.board.state, self.board.cause)

    def run(self, stop: Callable[[], bool]) -> None:
        """Serve until stopped; vents however it ends."""
        # What is there now stays; the collector need not look at it again between two switches.
        gc.collect()
        gc.freeze()
        try:
            while not stop():
                self.turn(LONGEST_WAIT)
        finally:
            self.close()

    def close(self) -> None:
        """Vent, then let everybody go."""
        self.board.disarm(self._clock(), "the board program ended")
        for connection in list(self._connections.values()):
            connection.link.close()
        self._connections.clear()
        self._listener.close()
        self._valves.close()

    def turn(self, longest: float) -> None:
        """Wait for what comes first, a frame or something to be done, at most `longest` [s], and handle it."""
        now = self._clock()
        due = min(self.board.next_due(), self._next_state)
        links: list[Any] = [self._listener, *(connection.link for connection in self._connections.values())]
        blocked = [connection.link for connection in self._connections.values() if connection.unsent]
        # `select` counts microseconds; epoll's milliseconds would make a switch late by one.
        readable, writable, _ = select.select(links, blocked, (), min(max((due - now) * 1e-6, 0.0), longest))
        self.board.tick(self._clock())
        for link in readable:
            if link is self._listener:
                self._accept()
            elif connection := self._connections.get(link.fileno()):
                self._guard(connection, self._receive)
        for link in writable:
            if connection := self._connections.get(link.fileno()):
                self._guard(connection, self._flush)
        now = self._clock()
        self.board.tick(now)
        if now >= self._next_state:
            self._stream(now)
        if (told := (self.board.state, self.board.cause)) != self._told:
            self._told = told
            self._say(f"{told[0].name.lower()}{': ' if told[1] else ''}{told[1]}")

    def _stream(self, now: int) -> None:
        """Tell the state to all; states that are overdue are left out rather than told in a burst."""
        self._next_state += self._interval * (1 + (now - self._next_state) // self._interval)
        state = self.board.tell(now)

        def tell(connection: _Connection) -> None:
            if now - connection.heard > self._silence:
                reason = f"nothing heard for {self._config.silence:g} s"
                self._refuse_and_drop(connection, RefusalCode.SILENCE, reason)
            elif connection.role is not None:
                self._send(connection, state)

        for connection in list(self._connections.values()):
            self._guard(connection, tell)

    def _accept(self) -> None:
        try:
            link, peer = self._listener.accept()
        except OSError:
            return  # gone again
        if len(self._connections) >= MAX_CONNECTIONS:
            link.close()
            return
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connections[link.fileno()] = _Connection(link, f"{peer[0]}:{peer[1]}", self._clock())

    def _guard(self, connection: _Connection, action: Callable[[_Connection], None]) -> None:
        """Do something with a connection, and close it if that shows it to be of no use."""
        try:
            action(connection)
        except _DropError as why:
            self._drop(connection, str(why))
        except OSError as error:
            self._drop(connection, f"the link to {connection.peer} broke: {error.strerror}")

    def _drop(self, connection: _Connection, cause: str) -> None:
        self._connections = {key: one for key, one in self._connections.items() if one is not connection}
        connection.link.close()
        if connection.session:
            self.board.disconnect(self._clock(), cause)
            self._controller = ""
        if connection.role is not ClientRole.OPERATOR:
            self._say(cause)

    def _receive(self, connection: _Connection) -> None:
        data = connection.link.recv(RECEIVE)
        if not data:
            raise _DropError(f"{connection.peer} closed the link")
        try:
            frames = connection.decoder.feed(data)
        except FrameError as error:
            self._refuse_and_drop(connection, RefusalCode.FRAME, str(error))
            return
        for frame in frames:
            now = self._clock()
            connection.heard = now
            try:
                self._handle(connection, frame, now)
            except RefusedError as refusal:
                self._refuse(connection, refusal.code, str(refusal), frame)
                if connection.role is None:
                    raise _DropError(f"{connection.peer} was refused: {refusal}") from refusal

    def _handle(self, connection: _Connection, frame: Frame, now: int) -> None:
        if frame.sequence <= connection.received:
            reason = f"frame {frame.sequence} is not newer than {connection.received}"
            raise RefusedError(RefusalCode.STALE, reason)
        connection.received = frame.sequence
        if connection.role is None:
            self._welcome(connection, frame, now)
            return
        controller = connection.role is ClientRole.CONTROLLER
        if controller:
            self.board.heard(now)
        message = frame.message
        if frame.type is FrameType.CLOCK:
            message.heard_utime, message.answered_utime = now, self._clock()
            self._send(connection, message)
        elif frame.type is FrameType.ARM and not message.arm:
            self.board.disarm(now, f"disarmed by {message.arm_person or connection.peer}")
        elif frame.type is FrameType.ARM and not controller:
            self.board.arm(message.arm_session, now)
            self._say(f"armed by {message.arm_person} for {self._controller}")
        elif frame.type is FrameType.COMMAND and controller:
            self.board.command(message, now)
        elif frame.type is FrameType.TRIAL and controller:
            self._say(f"{message.announced_kind} trial {message.announced_index}, seed {message.announced_seed}")
            self._on_trial(message)
            self._send(connection, message)
        else:
            name = frame.type.name.lower()
            raise RefusedError(RefusalCode.ROLE, f"a {connection.role} may not send a frame of type {name}")

    def _welcome(self, connection: _Connection, frame: Frame, now: int) -> None:
        hello = frame.message
        if frame.type is not FrameType.HELLO:
            raise RefusedError(RefusalCode.FRAME, "the first frame must be a hello")
        if hello.hello_version != VERSION:
            reason = f"the client speaks version {hello.hello_version} of the protocol, this board {VERSION}"
            raise RefusedError(RefusalCode.VERSION, f"{reason}; run both from the same version of imolo")
        if different := type_mismatch(hello.hello_type, hello.hello_fingerprint):
            reason = f"the client has other message types: {different}; run both from the same version of imolo"
            raise RefusedError(RefusalCode.TYPES, reason)
        if hello.client_role not in list(ClientRole):
            raise RefusedError(RefusalCode.ROLE, f"unknown role {hello.client_role!r}; known: {', '.join(ClientRole)}")
        role = ClientRole(hello.client_role)
        if role is ClientRole.CONTROLLER:
            session = 1 + secrets.randbits(62)
            self.board.connect(session, bool(hello.wants_dry_run), now)
            connection.session = session
            self._controller = f"{hello.client_name} at {connection.peer}"
            self._say(f"controller {self._controller}" + (", dry run" if self.board.dry_run else ""))
        connection.role = role
        self._send(connection, self._introduction())

    def _introduction(self) -> board_welcome_t:
        message, config, board = board_welcome_t(), self._config, self.board
        message.welcome_version = VERSION
        message.board_name, message.board_robot = config.name, config.robot
        message.controller_session, message.controller_name = board.session, self._controller
        message.num_channels = NUM_VALVES
        message.pressure_limit, message.rise_limit = config.pressure_limit, config.rise_limit
        message.watchdog_time, message.state_interval = to_microseconds(config.watchdog), self._interval
        message.is_dry_run = int(board.dry_run)
        message.state_at_welcome, message.cause_at_welcome = board.state, board.cause
        return message

    def _refuse(self, connection: _Connection, code: RefusalCode, reason: str, frame: Frame | None) -> None:
        message = board_refusal_t()
        message.refusal_code, message.refusal_reason = code.value, reason
        if frame is not None:
            message.refused_frame_type, message.refused_frame_sequence = frame.type, frame.sequence
        self._send(connection, message)

    def _refuse_and_drop(self, connection: _Connection, code: RefusalCode, reason: str) -> None:
        self._refuse(connection, code, reason, None)
        raise _DropError(f"{connection.peer}: {reason}")

    def _send(self, connection: _Connection, message: Any) -> None:
        connection.unsent += encode_frame(message, connection.sent, self._clock())
        connection.sent += 1
        self._flush(connection)

    def _flush(self, connection: _Connection) -> None:
        try:
            count = connection.link.send(connection.unsent)
        except BlockingIOError:
            count = 0
        connection.unsent = connection.unsent[count:]
        if len(connection.unsent) > UNSENT:
            raise _DropError(f"{connection.peer} does not read what the board says")
