"""A NatNet client that never waits: its owner selects on `fileno` and calls `poll`."""

import contextlib
import logging
import selectors
import socket
import time
from collections.abc import Callable
from typing import Self

from imolo.errors import NatNetError, NatNetVersionError
from imolo_drivers.natnet import messages as m
from imolo_drivers.natnet.clock import ServerClock
from imolo_drivers.natnet.config import NatNetConfig
from imolo_drivers.natnet.decoder import decode
from imolo_drivers.natnet.encoder import encode
from imolo_drivers.natnet.wire import MAX_PACKET, SUPPORTED, MessageId

logger = logging.getLogger(__name__)

LATE_FRAMES = 120  # a number up to this far back is a late frame, farther back a restart; assumed: 1 s at 120 Hz
LATE_IN_ORDER = 3  # so many late ones that count upwards are a restart, such as a take in a loop; assumed
MOST_PACKETS = 500  # in one poll, so that a flood cannot hold it up; assumed: 4 s at 120 Hz
REQUEST_VERSION = SUPPORTED[0]  # what a client says looks the same in all of them


class NatNetClient:
    """Talks to Motive and collects its frames; all times are of the monotonic clock [s].

    Attributes:
        server: What the server said of itself; None before that.
        definitions: The models it streams; None before it said so.
        lost: Frames whose numbers never came.
        late: Frames that came after a later one, or twice, or began a take anew, and were left out.
        unreadable: Packets of the server that could not be decoded.
        last_problem: What was wrong with the last of those, empty if there was none.
        elsewhere: Address that answered in the place of the server's; empty if none did.
    """

    def __init__(self, config: NatNetConfig, clock: Callable[[], float] = time.monotonic) -> None:
        """Open the socket; nothing is sent before the first `poll`.

        Args:
            config: Where the server is.
            clock: Our monotonic clock [s].

        Raises:
            NatNetError: This machine does not have the local address.
        """
        self.server: m.ServerInfo | None = None
        self.definitions: m.ModelDefinitions | None = None
        self._outdated = False  # the definitions, which are good until others have come
        self.lost = 0
        self.late = 0
        self.unreadable = 0
        self.last_problem = ""
        self.elsewhere = ""
        self._config, self._read_clock = config, clock
        self._server_address = str(config.server_address)
        self._local_address = str(config.local_address)
        self._clock: ServerClock | None = None
        self._last_number: int | None = None
        self._late_numbers: list[int] = []  # since the last frame that was none
        self._last_frame = -float("inf")
        self._started: float | None = None
        self._due: dict[type[m.Message], float] = {}
        self._echo_sent: int | None = None
        self._data_socket: socket.socket | None = None
        self._selector = selectors.DefaultSelector()
        self._command_socket = self._open(self._local_address, 0)

    def fileno(self) -> int:
        """Return what becomes readable when there is something to `poll`."""
        return self._selector.fileno()  # type: ignore[no-any-return, attr-defined, unused-ignore]

    def poll(self) -> list[m.Frame]:
        """Read what came, say what is due, and return the new frames in order.

        Call it when `fileno` is readable, and at least every `retry_interval`.

        Raises:
            NatNetVersionError: The server speaks an unsupported version.
            NatNetError: The multicast group that the server names cannot be joined.
        """
        now = self._read_clock()
        if self._started is None:
            self._started = now
        frames: list[m.Frame] = []
        for _ in range(MOST_PACKETS):
            readable = self._selector.select(0)
            if not readable:
                break
            for key, _ in readable:
                self._receive(key.fileobj, now, frames)  # type: ignore[arg-type]
        self._say_what_is_due(now)
        return frames

    @property
    def heard(self) -> float:
        """When the last frame came, or the first poll was if there was none [s]; minus infinity before that."""
        return -float("inf") if self._started is None else max(self._last_frame, self._started)

    @property
    def lost_at(self) -> float:
        """When the stream will be lost if no frame comes [s], `silence_limit` after the last one."""
        return self.heard + self._config.silence_limit

    def silence(self, now: float) -> float:
        """Return the time since the last frame, or the first poll if there was none [s]; infinity before that."""
        return now - self.heard

    def is_lost(self, now: float) -> bool:
        """Return whether frames are missing for the `silence_limit`."""
        return now >= self.lost_at

    def missing(self, patience: float) -> str:
        """Return a sentence about frames that have not come for `patience` [s], and about what came in their place."""
        config = self._config
        if self.last_problem:
            came = f"{self.unreadable} packets from there cannot be read, the last one: {self.last_problem}"
        elif self.server is not None and self._late_numbers:
            came = (
                f"{self.server.name} sends frames whose numbers do not count upwards, the last one is "
                f"{self._late_numbers[-1]}; is its take paused, or played backwards?"
            )
        elif self.server is not None:
            what = "no frames" if self.definitions is not None else "no model definitions"
            came = f"{self.server.name} answers but sends {what}; is it streaming, and is its take not paused?"
        elif self.elsewhere:
            came = f"{self.elsewhere} answers in its place; is that to be cameras.server_address?"
        else:
            came = "nothing came; is it streaming, and is cameras.local_address the network card towards it?"
        return f"no frames from Motive at {config.server_address}:{config.command_port} within {patience:g} s: {came}"

    def exposure_time(self, frame: m.Frame) -> tuple[float, float] | None:
        """Return our time of the middle of a frame's exposure and its greatest error [s].

        None if the cameras do not tell it, or before the first echo.
        """
        if self._clock is None or frame.mid_exposure == 0:
            return None
        return self._clock.local_time(frame.mid_exposure)

    def close(self) -> None:
        """Tell the server, and close the sockets."""
        self._send(m.Disconnect())
        self._selector.close()
        self._command_socket.close()
        if self._data_socket is not None:
            self._data_socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self, address: str, port: int, group: str | None = None) -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            if group is not None:
                opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                membership = socket.inet_aton(group) + socket.inet_aton(self._local_address)
                opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            opened.bind((address, port))
        except OSError as error:
            opened.close()
            what = f"the multicast group {group}:{port} of Motive cannot be joined" if group else "no NatNet socket"
            raise NatNetError(
                f"{what} on local_address {self._local_address}: {error}; set it to the address of the network card "
                "towards Motive"
            ) from None
        self._selector.register(opened, selectors.EVENT_READ)
        return opened

    def _receive(self, source: socket.socket, now: float, frames: list[m.Frame]) -> None:
        try:
            packet, (address, _port) = source.recvfrom(MAX_PACKET)
        except OSError:  # nothing there after all, or the network's echo of something that we sent
            return
        if address != self._server_address:
            self.elsewhere = address
            return
        try:
            message = decode(packet, self.server.natnet_version if self.server else None)
        except NatNetVersionError:
            raise
        except NatNetError as problem:
            self.unreadable += 1
            # That frames cannot be read before the server has told its version says less than why it has not.
            if self.server is not None or packet[:1] != bytes([MessageId.FRAME]) or not self.last_problem:
                self.last_problem = str(problem)
            logger.debug("unreadable packet from Motive: %s", problem)
            return
        match message:
            case m.Frame():
                self._take_frame(message, now, frames)
            case m.ServerInfo():
                self._take_server(message, now)
            case m.ModelDefinitions():
                self.definitions, self._outdated = message, False
            case m.EchoResponse(sent, ticks) if sent == self._echo_sent and self._clock is not None:
                self._echo_sent = None
                # Read anew: what came after `now` would have taken less time than it did.
                self._clock.add_echo(sent * 1e-9, ticks, self._read_clock())

    def _take_frame(self, frame: m.Frame, now: float, frames: list[m.Frame]) -> None:
        if self._last_number is not None:
            step = frame.number - self._last_number
            if -LATE_FRAMES <= step <= 0 and not self._counts_anew(frame.number):
                self.late += 1
                return
            self.lost += max(step - 1, 0)
        self._late_numbers.clear()
        self._last_number = frame.number
        self._last_frame = now
        self._outdated |= frame.models_changed
        frames.append(frame)

    def _counts_anew(self, number: int) -> bool:
        """Return whether a late frame is one of several that count upwards, with none between them that is not late."""
        if self._late_numbers and number <= self._late_numbers[-1]:
            self._late_numbers.clear()
        self._late_numbers.append(number)
        return len(self._late_numbers) >= LATE_IN_ORDER

    def _take_server(self, server: m.ServerInfo, now: float) -> None:
        known, self.server = self.server, server
        if known == server:
            return
        logger.info("%s %s speaks NatNet %d.%d", server.name, server.server_version, *server.natnet_version)
        self._clock = ServerClock(server.clock_frequency, self._config.clock_drift)
        self.definitions = None
        if self._data_socket is not None:
            self._selector.unregister(self._data_socket)
            self._data_socket.close()
            self._data_socket = None
        if server.multicast_group is not None:
            self._data_socket = self._open(server.multicast_group, server.data_port, server.multicast_group)

    def _say_what_is_due(self, now: float) -> None:
        config = self._config
        if self.server is None or self.silence(now) > max(config.silence_limit, config.retry_interval):
            self._say(m.Connect(), now, config.retry_interval)
        if self.server is None:
            return
        if self.definitions is None or self._outdated:
            self._say(m.ModelDefinitionsRequest(), now, config.retry_interval)
        if self.server.multicast_group is None:
            self._say(m.KeepAlive(), now, config.keep_alive_interval)
        sent = round(now * 1e9)
        if self._say(m.EchoRequest(sent), now, config.echo_interval):
            self._echo_sent = sent

    def _say(self, message: m.Message, now: float, interval: float) -> bool:
        """Send a message unless one of its kind was sent less than an interval [s] ago."""
        kind = type(message)
        if now < self._due.get(kind, -float("inf")):
            return False
        self._due[kind] = now + interval
        self._send(message)
        return True

    def _send(self, message: m.Message) -> None:
        # What cannot be sent now, because the network is down or full, is said again later.
        with contextlib.suppress(OSError):
            address = (self._server_address, self._config.command_port)
            self._command_socket.sendto(encode(message, REQUEST_VERSION), address)
