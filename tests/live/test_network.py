"""UDP multicast: what is wrong is said with its remedy, and a burst arrives whole."""

import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from network import URL, namespace

from imolo.errors import BusError
from imolo.messaging import channels, udpm
from imolo.messaging.bus import Bus
from imolo_msgs import actuator_state_t

BURST = 20_000
# The system grants 8 MB, half of the burst: on a busy machine the sender must not run while the receiver may not.
SENDER = f"""
import os
os.nice(19)
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo_msgs import actuator_state_t
bus, message = Bus({URL!r}), actuator_state_t()
for number in range(1, {BURST} + 1):
    message.state_sequence = number
    bus.publish(channels.ACTUATOR_STATE, message)
"""


@pytest.mark.parametrize(
    ("url", "parts"),
    [
        ("udpm://nowhere:7667?ttl=0", ("'nowhere'", "multicast address")),
        ("udpm://10.0.0.1:7667?ttl=0", ("'10.0.0.1'", "224.0.0.0 to 239.255.255.255")),
        ("udpm://239.255.76.67:99999?ttl=0", ("port '99999'", "1 to 65535")),
        ("udpm://239.255.76.67:port", ("port 'port'",)),
        ("udpm://239.255.76.67:7667?tll=0", ("unknown setting 'tll'", "did you mean 'ttl'?")),
        ("udpm://239.255.76.67:7667?ttl=300", ("ttl '300'", "0 to 255")),
        ("udpm://239.255.76.67:7667?ttl=0&recv_buf_size=big", ("recv_buf_size 'big'",)),
    ],
)
def test_wrong_url_names_the_value_and_what_is_right(url: str, parts: tuple[str, ...]) -> None:
    with pytest.raises(BusError) as caught:
        Bus(url)
    assert all(part in str(caught.value) for part in (repr(url), *parts))


@pytest.mark.usefixtures("network")
@pytest.mark.parametrize(
    ("name", "lowest", "highest"),
    [("port", 1, 65535), ("ttl", 0, 255), ("recv_buf_size", 1, 2**31 - 1), ("transmit_only", 0, 1)],
)
def test_numbers_of_a_url_have_the_bounds_that_are_told(name: str, lowest: int, highest: int) -> None:
    group, between = ("udpm://239.255.76.67", ":") if name == "port" else (URL, f"&{name}=")
    for fitting in (lowest, highest):
        assert f"{between}{fitting}" in udpm.check_url(f"{group}{between}{fitting}")
    for outside in (lowest - 1, highest + 1):
        with pytest.raises(BusError, match=f"{name} '{outside}'; give {lowest} to {highest}$"):
            udpm.check_url(f"{group}{between}{outside}")


def test_missing_route_is_told_with_the_recipe() -> None:
    with (
        namespace(route=False),
        pytest.raises(BusError, match=r"no multicast route .*unreachable.*ip route add 224\.0\.0\.0/4 dev lo"),
    ):
        Bus(URL)


@pytest.mark.usefixtures("network")
def test_occupied_port_is_told_with_the_way_to_find_who_has_it() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as selfish:
        selfish.bind(("", 7667))
        with pytest.raises(BusError, match=r"UDP port 7667 .* is occupied .*ss -lunp sport = :7667"):
            Bus(URL)
    Bus(URL)


@pytest.mark.usefixtures("network")
def test_programs_of_ours_share_the_port() -> None:
    buses = [Bus(URL) for _ in range(3)]
    heard: list[int] = []
    for bus in buses:
        bus.subscribe(channels.ACTUATOR_STATE, lambda message: heard.append(message.state_sequence))
    message = actuator_state_t()
    message.state_sequence = 9
    buses[0].publish(channels.ACTUATOR_STATE, message)
    for bus in buses:
        bus.wait(10.0)
    assert heard == [9, 9, 9]


@pytest.mark.usefixtures("network")
def test_receive_buffer_is_asked_for_unless_it_was_chosen() -> None:
    assert udpm.check_url(URL) == f"{URL}&recv_buf_size={udpm.RECEIVE_BUFFER}"
    assert udpm.check_url("udpm://") == f"udpm://{udpm.DEFAULT}?recv_buf_size={udpm.RECEIVE_BUFFER}"
    assert udpm.check_url(URL + "&recv_buf_size=1000").endswith("?ttl=0&recv_buf_size=1000")


@pytest.mark.usefixtures("network")
def test_burst_of_another_process_arrives_whole_and_in_order() -> None:
    bus, heard = Bus(URL), []
    bus.subscribe(channels.ACTUATOR_STATE, lambda message: heard.append(message.state_sequence))
    # Nothing is handled before all is sent: the queue must hold it.
    subprocess.run([sys.executable, "-c", SENDER], check=True, timeout=120)
    deadline = time.monotonic() + 30.0
    while len(heard) < BURST and time.monotonic() < deadline:
        bus.wait(0.5)
    assert heard == list(range(1, BURST + 1))


@pytest.mark.usefixtures("network")
def test_newest_of_a_burst_is_handed_over_and_the_others_counted() -> None:
    bus, newest, skipped = Bus(URL), [], []
    bus.subscribe_newest(channels.ACTUATOR_STATE, lambda _, data: newest.append(data), skipped.append)
    subprocess.run([sys.executable, "-c", SENDER], check=True, timeout=120)
    deadline = time.monotonic() + 30.0
    while len(newest) + len(skipped) < BURST and time.monotonic() < deadline:
        bus.wait(0.5)
    assert actuator_state_t.decode(newest[-1]).state_sequence == BURST
    # LCM hands its queue over as it reads the socket, perhaps in a few parts.
    assert len(newest) < BURST / 100


def test_newest_wins_on_every_bus() -> None:
    bus, newest, skipped = Bus(), [], []
    bus.subscribe_newest("CONTROL", lambda _, data: newest.append(data), skipped.append)
    for round_ in range(2):
        for number in range(3):
            bus.publish_raw("CONTROL", bytes([round_, number]))
        bus.drain()
    assert newest == [b"\x00\x02", b"\x01\x02"]
    assert skipped == [b"\x00\x00", b"\x00\x01", b"\x01\x00", b"\x01\x01"]


@pytest.mark.parametrize(
    "arguments",
    [("record",), ("backend", "config.yaml")],
)
def test_bus_that_cannot_be_opened_ends_a_program_in_one_line(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    (tmp_path / "config.yaml").write_text("backend: {name: mujoco}\n", encoding="utf-8")
    with namespace(route=False):
        ended = subprocess.run(
            [sys.executable, "-m", "imolo.command_line.main", *arguments],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith("imolo: no multicast route")
    assert ended.stderr.count("\n") == 1


def test_strangers_on_a_network_are_told_once_over_many_trials(caplog: pytest.LogCaptureFixture) -> None:
    url = URL.replace("7667", "7668")
    with namespace():
        for channel in (channels.MOCAP, channels.PLAN, channels.MOCAP):
            Bus(url).pass_over(channel)
    assert [message.split()[0] for message in caplog.messages] == [channels.MOCAP, channels.PLAN]
