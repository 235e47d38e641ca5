"""Client and server over UDP: handshake, frames, loss, clocks, restarts."""

import pytest
from live.network import namespace
from natnet_pair import Pair, pair

from imolo_drivers.natnet.messages import Frame, LabelledMarker, ModelDefinitions, RigidBodyDefinition
from imolo_drivers.natnet.wire import SUPPORTED, Version

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


def test_missing_numbers_are_lost_frames_and_old_ones_are_left_out() -> None:
    with pair((4, 1)) as link:
        link.connect()
        frames = send_and_receive(link, 10, 11, 14, 13, 14, 15)
        assert [frame.number for frame in frames] == [10, 11, 14, 15]
        assert link.client.lost == 2
        assert link.client.late == 2
