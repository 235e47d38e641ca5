"""The receiver's clock: rest before the onset, the phases, and released after the end."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from liberobot import CHANNELS, MOTION

from imolo.method.commands import Commands
from imolo_backends.simulation.command_schedule import CommandSchedule

REST = [channel.rest for channel in CHANNELS]
assert REST[7] > 0.0  # holds the crouch
ONSET = 20_000  # [µs]
THETA = (0.5, 0.3)
COMMANDS = MOTION.commands(THETA, ONSET)
LEAN = [0.5e5, 3.25e5, 0.2e5, 0.5e5, 1.75e5, 0.2e5, 0.0, 0.5e5]  # u_m + 0.5 u_k, Table II
JUMP = [6e5, 4e5, 1e5, 6e5, 4e5, 1e5, 0.0, 0.5e5]
SWING = [0.0] * 6 + [3e5, 0.0]
VENTED = [0.0] * 8


def schedule(*accepted: Commands) -> CommandSchedule:
    made = CommandSchedule(CHANNELS)
    for commands in accepted:
        made.accept(commands)
    return made


@pytest.mark.parametrize(
    ("utime", "target"),
    [
        (0, REST),
        (ONSET - 1, REST),
        (ONSET, LEAN),
        (ONSET + 99_999, LEAN),
        (ONSET + 100_000, JUMP),
        (ONSET + 299_999, JUMP),
        (ONSET + 300_000, SWING),
        (ONSET + 1_199_999, SWING),
        (ONSET + 1_200_000, VENTED),
        (2**62, VENTED),
    ],
)
def test_target_is_that_of_the_phase(utime: int, target: list[float]) -> None:
    assert schedule(COMMANDS).target(utime).tolist() == target


@given(st.integers(0, 2**62))
def test_channels_rest_until_they_are_told_something(utime: int) -> None:
    resting = schedule()
    assert resting.target(utime).tolist() == REST
    assert resting.time_since_onset(utime) is None
    assert resting.changes_after(utime) == []


@given(st.integers(0, ONSET + 2_000_000))
def test_target_changes_at_the_announced_times_alone(utime: int) -> None:
    running = schedule(COMMANDS)
    changes = running.changes_after(utime)
    assert changes == [time for time in (ONSET, *COMMANDS.switch_utime) if time > utime]
    until = min(changes, default=2**62)
    assert running.target(utime).tolist() == running.target(until - 1).tolist()


def test_same_commands_again_are_nothing_new() -> None:
    running = schedule(COMMANDS)
    assert not running.accept(MOTION.commands(THETA, ONSET))
    assert running.accept(MOTION.commands(THETA, ONSET + 1))


def test_newest_commands_are_in_force() -> None:
    later = MOTION.commands((0.5, 0.4), ONSET)
    running = schedule(COMMANDS, later)
    assert running.target(ONSET + 350_000).tolist() == JUMP
    assert schedule(later, COMMANDS).target(ONSET + 350_000).tolist() == SWING


@pytest.mark.parametrize(("utime", "since"), [(ONSET - 1, None), (ONSET, 0), (ONSET + 700, 700)])
def test_time_since_the_onset_is_counted_from_the_command(utime: int, since: int | None) -> None:
    assert schedule(COMMANDS).time_since_onset(utime) == since


@given(st.integers(ONSET + 1_200_000, 2**62))
def test_motors_are_released_to_where_their_channels_say(utime: int) -> None:
    made = CommandSchedule([replace(channel, released=0.3e5 + number) for number, channel in enumerate(CHANNELS)])
    made.accept(COMMANDS)
    assert made.target(utime).tolist() == [0.3e5 + number for number in range(8)]
