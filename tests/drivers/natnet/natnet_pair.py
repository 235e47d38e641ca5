"""A server and a client on loopback, run by hand until something is so."""

import select
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from imolo_drivers.natnet.client import NatNetClient
from imolo_drivers.natnet.config import NatNetConfig, NatNetServerConfig
from imolo_drivers.natnet.messages import Frame, ModelDefinitions
from imolo_drivers.natnet.playback import Playback
from imolo_drivers.natnet.server import NatNetServer
from imolo_drivers.natnet.wire import Version

DEADLINE = 20.0  # [s] for a busy machine; nothing takes that long


def run_until(
    server: NatNetServer | Playback, client: NatNetClient, frames: list[Frame], condition: Callable[[], bool]
) -> None:
    """Let both talk, collecting the frames, until it is so."""
    end = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < end, "nothing came"
        select.select([server, client], [], [], 0.01)
        server.poll(time.monotonic())
        frames += client.poll()


class Pair:
    def __init__(self, server: NatNetServer, client: NatNetClient) -> None:
        self.server = server
        self.client = client
        self.frames: list[Frame] = []

    def run_until(self, condition: Callable[[], bool]) -> None:
        run_until(self.server, self.client, self.frames, condition)

    def connect(self) -> None:
        self.run_until(lambda: self.client.definitions is not None)


@contextmanager
def pair(
    version: Version,
    *,
    multicast_group: str | None = None,
    definitions: ModelDefinitions | None = None,
    clock_start: float = 0.0,
    **settings: float,
) -> Iterator[Pair]:
    server_config = NatNetServerConfig(command_port=0, data_port=15111, multicast_group=multicast_group)
    with (
        NatNetServer(server_config, version, definitions=definitions, clock_start=clock_start) as server,
        NatNetClient(NatNetConfig(command_port=server.port, retry_interval=0.05, **settings)) as client,
    ):
        yield Pair(server, client)
