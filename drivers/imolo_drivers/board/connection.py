"""One client of the board: what it may say, what it has not finished saying, and what it has not read."""

import secrets
import socket
from typing import Any

from imolo_drivers.board.command import is_newer
from imolo_drivers.board.framing import Frame, FrameDecoder, FrameType, encode_frame, frame_bytes
from imolo_drivers.board.handshake import NONCE_SIZE, ClientRole
from imolo_drivers.board.refusal import RefusalCode, RefusedError
from imolo_msgs import board_hello_t

RECEIVE = 16384  # [bytes] taken at once
SECOND = 1_000_000  # [µs]
UNSENT = 65536  # [bytes] kept for a client that does not read, until it is dropped; as many in the kernel


class DropError(Exception):
    """A connection is to be closed."""


class Allowance:
    """How often something may happen: a number at once, which grows back at a rate."""

    def __init__(self, rate: int, burst: int, utime: int) -> None:
        """Allow `burst` at once, and `rate` [1/s] in the long run."""
        self.rate, self.burst = rate, burst
        self._left, self._utime = burst * SECOND, utime  # of one time, in millionths

    def take(self, utime: int) -> bool:
        """Return whether it may happen once more at `utime` [µs]."""
        grown = self._left + max(utime - self._utime, 0) * self.rate
        self._left, self._utime = min(grown, self.burst * SECOND), utime
        if self._left < SECOND:
            return False
        self._left -= SECOND
        return True


# [1/s] and at once. A stranger says hello, proves itself, and may disarm; a controller commands at 120 Hz and asks for
# the time at 50 Hz.
STRANGER, OPERATOR, CONTROLLER = (1, 4), (100, 100), (1000, 500)


class Connection:
    """A client.

    Attributes:
        link: Its socket.
        peer: Its address, for people.
        host: Its host.
        since: When it connected [µs].
        heard: When it said something last [µs].
        decoder: What it has not finished saying.
        hello: What it said first; None before that.
        nonce: What it must prove itself with.
        role: Who it is; None for a stranger, which has not proven that it knows the secret.
        session: As a controller; 0 for others.
        unsent: What it has not read.
    """

    def __init__(self, link: socket.socket, peer: tuple[str, int], utime: int) -> None:
        """Begin with a stranger."""
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, UNSENT)
        self.peer, self.host, self.since, self.heard = f"{peer[0]}:{peer[1]}", peer[0], utime, utime
        self.decoder = FrameDecoder()
        self.hello: board_hello_t | None = None
        self.nonce = secrets.token_bytes(NONCE_SIZE)
        self.role: ClientRole | None = None
        self.session = 0
        self.unsent = b""
        self.allowance = Allowance(*STRANGER, utime)
        self.link = link
        self._received: int | None = None
        self._sent = 0

    def fileno(self) -> int:
        """Return the file descriptor, for `select`."""
        return self.link.fileno()

    def welcome(self, role: ClientRole, utime: int) -> None:
        """Be no stranger any more."""
        self.role = role
        self.allowance = Allowance(*(CONTROLLER if role is ClientRole.CONTROLLER else OPERATOR), utime)

    def receive(self) -> Frame | None:
        """Return the next frame, if it is whole.

        Raises:
            DropError: The client has closed the link.
            FrameError: It does not send frames.
            OSError: The link broke.
        """
        if not self.decoder.has_frame:
            data = self.link.recv(RECEIVE)
            if not data:
                raise DropError(f"{self.peer} closed the link")
            self.decoder.add(data)
        return self.decoder.next()

    def count(self, frame: Frame) -> None:
        """Note the number of a frame.

        Raises:
            RefusedError: It is not newer than the last one.
        """
        if self._received is not None and not is_newer(frame.sequence, self._received):
            raise RefusedError(RefusalCode.STALE, f"frame {frame.sequence} is not newer than {self._received}")
        self._received = frame.sequence

    def send(self, message: Any, utime: int) -> None:
        """Send a message, or keep it until the client reads."""
        self._send(encode_frame(message, self._sent, utime))

    def send_payload(self, frame_type: FrameType, payload: bytes, utime: int) -> None:
        """Send a message that is encoded already, since others get the same."""
        self._send(frame_bytes(frame_type, payload, self._sent, utime))

    def flush(self) -> None:
        """Send what has been kept.

        Raises:
            DropError: Too much has been kept.
            OSError: The link broke.
        """
        try:
            count = self.link.send(self.unsent)
        except BlockingIOError:
            count = 0
        self.unsent = self.unsent[count:]
        if len(self.unsent) > UNSENT:
            raise DropError(f"{self.peer} does not read what the board says")

    def close(self) -> None:
        """Let the client go."""
        self.link.close()

    def _send(self, data: bytes) -> None:
        self._sent += 1
        self.unsent += data
        self.flush()
