"""The PC end of the link to the valve board: connects, compares the clocks, sends commands, hears the state."""

import select
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from imolo.errors import BackendError
from imolo_drivers.board.connection import RECEIVE
from imolo_drivers.board.framing import SEQUENCES, Frame, FrameDecoder, FrameError, FrameType, encode_frame
from imolo_drivers.board.handshake import NO_PROOF, ClientRole, make_hello, prove_arming, prove_hello
from imolo_drivers.board.refusal import quote
from imolo_drivers.board.server import monotonic_utime
from imolo_msgs import (
    actuator_command_t,
    board_arm_t,
    board_challenge_t,
    board_clock_t,
    board_proof_t,
    board_refusal_t,
    board_state_t,
    board_trial_t,
    board_welcome_t,
)

FIRST_PAUSE, LONGEST_PAUSE = 0.05, 1.0  # [s] between two attempts to connect, doubled from one to the next
PATIENCE = 2.0  # [s] for an answer of the board, assumed
ROUNDS = 20  # round trips that the offset of the clocks is chosen from at first
MEMORY = 64  # round trips that are remembered: about a second of them, in which crystals part by some 50 µs


class LinkLostError(BackendError):
    """The link to the valve board broke; the board vents by itself."""


class ClockOffset:
    """What the clock of the board is ahead of ours, from the round trip that took the least time.

    The offset of a round trip is off by half of it at most, so the shortest of the last ones is the best.
    """

    def __init__(self) -> None:
        """Know nothing."""
        self._rounds: deque[tuple[int, int]] = deque(maxlen=MEMORY)

    @property
    def utime(self) -> int:
        """The board's clock less ours [µs]."""
        return min(self._rounds)[1]

    @property
    def uncertainty(self) -> int:
        """How far `utime` may be off [µs]."""
        return (min(self._rounds)[0] + 1) // 2

    def __len__(self) -> int:
        return len(self._rounds)

    def add(self, asked: int, heard: int, answered: int, received: int) -> int:
        """Note a round trip by its four times [µs], the middle ones by the board's clock; return its disagreement.

        Returns:
            By how much offset and round trip contradict what was known [µs]; more than 0 where a clock has jumped.
        """
        duration = (received - asked) - (answered - heard)
        offset = ((heard - asked) + (answered - received)) // 2
        contradiction = 0
        if self._rounds:
            contradiction = abs(offset - self.utime) - (duration + 1) // 2 - self.uncertainty
        self._rounds.append((max(duration, 0), offset))
        return max(contradiction, 0)


class BoardClient:
    """A connection to the valve board.

    Attributes:
        welcome: What the board said of itself.
        offset: Of its clock.
        state: Newest state it told; None before one.
        refusals: What it did not do, the newest last.
        announced: Whether the board has confirmed what the session is for.
        jumped: Largest contradiction between the clocks [µs], see `ClockOffset.add`.
    """

    def __init__(
        self,
        address: tuple[str, int],
        role: ClientRole,
        name: str,
        patience: float = PATIENCE,
        dry_run: bool = False,
        clock: Callable[[], int] = monotonic_utime,
        secret: bytes = b"",
    ) -> None:
        """Connect and shake hands; try again with growing pauses while nobody answers.

        Args:
            address: Host and port of the board.
            role: What this client is there for.
            name: Who it is, for the log of the board.
            patience: How long to try, and to wait for each answer [s].
            dry_run: Whether nothing is to move.
            clock: Our own [µs].
            secret: What the board must know, too; empty for a board without.

        Raises:
            BackendError: Nobody answers, or the board refuses.
        """
        self.offset, self.state, self.jumped = ClockOffset(), board_state_t(), 0
        self.announced = self._disarmed = False
        self.refusals: deque[board_refusal_t] = deque(maxlen=100)
        self._clock, self._address, self._secret, self._patience = clock, address, secret, patience
        self._challenge = board_challenge_t()
        self._states: list[board_state_t] = []
        self._decoder = FrameDecoder()
        self._sent = 0
        self._link = _connect(address, patience)
        try:
            self.welcome = self._shake_hands(role, quote(name), dry_run)
        except BackendError:
            self._link.close()
            raise

    def fileno(self) -> int:
        """Return the file descriptor, for `select`."""
        return self._link.fileno()

    def synchronise(self, rounds: int = ROUNDS) -> None:
        """Ask for the board's time a few times, one after the other.

        Raises:
            BackendError: The board does not answer.
        """
        for _ in range(rounds):
            known = len(self.offset)
            self.ask_time()
            self._wait_for(lambda known=known: len(self.offset) > known, "its time")  # type: ignore[misc]

    def ask_time(self) -> None:
        """Ask for the board's time; `poll` takes the answer. It also shows the board that we are there."""
        message = board_clock_t()
        message.asked_utime = self._clock()
        self._send(message)

    def announce(self, kind: str, index: int, seed: int) -> None:
        """Tell the board what the session is for; it confirms with the same words."""
        message = board_trial_t()
        message.announced_kind, message.announced_index, message.announced_seed = kind, index, seed
        self._send(message)

    def arm(self, session: int, person: str, seen_utime: int | None = None) -> None:
        """Arm the controller of this session, for a person who has said so.

        Args:
            session: Of the controller.
            person: Who, for the log of the board.
            seen_utime: When the board came into the state that the person saw [µs]; by default the newest one known.
        """
        message = board_arm_t()
        message.arm_session, message.arm, message.arm_person = session, 1, quote(person)
        seen = self.state.entered_utime if self.state.state_number else self.welcome.entered_at_welcome
        message.arm_seen_utime = seen if seen_utime is None else seen_utime
        sequence = self._sent % SEQUENCES
        message.arm_proof = prove_arming(self._secret, self._challenge.challenge_nonce, sequence, message)
        self._send(message)

    def disarm(self, person: str) -> None:
        """Vent and disarm, and wait until the board has: closed with states unread, a link takes the frame with it.

        Raises:
            LinkLostError: The link broke, or the board does not answer.
        """
        self._disarmed = False
        self._send(make_disarm(person))
        self._wait_for(lambda: self._disarmed, "that it is disarmed")

    def command(self, message: actuator_command_t) -> None:
        """Send commands, their times on the board's clock."""
        self._send(message)

    def poll(self) -> list[board_state_t]:
        """Take what has arrived; return the states that are new, the oldest first.

        Raises:
            LinkLostError: The link broke, or what came over it is damaged.
        """
        while select.select((self._link,), (), (), 0.0)[0]:
            try:
                data = self._link.recv(RECEIVE)
            except OSError as error:
                raise self._lost(error.strerror or str(error)) from error
            if not data:
                reason = self.refusals[-1].refusal_reason if self.refusals else "the board closed it"
                raise self._lost(reason)
            received = self._clock()
            try:
                frames = self._decoder.feed(data)
            except FrameError as error:
                raise self._lost(str(error)) from error
            for frame in frames:
                self._take(frame, received)
        states, self._states = self._states, []
        return states

    def wait(self, until: Callable[[], bool], patience: float) -> bool:
        """Poll until something is true, for `patience` [s] at most; return whether it is.

        Raises:
            LinkLostError: The link broke.
        """
        end = time.monotonic() + patience
        while not until():
            left = end - time.monotonic()
            if left <= 0.0:
                return False
            select.select((self._link,), (), (), min(left, 0.02))
            self.poll()
        return True

    def close(self) -> None:
        """Let the board go; it vents, if it was armed for us."""
        self._link.close()

    def _take(self, frame: Frame, received: int) -> None:
        message = frame.message
        if frame.type is FrameType.STATE:
            self.state = message
            self._states.append(message)
        elif frame.type is FrameType.CLOCK:
            times = (message.asked_utime, message.heard_utime, message.answered_utime)
            self.jumped = max(self.jumped, self.offset.add(*times, received))
        elif frame.type is FrameType.REFUSAL:
            self.refusals.append(message)
        elif frame.type is FrameType.CHALLENGE:
            self._challenge = message
        elif frame.type is FrameType.WELCOME:
            self.welcome = message
        elif frame.type is FrameType.TRIAL:
            self.announced = True
        elif frame.type is FrameType.ARM:  # a disarming that has been done
            self._disarmed = True
        else:
            raise self._lost(f"the board sent a frame of type {frame.type.name.lower()}")

    def _shake_hands(self, role: ClientRole, name: str, dry_run: bool) -> board_welcome_t:
        self.welcome = board_welcome_t()
        hello = make_hello(role, name, dry_run)
        self._send(hello)
        self._shaken(lambda: bool(self._challenge.challenge_nonce), "anything")
        proof = board_proof_t()
        proof.hello_proof = prove_hello(self._secret, self._challenge.challenge_nonce, hello)
        self._send(proof)
        self._shaken(lambda: bool(self.welcome.welcome_version), "its welcome")
        return self.welcome

    def _shaken(self, until: Callable[[], bool], what: str) -> None:
        self._wait_for(lambda: until() or bool(self.refusals), what)
        if self.refusals:
            raise BackendError(f"the board at {self._where} refuses: {self.refusals[-1].refusal_reason}")

    def _wait_for(self, until: Callable[[], bool], what: str) -> None:
        if not self.wait(until, self._patience):
            raise LinkLostError(f"the board at {self._where} did not tell {what} for {self._patience:g} s")

    def _send(self, message: Any) -> None:
        """Send a frame with one call: two of them would wait 40 ms for each other's acknowledgement."""
        data = encode_frame(message, self._sent, self._clock())
        self._sent += 1
        try:
            self._link.sendall(data)
        except OSError as error:
            raise self._lost(error.strerror or str(error)) from error

    @property
    def _where(self) -> str:
        return f"{self._address[0]}:{self._address[1]}"

    def _lost(self, reason: str) -> LinkLostError:
        return LinkLostError(f"the link to the valve board at {self._where} is lost: {reason}")


def make_disarm(person: str) -> board_arm_t:
    """Return the message that vents; it needs no handshake before it."""
    message = board_arm_t()
    message.arm_person, message.arm_proof = quote(person), NO_PROOF
    return message


def disarm(address: tuple[str, int], person: str) -> None:
    """Vent a board, whoever may be connected to it, and wait until it has.

    Args:
        address: Host and port of the board.
        person: Who wants it, for the log of the board.

    Raises:
        BackendError: The board does not say that it has vented.
    """
    reason = f"nothing heard of it for {PATIENCE:g} s"
    with _connect(address, PATIENCE) as link:
        try:
            link.sendall(encode_frame(make_disarm(person), 0, monotonic_utime()))
            decoder = FrameDecoder()
            while data := link.recv(RECEIVE):
                for frame in decoder.feed(data):
                    if frame.type is FrameType.ARM:
                        return
                    if frame.type is FrameType.REFUSAL:
                        reason = frame.message.refusal_reason
        except (OSError, FrameError) as error:
            reason = str(error)
    raise BackendError(
        f"the board at {address[0]}:{address[1]} does not say that it is disarmed ({reason}); close the air supply"
    )


def _connect(address: tuple[str, int], patience: float) -> socket.socket:
    end, pause = time.monotonic() + patience, FIRST_PAUSE
    while True:
        try:
            link = socket.create_connection(address, timeout=PATIENCE)
        except OSError as error:
            if time.monotonic() + pause > end:
                where = f"{address[0]}:{address[1]}"
                reason = error.strerror or str(error)
                raise BackendError(
                    f"no valve board answers at {where}: {reason}; start `imolo board` or `imolo emulate`"
                ) from error
        else:
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            link.settimeout(PATIENCE)
            return link
        time.sleep(pause)
        pause = min(2.0 * pause, LONGEST_PAUSE)
