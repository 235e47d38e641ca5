"""The bus: strict order, isolation, and errors that say what to do."""

import gc
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imolo.errors import BusError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo_msgs import actuator_state_t, mocap_frame_t, plan_t


def sensed(utime: int) -> actuator_state_t:
    message = actuator_state_t()
    message.utime = utime
    return message


def frame(utime: int) -> mocap_frame_t:
    message = mocap_frame_t()
    message.utime = utime
    return message


def test_unknown_channel_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(BusError, match=r"unknown channel 'ACTUATOR_STAT'; did you mean 'ACTUATOR_STATE'\?"):
        Bus().publish("ACTUATOR_STAT", sensed(0))


def test_message_of_another_type_is_refused() -> None:
    with pytest.raises(BusError, match="MOCAP carries mocap_frame_t, not actuator_state_t"):
        Bus().publish(channels.MOCAP, sensed(0))


@pytest.mark.parametrize("url", ["nonsense://", "memq", "file:///no/such/folder/log?mode=r", "memq\udce4"])
def test_url_that_lcm_cannot_open_is_a_bus_error_with_the_recipe(url: str) -> None:
    with pytest.raises(BusError, match=r"ip route add 224\.0\.0\.0/4 dev lo") as caught:
        Bus(url)
    assert repr(url) in str(caught.value)


@given(st.lists(st.integers(0, 2**62), max_size=50))
def test_messages_arrive_in_the_order_they_were_sent(utimes: list[int]) -> None:
    bus, seen = Bus(), []
    bus.subscribe(channels.MOCAP, lambda message: seen.append(message.utime))
    bus.subscribe(channels.ACTUATOR_STATE, lambda message: seen.append(message.utime))
    for number, utime in enumerate(utimes):
        if number % 2:
            bus.publish(channels.MOCAP, frame(utime))
        else:
            bus.publish(channels.ACTUATOR_STATE, sensed(utime))
    bus.drain()
    assert seen == utimes


def test_what_a_handler_publishes_comes_after_what_was_waiting() -> None:
    bus, seen = Bus(), []

    def answer(message: mocap_frame_t) -> None:
        seen.append(("frame", message.utime))
        plan = plan_t()
        plan.utime = message.utime
        bus.publish(channels.PLAN, plan)

    bus.subscribe(channels.MOCAP, answer)
    bus.subscribe(channels.PLAN, lambda plan: seen.append(("plan", plan.utime)))
    for utime in (1, 2):
        bus.publish(channels.MOCAP, frame(utime))
    bus.drain()
    assert seen == [("frame", 1), ("frame", 2), ("plan", 1), ("plan", 2)]


def test_two_buses_do_not_hear_each_other() -> None:
    talking, listening = Bus(), Bus()
    seen: list[int] = []
    listening.subscribe(channels.MOCAP, lambda message: seen.append(message.utime))
    talking.publish(channels.MOCAP, frame(1))
    talking.drain()
    listening.drain()
    assert seen == []


def test_error_of_a_handler_reaches_the_one_who_drains() -> None:
    bus = Bus()

    def refuse(_: mocap_frame_t) -> None:
        raise BusError("refused")

    bus.subscribe(channels.MOCAP, refuse)
    bus.publish(channels.MOCAP, frame(1))
    with pytest.raises(BusError, match="refused"):
        bus.drain()


def test_message_of_another_type_is_passed_over_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    bus, heard = Bus(), []
    bus.subscribe(channels.MOCAP, lambda message: heard.append(message.utime))
    for data in (b"", b"noise", plan_t().encode(), frame(1).encode()[:-1], frame(7).encode(), b"noise"):
        bus.publish_raw(channels.MOCAP, data)
    bus.drain()
    assert heard == [7]
    assert caplog.messages == [
        "MOCAP carries what is no mocap_frame_t, from another program or another version of imolo; it is passed over"
    ]


def test_drain_of_a_silent_bus_returns() -> None:
    bus, seen = Bus(), []
    bus.subscribe_raw(lambda channel, data: seen.append(channel))
    bus.drain()
    assert seen == []


def test_bus_in_memory_waits_only_where_nothing_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr("imolo.messaging.transport.time.sleep", slept.append)
    bus, seen = Bus(), []
    bus.subscribe(channels.MOCAP, lambda message: seen.append(message.utime))
    bus.publish(channels.MOCAP, frame(7))
    bus.wait(5.0)
    assert (seen, slept) == ([7], [])
    bus.wait(5.0)
    assert (seen, slept) == ([7], [5.0])


def test_subscription_to_an_unknown_channel_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(BusError, match="did you mean 'MOCAP'"):
        Bus().subscribe("MOCPA", lambda _: None)


def test_closed_bus_gives_back_its_file_descriptors() -> None:
    def used_up() -> int:
        bus = Bus()
        bus.subscribe(channels.MOCAP, partial(bus.publish, channels.PLAN))  # refers to the bus, as handlers do
        bus.close()
        del bus
        gc.collect()
        return len(list(Path("/proc/self/fd").iterdir()))

    first = used_up()
    assert [used_up() for _ in range(5)] == [first] * 5


def test_bus_in_memory_opens_no_file() -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    buses = [Bus() for _ in range(20)]
    assert len(list(Path("/proc/self/fd").iterdir())) == before
    del buses
