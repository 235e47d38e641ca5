"""Captures: what is read, how fast it is played, what is refused."""

import select
import socket
import time
from pathlib import Path

import pytest
from live.network import namespace
from natnet_capture import CAPTURE, FOLDER, VERSION, frames, recording
from natnet_pair import run_until

from imolo.errors import NatNetError
from imolo_drivers.natnet.client import NatNetClient
from imolo_drivers.natnet.config import NatNetConfig, NatNetServerConfig
from imolo_drivers.natnet.encoder import encode
from imolo_drivers.natnet.messages import Connect, Frame, ModelDefinitionsRequest
from imolo_drivers.natnet.playback import Playback, Recording


def test_played_by_multicast_the_client_gets_the_same_frames() -> None:
    with namespace():
        config = NatNetServerConfig(command_port=0, multicast_group="239.255.42.99")
        with Playback(recording(), config, speed=float("inf")) as playback:
            received: list[Frame] = []
            with NatNetClient(NatNetConfig(command_port=playback.port)) as client:
                run_until(playback, client, received, lambda: len(received) >= len(frames()))
            assert tuple(received) == frames()


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_frames_come_at_the_recorded_pace(speed: float) -> None:
    sent: list[bytes] = []
    with (
        Playback(recording(), NatNetServerConfig(command_port=0), speed) as playback,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
    ):
        client.settimeout(10.0)
        for question in (Connect(), ModelDefinitionsRequest()):
            client.sendto(encode(question, VERSION), ("127.0.0.1", playback.port))
            select.select([playback], [], [], 10.0)
            playback.poll(100.0)
            client.recv(1000)
        playback.poll(100.0 + 0.0999 / speed)
        while select.select([client], [], [], 0.05)[0]:
            sent.append(client.recv(1000))
    times = [when - recording().frames[0][0] for when, _ in recording().frames]
    assert len(sent) == sum(when <= 0.0999 for when in times) == 13


def test_exposures_are_told_in_the_time_of_the_playback() -> None:
    with (
        Playback(recording(), NatNetServerConfig(command_port=0)) as playback,
        NatNetClient(NatNetConfig(command_port=playback.port, echo_interval=0.001)) as client,
    ):
        received: list[Frame] = []
        run_until(playback, client, received, lambda: len(received) >= 30)
        first, last = (client.exposure_time(received[place]) for place in (0, 29))
        assert first is not None
        assert last is not None
        assert last[0] - first[0] == pytest.approx(29 / 120, abs=1e-3)
        # Played and exposed is as far apart as transmitted and exposed was, but for what either machine was late.
        assert last[0] - last[1] < time.monotonic()
        assert client.silence(last[0] - last[1]) < 0.0


def test_a_file_that_is_no_capture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NatNetError, match="is not a pcap or pcapng capture"):
        Recording.read(FOLDER / "README.md")
    with pytest.raises(NatNetError, match="cannot read"):
        Recording.read(tmp_path / "none.pcapng")
    cut = tmp_path / "cut.pcapng"
    cut.write_bytes(CAPTURE.read_bytes()[:1000])
    with pytest.raises(NatNetError, match=r"is not a pcap or pcapng capture|holds no answer"):
        Recording.read(cut)
