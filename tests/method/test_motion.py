"""Claims about theta, U and the message that carries U."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from imolo.errors import ConfigError, MessageError
from imolo.method.commands import Commands
from imolo.method.motion import MotionTemplate, Theta
from imolo_msgs import actuator_command_t

TEMPLATE = MotionTemplate()
ONSET = 5_000_000

thetas = st.builds(Theta, k=st.floats(-1.0, 1.0), t_w=st.floats(0.1001, 1.1999))


@st.composite
def all_commands(draw: st.DrawFn) -> Commands:
    onset = draw(st.integers(-(2**40), 2**40))
    lengths = draw(st.lists(st.integers(1, 2_000_000), min_size=1, max_size=6))
    pressure = st.lists(st.floats(0.0, SUPPLY_PRESSURE), min_size=NUM_VALVES, max_size=NUM_VALVES)
    rows = draw(st.lists(pressure, min_size=len(lengths), max_size=len(lengths)))
    return Commands(onset, tuple(onset + int(end) for end in np.cumsum(lengths)), np.array(rows))


def test_phases_of_table_two_end_at_their_times() -> None:
    commands = TEMPLATE.commands(Theta(k=0.5, t_w=0.3), ONSET)
    u_1 = np.array(TEMPLATE.u_m) + 0.5 * np.array(TEMPLATE.u_k)  # Eq. 1
    u_2, u_3 = TEMPLATE.fixed_target
    for first, last, expected in (
        (0, 99_999, u_1),
        (100_000, 299_999, u_2),
        (300_000, 1_199_999, u_3),
        (1_200_000, 10**9, np.zeros(8)),
    ):
        np.testing.assert_array_equal(commands.target(ONSET + first), expected)
        np.testing.assert_array_equal(commands.target(ONSET + last), expected)
    assert commands.target(ONSET - 1) is None
    assert commands.end_utime == ONSET + 1_200_000


def test_k_raises_the_right_knee_and_lowers_the_left_by_150_kilopascals() -> None:
    high, low = (TEMPLATE.commands(Theta(k, 0.3), ONSET).target_pressure[0] for k in (1.0, 0.0))
    np.testing.assert_allclose(high - low, [0.0, 150e3, 0.0, 0.0, -150e3, 0.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("theta", TRAINING_MOTIONS)
def test_motions_of_table_three_are_allowed(theta: Theta) -> None:
    assert len(TEMPLATE.commands(theta, 0).switch_utime) == 3


def test_table_three_has_fifteen_motions() -> None:
    assert len(set(TRAINING_MOTIONS)) == 15


@pytest.mark.parametrize(
    ("theta", "named"),
    [
        (Theta(1.001, 0.3), "k is 1.001"),
        (Theta(float("nan"), 0.3), "k is nan"),
        (Theta(0.0, 0.1), "t_w is 0.1 s"),
        (Theta(0.0, 0.1000001), "t_w is 0.1 s"),
        (Theta(0.0, 1.2), "t_w is 1.2 s"),
        (Theta(0.0, float("inf")), "t_w is inf"),
    ],
)
def test_theta_out_of_range_is_named(theta: Theta, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        TEMPLATE.commands(theta, 0)


@pytest.mark.parametrize(
    "change",
    [
        {"k_range": (-2.0, 1.0)},  # the right knee would need -50 kPa
        {"k_range": (1.0, -1.0)},
        {"fixed_switch_time": (1.2, 0.1)},
        {"fixed_switch_time": (0.1,)},
        {"switch_phase": 3},
        {"changed_phase": 4},
        {"u_m": (0.0,) * 7},
        {"unknown": 1},
    ],
)
def test_template_that_cannot_be_executed_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        MotionTemplate.model_validate(change)


def test_the_changed_phase_starts_where_its_predecessor_ends() -> None:
    starts = [MotionTemplate(changed_phase=c).changed_phase_start(0.3) for c in (1, 2, 3)]
    assert starts == [0.0, 0.1, 0.3]


@given(commands=all_commands(), utime=st.integers(0, 2**62), sequence=st.integers(0, 2**31 - 1))
def test_commands_survive_the_bus(commands: Commands, utime: int, sequence: int) -> None:
    message = actuator_command_t.decode(commands.to_message(utime, sequence).encode())
    assert Commands.from_message(message) == commands
    assert (message.utime, message.command_sequence) == (utime, sequence)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0, SUPPLY_PRESSURE + 1.0])
def test_message_with_an_impossible_pressure_is_refused(value: float) -> None:
    message = TEMPLATE.commands(Theta(0.0, 0.3), ONSET).to_message(0, 0)
    message.target_pressure[1][4] = value
    with pytest.raises(MessageError, match="valve 5 in phase 2"):
        Commands.from_message(message)


def test_highest_pressure_is_configurable() -> None:
    message = TEMPLATE.commands(Theta(0.0, 0.3), ONSET).to_message(0, 0)
    with pytest.raises(MessageError, match="give 0 to 500000 Pa"):
        Commands.from_message(message, max_pressure=5e5)


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("switch_utime", [ONSET, ONSET + 1, ONSET + 2], "switch_utime 5000000 does not come after 5000000"),
        ("switch_utime", [ONSET + 2, ONSET + 1, ONSET + 3], "switch_utime 5000001"),
        ("switch_utime", [ONSET + 1, ONSET + 2], "switch_utime has 2 entries"),
        ("target_pressure", [[0.0] * 8, [0.0] * 7, [0.0] * 8], "phase 2 has 7 values"),
        ("num_phases", 2, "num_phases promises 2"),
    ],
)
def test_malformed_message_is_refused(field: str, value: object, named: str) -> None:
    message = TEMPLATE.commands(Theta(0.0, 0.3), ONSET).to_message(0, 0)
    setattr(message, field, value)
    with pytest.raises(MessageError, match=named):
        Commands.from_message(message)


def test_empty_message_is_refused() -> None:
    with pytest.raises(MessageError, match="no phases"):
        Commands.from_message(actuator_command_t())


def test_commands_cannot_be_changed_from_outside() -> None:
    pressure = np.zeros((1, NUM_VALVES))
    commands = Commands(0, (1,), pressure)
    pressure[0, 0] = 1.0
    assert commands.target_pressure[0, 0] == 0.0
    for held in (commands.target(0), commands.target(1)):
        assert held is not None
        with pytest.raises(ValueError, match="read-only"):
            held[0] = 1.0


@given(a=all_commands(), b=all_commands(), later=st.integers(-10, 10**7))
def test_matching_is_equality_of_every_target_before(a: Commands, b: Commands, later: int) -> None:
    utime = min(a.onset_utime, b.onset_utime) + later
    assert a.matches_until(a, utime)
    assert a.matches_until(b, utime) == b.matches_until(a, utime)
    if a.onset_utime != b.onset_utime:
        assert a.matches_until(b, utime) == (later <= 0)


@given(theta=thetas, other=thetas, elapsed=st.integers(1, 1_300_000))
def test_matching_motions_agree_at_every_sampled_time_before(theta: Theta, other: Theta, elapsed: int) -> None:
    a, b = (TEMPLATE.commands(each, ONSET) for each in (theta, other))
    changes = [at for at in (*a.switch_utime, *b.switch_utime) if at < ONSET + elapsed]
    sampled = [*range(ONSET, ONSET + elapsed, 5_000), *changes, ONSET + elapsed - 1]
    agree = all(np.array_equal(np.array(a.target(at)), np.array(b.target(at))) for at in sampled)
    assert a.matches_until(b, ONSET + elapsed) == agree


def test_commands_change_as_in_figure_four_e() -> None:
    executed = TEMPLATE.commands(Theta(0.2, 0.30), ONSET)
    elapsed = ONSET + 250_000
    assert TEMPLATE.commands(Theta(0.2, 0.35), ONSET).matches_until(executed, elapsed)
    assert TEMPLATE.commands(Theta(0.2, 0.25), ONSET).matches_until(executed, elapsed)  # it switches now
    assert not TEMPLATE.commands(Theta(0.2, 0.24), ONSET).matches_until(executed, elapsed)
    assert not TEMPLATE.commands(Theta(0.3, 0.30), ONSET).matches_until(executed, elapsed)
    assert TEMPLATE.commands(Theta(0.3, 0.21), ONSET).matches_until(executed, ONSET)  # nothing is executed yet


def test_commands_that_differ_in_one_number_are_not_equal() -> None:
    commands = TEMPLATE.commands(Theta(0.2, 0.3), ONSET)
    assert commands == replace(commands)
    assert commands != replace(commands, onset_utime=ONSET - 1)
    assert commands != replace(commands, target_pressure=commands.target_pressure + 1.0)
