"""Plays a recorded capture of NatNet traffic over UDP: `python -m imolo_drivers.natnet.playback FILE`."""

import select
import time
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Self

import typer

from imolo.errors import ImoloError, NatNetError
from imolo.machine.extras import import_extra
from imolo_drivers.natnet.config import NatNetServerConfig
from imolo_drivers.natnet.decoder import decode
from imolo_drivers.natnet.messages import Frame, ModelDefinitions, ServerInfo
from imolo_drivers.natnet.server import NatNetServer
from imolo_drivers.natnet.wire import HEADER, MessageId

MOST_FRAMES = 32  # in one poll, less than a socket's buffer holds


@dataclass(frozen=True)
class Recording:
    """What a server said: itself, its models, and the packets of its frames with the time they came [s]."""

    server: ServerInfo
    definitions: ModelDefinitions
    frames: tuple[tuple[float, bytes], ...]

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a pcap or pcapng file of one server.

        Raises:
            MissingToolError: dpkt is not installed.
            NatNetError: The file is not a capture, or holds no handshake.
        """
        packets = _udp_packets(path)
        kinds = [HEADER.unpack_from(payload)[0] if len(payload) >= HEADER.size else None for _, _, payload in packets]
        if MessageId.SERVER_INFO not in kinds:
            raise NatNetError(f"{path} holds no answer of a NatNet server; record from before the client connects")
        first = packets[kinds.index(MessageId.SERVER_INFO)]
        server = decode(first[2], None)
        assert isinstance(server, ServerInfo)
        definitions = ModelDefinitions()
        frames = []
        for kind, (when, source, payload) in zip(kinds, packets, strict=True):
            if source != first[1]:
                continue
            if kind == MessageId.MODEL_DEFINITIONS:
                message = decode(payload, server.natnet_version)
                assert isinstance(message, ModelDefinitions)
                definitions = message
            elif kind == MessageId.FRAME:
                frames.append((when, payload))
        return cls(server, definitions, tuple(frames))


class Playback:
    """A server that says again what was recorded, to clients that ask for it; the frames begin when one is ready."""

    def __init__(self, recording: Recording, config: NatNetServerConfig, speed: float = 1.0) -> None:
        """Open the server.

        Args:
            recording: What to play.
            config: Where.
            speed: Times the recorded pace; infinity is as fast as `poll` is called.

        Raises:
            NatNetError: See `NatNetServer`.
        """
        self._frames = recording.frames
        self._speed = speed
        self._next = 0
        self._started: float | None = None
        first = decode(recording.frames[0][1], recording.server.natnet_version) if recording.frames else None
        transmitted = first.transmitted if isinstance(first, Frame) else 0
        self._first_transmission = transmitted / recording.server.clock_frequency
        self._server = NatNetServer(
            config,
            recording.server.natnet_version,
            definitions=recording.definitions,
            name=recording.server.name,
            server_version=recording.server.server_version,
            clock_frequency=recording.server.clock_frequency,
        )

    @property
    def port(self) -> int:
        """The command port."""
        return self._server.port

    @property
    def over(self) -> bool:
        """Whether all frames were sent."""
        return self._next == len(self._frames)

    def poll(self, now: float) -> None:
        """Answer clients and send the frames that are due at a monotonic time [s]."""
        self._server.poll(now)
        if self._started is None:
            if not self._server.asked:
                return
            self._started = now
            # From here on the server's clock is that of the recording.
            self._server.clock_start = now - self._first_transmission
        for _ in range(MOST_FRAMES):
            if self.over:
                break
            when, packet = self._frames[self._next]
            if (when - self._frames[0][0]) / self._speed > now - self._started:
                break
            self._server.send_packet(packet)
            self._next += 1

    def fileno(self) -> int:
        """Return what becomes readable when a client has said something."""
        return self._server.fileno()

    def close(self) -> None:
        """Close the server."""
        self._server.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _udp_packets(path: Path) -> list[tuple[float, bytes, bytes]]:
    """Return time [s], source address and payload of every UDP packet."""
    dpkt = import_extra("dpkt", "playback")
    packets = []
    try:
        with path.open("rb") as file:
            reader = dpkt.pcap.UniversalReader(file)
            if reader.datalink() != dpkt.pcap.DLT_EN10MB:
                raise NatNetError(f"{path} was not recorded on Ethernet; record on one network card, not on all")
            for when, frame in reader:
                internet = dpkt.ethernet.Ethernet(frame).data
                if not isinstance(internet, dpkt.ip.IP):
                    continue
                if internet.mf or internet.offset:
                    raise NatNetError(f"{path} holds packets in several pieces, which are not put together")
                if isinstance(internet.data, dpkt.udp.UDP):
                    packets.append((float(when), bytes(internet.src), bytes(internet.data.data)))
    except OSError as error:
        raise NatNetError(f"cannot read {path}: {error.strerror}") from None
    except (dpkt.Error, ValueError) as error:
        raise NatNetError(f"{path} is not a pcap or pcapng capture: {error}") from None
    return packets


def _play(
    capture: Annotated[Path, typer.Argument(help="pcap or pcapng file that holds handshake and frames")],
    address: Annotated[str, typer.Option(help="of our network card")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="for commands")] = 1510,
    group: Annotated[str, typer.Option(help="multicast group, such as 239.255.42.99; unicast without")] = "",
    speed: Annotated[float, typer.Option(min=0.001, help="times the recorded pace")] = 1.0,
) -> None:
    """Answer NatNet clients, and play them the frames of a capture once one is ready."""
    try:
        config = NatNetServerConfig(
            address=ip_address(address), command_port=port, multicast_group=ip_address(group) if group else None
        )
        playback = Playback(Recording.read(capture), config, speed)
    except (ImoloError, ValueError) as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(1) from None
    with playback:
        while not playback.over:
            select.select([playback], [], [], 0.001)
            playback.poll(time.monotonic())


if __name__ == "__main__":
    typer.run(_play)
