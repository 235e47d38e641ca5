"""Client and server over UDP: handshake, frames, loss, clocks, restarts."""

import itertools
import select
import socket
import time
from types import SimpleNamespace

import pytest
from live.network import namespace
from natnet_pair import DEADLINE, Pair, pair, run_until
from pydantic import ValidationError

from imolo.errors import NatNetError, NatNetVersionError
from imolo_drivers.natnet import server as natnet_server
from imolo_drivers.natnet.client import LATE_FRAMES, LATE_IN_ORDER, NatNetClient
from imolo_drivers.natnet.config import NatNetConfig, NatNetServerConfig
from imolo_drivers.natnet.encoder import encode
from imolo_drivers.natnet.messages import Frame, LabelledMarker, ModelDefinitions, RigidBodyDefinition, ServerInfo
from imolo_drivers.natnet.server import NatNetServer
from imolo_drivers.natnet.wire import HEADER, SUPPORTED, MessageId, Version

DEFINITIONS = ModelDefinitions((RigidBodyDefinition("liberobot", 3),))


def frame(number: int, **fields: int) -> Frame:
    return Frame(number, number / 128, markers=(LabelledMarker(3, 1, (0.5, 1.0, 0.25)),), **fields)


def send_and_receive(link: Pair, *numbers: int) -> list[Frame]:
    for number in numbers:
        link.server.send(frame(number))
    link.run_until(lambda: bool(link.frames) and link.frames[-1].number == numbers[-1])
    return link.frames


@pytest.mark.parametrize("version", SUPPORTED)
def test_a_unicast_client_gets_server_models_and_frames(version: Version) -> None:
    with pair(version, definitions=DEFINITIONS) as link:
        link.connect()
        assert link.client.server is not None
        assert link.client.server.natnet_version == version
        assert link.client.definitions == DEFINITIONS
        assert send_and_receive(link, 1, 2, 3) == [frame(1), frame(2), frame(3)]


@pytest.mark.parametrize("version", SUPPORTED)
def test_a_multicast_client_joins_the_group_that_the_server_names(version: Version) -> None:
    with namespace(), pair(version, multicast_group="239.255.42.99", definitions=DEFINITIONS) as link:
        link.connect()
        assert link.client.server is not None
        assert link.client.server.multicast_group == "239.255.42.99"
        assert send_and_receive(link, 1, 2, 3) == [frame(1), frame(2), frame(3)]


def test_two_clients_of_one_machine_share_a_group() -> None:
    with namespace(), pair((4, 1), multicast_group="239.255.42.99", definitions=DEFINITIONS) as link:
        link.connect()
        with NatNetClient(NatNetConfig(command_port=link.server.port, retry_interval=0.05)) as other:
            others: list[Frame] = []
            run_until(link.server, other, others, lambda: other.definitions is not None)
            assert send_and_receive(link, 1) == [frame(1)]
            run_until(link.server, other, others, lambda: others == [frame(1)])


@pytest.mark.parametrize("port", [0, -1, 65536])
def test_a_port_that_is_none_is_refused(port: int) -> None:
    assert NatNetConfig(command_port=1).command_port == 1
    with pytest.raises(ValidationError):
        NatNetConfig(command_port=port)


def test_missing_numbers_are_lost_frames_and_old_ones_are_left_out() -> None:
    with pair((4, 1)) as link:
        link.connect()
        frames = send_and_receive(link, 10, 11, 14, 13, 14, 15)
        assert [frame.number for frame in frames] == [10, 11, 14, 15]
        assert link.client.lost == 2
        assert link.client.late == 2


@pytest.mark.parametrize("length", [3, 60, 100, 122])
def test_a_take_in_a_loop_goes_on_in_every_round(length: int) -> None:
    with pair((4, 1)) as link:
        link.connect()
        for played in (1, 2, 3):
            for number in range(500, 500 + length):
                link.server.send(frame(number))
            link.run_until(lambda played=played: len(link.frames) + link.client.late == played * length)
        numbers = [frame.number for frame in link.frames]
        round_again = numbers[length:]
        assert numbers[:length] == list(range(500, 500 + length))
        # What is left out of a round is what tells that it is one.
        late = 0 if length > LATE_FRAMES + 1 else LATE_IN_ORDER - 1
        assert round_again == 2 * list(range(500 + late, 500 + length))
        assert (link.client.late, link.client.lost) == (2 * late, 0)


def test_late_frames_between_others_are_no_restart() -> None:
    with pair((4, 1)) as link:
        link.connect()
        frames = send_and_receive(link, 10, 20, 11, 12, 21, 13, 14, 22, 15, 15, 16, 16, 9, 23)
        assert [frame.number for frame in frames] == [10, 20, 21, 22, 23]


def test_a_number_that_stands_still_is_no_restart() -> None:
    with pair((4, 1)) as link:
        link.connect()
        for _ in range(10):
            link.server.send(frame(77))
        link.run_until(lambda: link.client.late == 9)
        assert [frame.number for frame in link.frames] == [77]
        assert "do not count upwards, the last one is 77; is its take paused" in link.client.missing(5.0)


def test_a_silent_stream_is_lost_after_the_limit_and_found_again_with_the_next_frame() -> None:
    with pair((4, 1)) as link:
        link.connect()
        send_and_receive(link, 1)
        last = time.monotonic()
        silence = link.client.silence(last)
        assert link.client.lost_at == last - silence + NatNetConfig().silence_limit
        assert not link.client.is_lost(link.client.lost_at - 1e-6)
        assert link.client.is_lost(link.client.lost_at)
        send_and_receive(link, 2)
        assert link.client.silence(time.monotonic()) < silence + time.monotonic() - last


def test_a_client_without_server_counts_its_silence_from_the_first_poll() -> None:
    with NatNetClient(NatNetConfig(command_port=free_port()), lambda: 100.0) as client:
        assert client.is_lost(0.0)
        assert client.poll() == []
        assert client.silence(100.04) == pytest.approx(0.04)
        assert client.lost_at == 100.0 + NatNetConfig().silence_limit


@pytest.mark.parametrize(("exposed", "number"), [(12.5, 1), (1e6 + 1 / 3, 2)])
def test_the_exposure_is_told_in_our_time_with_an_error_that_holds(exposed: float, number: int) -> None:
    # The server's clock began long before ours, so that only echoes can tell what it shows.
    with pair((3, 1), clock_start=-3600.0, echo_interval=0.001) as link:
        link.connect()
        link.run_until(lambda: link.client.exposure_time(frame(1, mid_exposure=1)) is not None)
        found = link.client.exposure_time(frame(number, mid_exposure=link.server.ticks(exposed)))
        assert found is not None
        assert abs(found[0] - exposed) <= found[1] + 1e-7
        # A second's distance may add what the clocks drift apart.
        later = link.client.exposure_time(frame(number, mid_exposure=link.server.ticks(exposed + 1.0)))
        assert later is not None
        assert later[0] - found[0] == pytest.approx(1.0, abs=1e-6)
        assert abs(later[1] - found[1]) == pytest.approx(1e-4, abs=1e-9)


def test_the_error_of_the_exposure_holds_however_slow_the_machines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look at a clock is a second after the one before, and what is waited for comes right after a look."""
    looks = itertools.count(1001.0)

    def look() -> float:
        now = next(looks)
        server.poll(1000.0)  # when it looked last, before it was asked
        return now

    monkeypatch.setattr(natnet_server, "time", SimpleNamespace(monotonic=lambda: next(looks)))
    with (
        NatNetServer(NatNetServerConfig(command_port=0), (4, 1)) as server,
        NatNetClient(NatNetConfig(command_port=server.port), look) as client,
    ):
        while (found := client.exposure_time(frame(1, mid_exposure=server.ticks(1010.0)))) is None:
            client.poll()
            assert next(looks) < 2000.0, "nothing came"
    assert abs(found[0] - 1010.0) <= found[1] + 1e-7


def test_cameras_that_do_not_tell_the_exposure_have_none() -> None:
    with pair((4, 1)) as link:
        link.connect()
        assert link.client.exposure_time(frame(1, mid_exposure=0)) is None


def test_frames_go_on_when_the_server_was_started_again() -> None:
    with pair((3, 0), definitions=DEFINITIONS) as link:
        link.connect()
        send_and_receive(link, 5000)
        port = link.server.port
        link.server.close()
        while not link.client.is_lost(time.monotonic()):
            link.frames += link.client.poll()
        changed = ModelDefinitions((RigidBodyDefinition("liberobot", 4),))
        with NatNetServer(NatNetServerConfig(command_port=port), (4, 1), definitions=changed) as again:
            run_until(again, link.client, link.frames, lambda: link.client.definitions == changed)
            again.send(frame(1))
            run_until(again, link.client, link.frames, lambda: link.frames[-1] == frame(1))
        assert link.client.lost == 0


def test_changed_models_are_asked_for_again() -> None:
    with pair((4, 0), definitions=DEFINITIONS) as link:
        link.connect()
        link.server.definitions = ModelDefinitions()
        link.server.send(frame(1, flags=2))
        link.run_until(lambda: link.client.definitions == ModelDefinitions())


def test_models_that_are_said_to_change_in_every_frame_are_known_all_the_same() -> None:
    with pair((4, 0), definitions=DEFINITIONS) as link:
        link.connect()
        for number in range(1, 20):
            link.server.send(frame(number, flags=2))
            link.run_until(lambda number=number: len(link.frames) == number)
            assert link.client.definitions == DEFINITIONS


def test_a_unicast_client_that_falls_silent_is_dropped_and_one_that_says_goodbye_at_once() -> None:
    with pair((4, 1)) as link:
        link.connect()
        now = time.monotonic()
        assert len(link.server.clients) == 1
        link.server.poll(now + 9.0)
        assert len(link.server.clients) == 1
        link.server.poll(now + 30.0)
        assert link.server.clients == ()
    with pair((4, 1)) as link:
        link.connect()
        link.client.close()
        while link.server.clients:
            link.server.poll(time.monotonic())


def test_damaged_packets_are_counted_and_the_stream_goes_on() -> None:
    with pair((4, 1)) as link:
        link.connect()
        link.server.send_packet(encode(frame(1), (4, 1))[:-9])
        link.server.send_packet(b"\x07")
        assert send_and_receive(link, 2) == [frame(2)]
        assert link.client.unreadable == 2
        assert "truncated packet" in link.client.last_problem


def test_packets_of_strangers_are_ignored() -> None:
    with pair((4, 1)) as link:
        link.connect()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind(("127.0.0.2", 0))
            stranger.sendto(encode(frame(99), (4, 1)), link.server.clients[0])
        assert send_and_receive(link, 1) == [frame(1)]


def test_what_came_in_the_place_of_frames_is_told() -> None:
    with pair((4, 1)) as link:
        link.run_until(lambda: link.client.server is not None)
        assert "imolo answers but sends no" in link.client.missing(5.0)
        link.server.send_packet(b"\x07")
        link.run_until(lambda: link.client.unreadable == 1)
        assert "1 packets from there cannot be read, the last one: truncated packet" in link.client.missing(5.0)
    with NatNetClient(NatNetConfig(command_port=free_port())) as client:
        assert "within 5 s: nothing came; is it streaming" in client.missing(5.0)


def test_a_server_that_tells_too_little_is_told_though_its_frames_come() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        with NatNetClient(NatNetConfig(command_port=server.getsockname()[1])) as client:
            client.poll()
            _, address = server.recvfrom(1000)
            short = HEADER.pack(MessageId.SERVER_INFO, 264) + bytes(260) + bytes((3, 1, 0, 0))
            for packet in (encode(frame(1), (3, 1)), short, encode(frame(2), (3, 1))):
                server.sendto(packet, address)
                select.select([client], [], [], DEADLINE)
                client.poll()
            assert "3 packets from there cannot be read, the last one: the answer of server ''" in client.missing(5.0)


def test_an_answer_from_another_address_is_told() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as answering,
    ):
        asked.bind(("127.0.0.1", 0))
        answering.bind(("127.0.0.2", 0))
        with NatNetClient(NatNetConfig(command_port=asked.getsockname()[1])) as client:
            client.poll()
            _, address = asked.recvfrom(1000)
            answering.sendto(encode(ServerInfo("Motive", (3, 1, 0, 0), (4, 1), 1000, 1511, None), (4, 1)), address)
            select.select([client], [], [], DEADLINE)
            client.poll()
            assert client.server is None
            assert "127.0.0.2 answers in its place; is that to be cameras.server_address?" in client.missing(5.0)


def test_a_server_of_an_unknown_version_is_refused() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        with NatNetClient(NatNetConfig(command_port=server.getsockname()[1])) as client:
            client.poll()
            _, address = server.recvfrom(1000)
            server.sendto(encode(ServerInfo("Motive", (1, 10, 0, 0), (2, 10), 1000, 1511, None), (3, 0)), address)
            with pytest.raises(NatNetVersionError, match=r"NatNet 2\.10 is not supported, only 3\.0, 3\.1, 4\.0, 4\.1"):
                poll_for_long(client)


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(NatNetError, match=r"local_address 192\.0\.2\.1"):
        NatNetClient(NatNetConfig(local_address="192.0.2.1"))
    with pytest.raises(NatNetError, match=r"192\.0\.2\.1:1510"):
        NatNetServer(NatNetServerConfig(address="192.0.2.1"))


def poll_for_long(client: NatNetClient) -> None:
    end = time.monotonic() + DEADLINE
    while time.monotonic() < end:
        client.poll()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])
