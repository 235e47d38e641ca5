"""`imolo board`: the program of the valve board, one thread around one `select`, on the board's own clock.

Nothing that comes over a link may hold up the valves. So each link gets one frame a turn, the controller's first;
the board is ticked between any two frames; all others together get a third of the time at most; and whoever says more
than its allowance is dropped.
"""

import gc
import ipaddress
import secrets
import select
import socket
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from imolo.errors import BackendError, ConfigError, ImoloError
from imolo.method.commands import to_microseconds
from imolo_drivers.board.board import Board
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.connection import Allowance, Connection, DropError
from imolo_drivers.board.framing import Frame, FrameError, FrameType, encode_frame
from imolo_drivers.board.handshake import ClientRole, prove_arming, prove_hello
from imolo_drivers.board.reception import check_hello, check_proof, make_welcome
from imolo_drivers.board.refusal import RefusalCode, RefusedError, quote
from imolo_drivers.board.secret import read_secret
from imolo_drivers.board.sensor_reader import SensorReader
from imolo_drivers.board.valve_io import ValveIO
from imolo_msgs import board_challenge_t, board_refusal_t, board_trial_t

PORT = 7705
MAX_OPERATORS, MAX_STRANGERS = 6, 16  # beside the one controller; a newcomer always gets a place
ACCEPTED_AT_ONCE = 4
OTHERS_BUDGET = 1000  # [µs] in a turn for all links but the controller's
OTHERS_PAUSE = 2  # times as long as they took
LONGEST_WAIT = 0.05  # [s] between two looks at whether to stop
LONGEST_REASON = 300  # characters
STRANGERS_LINES = (1, 20)  # [1/s] and at once, in the log


def monotonic_utime() -> int:
    """Return the time of a clock that nobody sets [µs]."""
    return time.monotonic_ns() // 1000


class BoardServer:
    """Listens for clients and runs the board between their frames.

    Attributes:
        board: The state machine.
        address: Host and port that it listens on.
        is_open: Whether there is no secret, so that everybody on this machine may arm.
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
            FrameError: The names of the channels are too long.
            ConfigError: The secret cannot be used, or there is none and the address is not this machine's alone.
        """
        self._config, self._valves, self._say, self._clock, self._on_trial = config, valves, say, clock, on_trial
        self._secret = read_secret(config.secret) if config.secret else b""
        self.is_open = not self._secret
        self.board = Board(config, valves, clock())
        # What does not fit into a frame is told now, and not to the first client.
        encode_frame(make_welcome(config, self.board, controller="?" * LONGEST_REASON), 0, 0)
        try:
            self._listener = _listen(address, self.is_open)
        except (BackendError, ConfigError):
            valves.close()
            raise
        host, port = self._listener.getsockname()[:2]
        self.address: tuple[str, int] = (host, port)
        self._sensors = SensorReader(valves.read, to_microseconds(config.watchdog))
        self._connections: list[Connection] = []
        self._controller = ""
        self._interval = to_microseconds(1.0 / config.state_rate)
        self._next_state = clock() + self._interval
        self._others_from = 0
        self._silence = to_microseconds(config.silence)
        self._strangers_lines = Allowance(*STRANGERS_LINES, clock())
        self._told = (self.board.state, self.board.cause)

    def run(self, stop: Callable[[], bool], turned: Callable[[], None] = lambda: None) -> None:
        """Serve until stopped; vents however it ends.

        Args:
            stop: Whether to end.
            turned: Told after every turn that the board is not held up.
        """
        # What is there now stays; the collector need not look at it again between two switches.
        gc.collect()
        gc.freeze()
        try:
            while not stop():
                self.turn(LONGEST_WAIT)
                turned()
        finally:
            self.close()

    def close(self) -> None:
        """Vent, tell everybody and let them go."""
        self.board.disarm(self._clock(), "the board program ended")
        self.board.tick(self._clock())
        self._stream(self._clock())
        self._tell_change()
        for connection in self._connections:
            connection.close()
        self._connections.clear()
        self._listener.close()
        self._sensors.close()
        self._valves.close()

    def turn(self, longest: float) -> None:
        """Wait for what comes first, a frame or something to be done, at most `longest` [s], and handle it."""
        readable, writable = self._wait(longest)
        self.board.tick(self._clock())
        for connection in [one for one in self._connections if one.session and one in readable]:
            self._take_frame(connection)
        if any(link is self._listener or not link.session for link in readable):
            self._serve_others(readable)
        for connection in writable:
            self._guard(connection, Connection.flush)
        now = self._clock()
        self.board.tick(now)
        if now >= self._next_state:
            self._stream(now)
        self._tell_change()

    def _tell_change(self) -> None:
        if (told := (self.board.state, self.board.cause)) != self._told:
            self._told = told
            self._say(f"{told[0].name.lower()}{': ' if told[1] else ''}{told[1]}")

    def _wait(self, longest: float) -> tuple[set[Any], list[Connection]]:
        """Return the links that have something to read, and those that take something again."""
        now = self._clock()
        due = min(self.board.next_due(), self._next_state)
        links: list[Any] = [connection for connection in self._connections if connection.session]
        if now >= self._others_from:
            links += [self._listener, *(connection for connection in self._connections if not connection.session)]
        else:
            due = min(due, self._others_from)
        # Frames that have arrived already make no link readable.
        waiting = {link for link in links if link is not self._listener and link.decoder.has_frame}
        wait = 0.0 if waiting else min(max((due - now) * 1e-6, 0.0), longest)
        blocked = [connection for connection in self._connections if connection.unsent]
        # `select` counts microseconds; epoll's milliseconds would make a switch late by one.
        readable, writable, _ = select.select(links, blocked, (), wait)
        return waiting.union(readable), writable

    def _serve_others(self, readable: set[Any]) -> None:
        """Let newcomers in and take one frame of each link but the controller's, those first that waited longest."""
        begin = self._clock()
        if self._listener in readable:
            self._accept()
        for connection in [one for one in self._connections if not one.session and one in readable]:
            self._take_frame(connection)
            if self._clock() - begin > OTHERS_BUDGET:
                break
        # The kernel holds up a program with real-time priority that takes all of the time.
        now = self._clock()
        self._others_from = now + OTHERS_PAUSE * (now - begin)

    def _take_frame(self, connection: Connection) -> None:
        self._guard(connection, self._receive)
        self.board.tick(self._clock())
        if connection in self._connections:
            self._connections.remove(connection)
            self._connections.append(connection)

    def _stream(self, now: int) -> None:
        """Tell the state to all; states that are overdue are left out rather than told in a burst."""
        self._next_state += self._interval * (1 + (now - self._next_state) // self._interval)
        self.board.sense(self._sensors.newest(now), now)
        self._sensors.ask(now)
        payload = self.board.tell().encode()

        def tell(connection: Connection) -> None:
            since = connection.since if connection.role is None else connection.heard
            if now - since > self._silence:
                reason = f"nothing heard for {self._config.silence:g} s"
                self._refuse_and_drop(connection, RefusalCode.SILENCE, reason)
            elif connection.role is not None:
                connection.send_payload(FrameType.STATE, payload, now)

        for connection in list(self._connections):
            self._guard(connection, tell)

    def _accept(self) -> None:
        for _ in range(ACCEPTED_AT_ONCE):
            try:
                link, peer = self._listener.accept()
            except OSError:
                return  # gone again, or no more
            self._make_room([one for one in self._connections if one.role is None], MAX_STRANGERS)
            try:
                self._connections.append(Connection(link, peer, self._clock()))
            except OSError:
                link.close()

    def _make_room(self, crowd: list[Connection], places: int) -> None:
        """Drop the oldest of the host that has most of the places, if all are taken."""
        if len(crowd) < places:
            return
        share = Counter(connection.host for connection in crowd)
        oldest = min(crowd, key=lambda one: (-share[one.host], one.since))
        self._drop(oldest, f"{oldest.peer} made room for a newer connection")

    def _guard(self, connection: Connection, action: Callable[[Connection], None]) -> None:
        """Do something with a connection, and close it if that shows it to be of no use."""
        if connection not in self._connections:
            return
        try:
            action(connection)
        except DropError as why:
            self._drop(connection, str(why))
        except OSError as error:
            self._drop(connection, f"the link to {connection.peer} broke: {error.strerror}")
        except Exception as error:  # noqa: BLE001 - whatever one link brings, the others and the valves go on
            kind = "" if isinstance(error, ImoloError) else f"{type(error).__name__}: "
            self._drop(connection, f"{connection.peer}: {kind}{error}")

    def _drop(self, connection: Connection, cause: str) -> None:
        self._connections.remove(connection)
        connection.close()
        cause = quote(cause, LONGEST_REASON)
        if connection.session:
            self.board.disconnect(self._clock(), cause)
            self._controller = ""
            self._say(cause)
        elif connection.role is None and self._strangers_lines.take(self._clock()):
            self._say(cause)

    def _receive(self, connection: Connection) -> None:
        try:
            frame = connection.receive()
        except FrameError as error:
            self._refuse_and_drop(connection, RefusalCode.FRAME, str(error))
            return
        if frame is None:
            return
        now = connection.heard = self._clock()
        try:
            self._handle(connection, frame, now)
        except RefusedError as refusal:
            self._refuse(connection, refusal.code, str(refusal), frame)
            if connection.role is None:
                raise DropError(f"{connection.peer} was refused: {refusal}") from refusal
        if not connection.allowance.take(now):
            reason = f"more than {connection.allowance.rate} frames a second"
            self._refuse_and_drop(connection, RefusalCode.NOISE, reason)

    def _handle(self, connection: Connection, frame: Frame, now: int) -> None:
        message = frame.message
        if frame.type is FrameType.ARM and not message.arm:
            # Before everything that could be in its way: anyone may vent, a stranger, too.
            self.board.disarm(now, f"disarmed by {quote(message.arm_person) or connection.peer}")
            connection.send(message, now)
            return
        connection.count(frame)
        if connection.role is None:
            self._admit(connection, frame, now)
            return
        controller = connection.role is ClientRole.CONTROLLER
        if controller:
            self.board.heard(now)
        if frame.type is FrameType.CLOCK:
            message.heard_utime, message.answered_utime = now, self._clock()
            connection.send(message, now)
        elif frame.type is FrameType.ARM and not controller:
            self._arm(connection, frame, now)
        elif frame.type is FrameType.COMMAND and controller:
            self.board.command(message, now)
        elif frame.type is FrameType.TRIAL and controller:
            kind = quote(message.announced_kind)
            self._say(f"{kind} trial {message.announced_index}, seed {message.announced_seed}")
            self._on_trial(message)
            connection.send(message, now)
        else:
            name = frame.type.name.lower()
            raise RefusedError(RefusalCode.ROLE, f"a {connection.role} may not send a frame of type {name}")

    def _admit(self, connection: Connection, frame: Frame, now: int) -> None:
        """Challenge a stranger, and welcome it when it has proven that it knows the secret."""
        message, hello = frame.message, connection.hello
        if hello is None:
            if frame.type is not FrameType.HELLO:
                raise RefusedError(RefusalCode.FRAME, "the first frame must be a hello")
            check_hello(message)
            connection.hello = message
            challenge = board_challenge_t()
            challenge.challenge_nonce = connection.nonce
            connection.send(challenge, now)
            return
        if frame.type is not FrameType.PROOF:
            raise RefusedError(RefusalCode.FRAME, "a proof must follow the challenge")
        if self._secret:
            check_proof(message.hello_proof, prove_hello(self._secret, connection.nonce, hello))
        role = ClientRole(hello.client_role)
        if role is ClientRole.CONTROLLER:
            session = 1 + secrets.randbits(62)
            self.board.connect(session, bool(hello.wants_dry_run), now)
            connection.session = session
            self._controller = f"{quote(hello.client_name)} at {connection.peer}"
            self._say(f"controller {self._controller}" + (", dry run" if self.board.dry_run else ""))
        else:
            self._make_room([one for one in self._connections if one.role is ClientRole.OPERATOR], MAX_OPERATORS)
        connection.welcome(role, now)
        connection.send(make_welcome(self._config, self.board, self._controller), now)

    def _arm(self, connection: Connection, frame: Frame, now: int) -> None:
        message = frame.message
        if self._secret:
            proof = prove_arming(self._secret, connection.nonce, frame.sequence, message)
            check_proof(message.arm_proof, proof)
        entered = self.board.entered
        if message.arm_seen_utime != entered and message.arm_session == self.board.session:
            state = self.board.state.name.lower()
            raise RefusedError(RefusalCode.SESSION, f"the board is {state} since; look again, then arm")
        self.board.arm(message.arm_session, now)
        if self.board.entered != entered:
            self._say(f"armed by {quote(message.arm_person)} for {self._controller}")

    def _refuse(self, connection: Connection, code: RefusalCode, reason: str, frame: Frame | None) -> None:
        message = board_refusal_t()
        message.refusal_code, message.refusal_reason = code.value, quote(reason, LONGEST_REASON)
        if frame is not None:
            message.refused_frame_type, message.refused_frame_sequence = frame.type, frame.sequence
        connection.send(message, self._clock())

    def _refuse_and_drop(self, connection: Connection, code: RefusalCode, reason: str) -> None:
        self._refuse(connection, code, reason, None)
        raise DropError(f"{connection.peer}: {reason}")


def _listen(address: tuple[str, int], is_open: bool) -> socket.socket:
    """Listen; without a secret on this machine's own addresses alone."""
    host, port = address
    try:
        listener = socket.create_server(address)
    except OSError as error:
        raise BackendError(f"cannot listen on {host}:{port}: {error.strerror}; is another board running?") from error
    if is_open and not ipaddress.ip_address(listener.getsockname()[0]).is_loopback:
        listener.close()
        raise ConfigError(
            f"without a secret the board listens on 127.0.0.1 alone, not on {host}; name a file as `secret` in its "
            "config, see docs/hardware.md"
        )
    listener.setblocking(False)
    return listener
