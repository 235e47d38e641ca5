"""Pacing and counting, on a clock of the test's own."""

import pytest

from imolo.contracts.trial import EventName
from imolo.live.clock import GIVE_UP, Pace
from imolo.live.streams import Latency, Streams
from imolo.messaging import channels
from imolo_msgs import actuator_command_t, mocap_frame_t, trial_event_t

SLICE = 1000  # [µs]


class Clock:
    def __init__(self) -> None:
        self.time = 100.0
        self.waits: list[float] = []

    def __call__(self) -> float:
        return self.time

    def wait(self, duration: float) -> None:
        self.waits.append(duration)
        self.time += duration


def play(clock: Clock, pace: Pace, works: list[float]) -> None:
    for number, work in enumerate(works, start=1):
        clock.time += work
        pace.hold(number * SLICE)


def test_slices_end_on_the_clock() -> None:
    clock = Clock()
    pace = Pace(clock.wait, clock)
    play(clock, pace, [0.0] + [0.0004] * 99)
    assert clock.time == pytest.approx(100.0 + 99e-3, abs=1e-9)
    assert (pace.slices, pace.overruns, pace.lost) == (100, 0, 0.0)


def test_overrun_is_counted_and_made_up_for() -> None:
    clock = Clock()
    pace = Pace(clock.wait, clock)
    play(clock, pace, [0.0, 0.0045] + [0.0001] * 10)
    # Due after 1 ms and ready after 4.5 ms; the next three slices are due 2, 3 and 4 ms after the first.
    assert pace.overruns == 4
    assert pace.worst == pytest.approx(0.0035)
    assert clock.time == pytest.approx(100.0 + 11e-3, abs=1e-9)


def test_backend_that_is_behind_still_hears_the_network() -> None:
    clock = Clock()
    play(clock, Pace(clock.wait, clock), [0.002] * 50)
    assert len(clock.waits) == 50


def test_work_of_our_own_is_told_from_the_work_of_others() -> None:
    clock, computed = Clock(), 0.0
    pace = Pace(clock.wait, clock, lambda: computed)
    for number, (work, others) in enumerate([(0.0, 0.0), (0.0004, 0.003), (0.0015, 0.0), (0.0002, 0.0)], start=1):
        computed += work
        clock.time += work + others
        pace.hold(number * SLICE)
    assert pace.heavy == 1
    assert pace.computed == pytest.approx(0.0021)
    assert pace.played == pytest.approx(3e-3)
    assert pace.overruns == 3


def test_long_stall_is_told_and_not_made_up_for() -> None:
    clock = Clock()
    pace = Pace(clock.wait, clock)
    play(clock, pace, [0.0, GIVE_UP + 1.0, 0.0])
    assert pace.lost == pytest.approx(GIVE_UP + 1.0 - 1e-3)
    assert clock.time == pytest.approx(100.0 + GIVE_UP + 1.0 + 1e-3)


def test_time_begins_anew_with_every_trial() -> None:
    clock = Clock()
    pace = Pace(clock.wait, clock)
    for _ in range(2):
        pace.restart()
        clock.time += 10.0
        play(clock, pace, [0.0] * 5)
    assert pace.overruns == 0


def frame(number: int) -> bytes:
    message = mocap_frame_t()
    message.frame_number = number
    data: bytes = message.encode()
    return data


def start() -> bytes:
    message = trial_event_t()
    message.event = EventName.START.value
    data: bytes = message.encode()
    return data


@pytest.mark.parametrize(
    ("numbers", "missing", "disordered"),
    [
        ((1, 2, 3), 0, 0),
        ((1, 2, 5, 6), 2, 0),
        ((7, 8, 10), 1, 0),  # who joins later has missed nothing
        ((1, 2, 2, 3), 0, 1),
        ((1, 3, 2, 4), 1, 1),
        ((1, 2, 3, 1, 2, 3), 0, 0),  # the next trial
        ((1, 2, 3, "start", 3, 4), 2, 0),
        (("start", 1, 2), 0, 0),
        ((1, 2, 2**30, -5, 3, 5), 1, 0),  # a stranger's
        ((2**30, 7, 8), 0, 0),
        ((300, 200, 201), 199, 0),  # the next trial, whose start was lost
        ((300, 201, 301), 0, 1),
        ((1, 100_002, 100_003), 100_000, 0),
        ((1, 100_003, 2), 0, 0),
    ],
)
def test_gaps_in_the_numbers_are_counted(numbers: tuple[int | str, ...], missing: int, disordered: int) -> None:
    streams = Streams()
    for number in numbers:
        if isinstance(number, int):
            streams.count(channels.MOCAP, frame(number))
        else:
            streams.count(channels.TRIAL, start())
    mocap = streams.numbers[channels.MOCAP]
    assert (mocap.missing, mocap.disordered) == (missing, disordered)
    assert streams.total[channels.MOCAP] == sum(isinstance(number, int) for number in numbers)


def test_messages_of_another_type_leave_no_gap() -> None:
    streams = Streams()
    for data in (frame(1), b"another." + bytes(40), b"another." + frame(9)[8:], frame(2)):
        streams.count(channels.MOCAP, data)
    assert streams.describe_gaps() == "missing none"


def test_gap_is_told_by_channel() -> None:
    streams = Streams()
    for number in (1, 4):
        command = actuator_command_t()
        command.command_sequence = number
        streams.count(channels.ACTUATOR_COMMAND, command.encode())
    assert streams.describe_gaps() == "missing 2 ACTUATOR_COMMAND"


def test_rates_are_messages_per_second() -> None:
    clock = Clock()
    streams = Streams(clock)
    for number in range(1, 241):
        streams.count(channels.MOCAP, frame(number))
    clock.time += 2.0
    assert streams.describe(channels.MOCAP) == "MOCAP 120 Hz; missing none"


def test_latency_is_told_in_milliseconds() -> None:
    latency = Latency()
    assert str(latency) == "no answers yet"
    for number in range(1, 101):
        latency.add(1e-3 * number)
    assert str(latency) == "50.00 ms median, 99.00 ms p99"
