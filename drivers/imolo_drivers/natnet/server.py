"""The side of Motive, for the emulator and for playback; it never waits."""

import contextlib
import logging
import socket
import time
from typing import Self

from imolo.errors import NatNetError
from imolo_drivers.natnet import messages as m
from imolo_drivers.natnet.config import NatNetServerConfig
from imolo_drivers.natnet.decoder import decode
from imolo_drivers.natnet.encoder import encode
from imolo_drivers.natnet.wire import MAX_PACKET, Version, check_version

logger = logging.getLogger(__name__)

Address = tuple[str, int]
CLOCK_FREQUENCY = 10_000_000  # [ticks/s] of Windows' performance counter on today's computers
MOST_PACKETS = 500  # in one poll


class NatNetServer:
    """Answers clients and sends frames, in unicast to every client that has connected; times are monotonic [s].

    Attributes:
        definitions: What is answered to a client that asks for the models.
        clock_start: Monotonic time at which the server's clock shows 0 [s].
        asked: Whether a client has asked for the models, and so is ready for frames.
        unreadable: Packets that could not be decoded.
        unsent: Frames that the network did not take.
    """

    def __init__(
        self,
        config: NatNetServerConfig,
        version: Version = (4, 1),
        *,
        definitions: m.ModelDefinitions | None = None,
        name: str = "imolo",
        server_version: tuple[int, int, int, int] = (0, 0, 0, 0),
        clock_frequency: int = CLOCK_FREQUENCY,
        clock_start: float = 0.0,
    ) -> None:
        """Open the sockets.

        Args:
            config: Where.
            version: What packets are written in.
            definitions: The models.
            name: Of the program.
            server_version: Of the program.
            clock_frequency: Of the server's clock [ticks/s].
            clock_start: Monotonic time at which the server's clock shows 0 [s].

        Raises:
            NatNetVersionError: `version` is not supported.
            NatNetError: This machine does not have the address, or the port is taken.
        """
        check_version(version)
        self.definitions = definitions or m.ModelDefinitions()
        self.asked = False
        self.unreadable = 0
        self.unsent = 0
        self._config = config
        self._version = version
        self.clock_start = clock_start
        self._clients: dict[Address, float] = {}  # when each was last heard
        self._group = None if config.multicast_group is None else str(config.multicast_group)
        self._info = m.ServerInfo(name, server_version, version, clock_frequency, config.data_port, self._group)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            if self._group is not None:
                self._socket.setsockopt(
                    socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(str(config.address))
                )
                self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, config.ttl)
            self._socket.bind((str(config.address), config.command_port))
        except OSError as error:
            self._socket.close()
            raise NatNetError(f"no NatNet server on {config.address}:{config.command_port}: {error}") from None

    @property
    def port(self) -> int:
        """The command port."""
        return int(self._socket.getsockname()[1])

    @property
    def clients(self) -> tuple[Address, ...]:
        """Who has connected, in unicast."""
        return tuple(self._clients)

    def fileno(self) -> int:
        """Return what becomes readable when there is something to `poll`."""
        return self._socket.fileno()

    def ticks(self, now: float) -> int:
        """Return what the server's clock shows at a time [s]."""
        return round((now - self.clock_start) * self._info.clock_frequency)

    def poll(self, now: float) -> None:
        """Answer what came, and forget unicast clients that have been silent for the `client_timeout`."""
        for _ in range(MOST_PACKETS):
            try:
                packet, client = self._socket.recvfrom(MAX_PACKET)
            except BlockingIOError:
                break
            except OSError:  # the network's echo of something that we sent
                continue
            self._answer(packet, client, now)
        limit = now - self._config.client_timeout
        self._clients = {client: heard for client, heard in self._clients.items() if heard >= limit}

    def send(self, frame: m.Frame) -> None:
        """Send a frame to the group, or to every client.

        Raises:
            NatNetError: The frame cannot be encoded.
        """
        self.send_packet(encode(frame, self._version))

    def send_packet(self, packet: bytes) -> None:
        """Send the bytes of a frame as they are."""
        receivers = [(self._group, self._config.data_port)] if self._group is not None else list(self._clients)
        for receiver in receivers:
            try:
                self._socket.sendto(packet, receiver)
            except OSError as error:
                self.unsent += 1
                logger.debug("frame not sent to %s: %s", receiver, error)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _answer(self, packet: bytes, client: Address, now: float) -> None:
        try:
            message = decode(packet, self._version)
        except NatNetError as problem:
            self.unreadable += 1
            logger.debug("unreadable packet from %s: %s", client, problem)
            return
        if client in self._clients:
            self._clients[client] = now
        match message:
            case m.Discovery():
                self._reply(self._info, client)
            case m.Connect():
                self._clients[client] = now
                self._reply(self._info, client)
            case m.Disconnect():
                self._clients.pop(client, None)
            case m.ModelDefinitionsRequest():
                self.asked = True
                self._reply(self.definitions, client)
            case m.EchoRequest(sent):
                # Read anew: what came after `now` would be answered with a time before it was asked.
                self._reply(m.EchoResponse(sent, self.ticks(time.monotonic())), client)
            case m.Request():
                self._reply(m.UnrecognizedRequest(), client)

    def _reply(self, message: m.Message, client: Address) -> None:
        with contextlib.suppress(OSError):  # as good as lost on the way; the client asks again
            self._socket.sendto(encode(message, self._version), client)
