"""Claims about theta, U and the message that carries U."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from liberobot import AIR, CHANNELS, MOTION, TRAINING_MOTIONS
from made_up_motions import MADE_UP, OF_THE_PAPER, thetas
from pydantic import ValidationError

from imolo.errors import ConfigError, MessageError
from imolo.method.commands import Commands
from imolo.method.motion import PhasedMotion, Theta
from imolo_msgs import actuator_command_t

ONSET = 5_000_000
VALVES = len(CHANNELS)
SUPPLY = AIR.supply_pressure


@st.composite
def all_commands(draw: st.DrawFn) -> Commands:
    onset = draw(st.integers(-(2**40), 2**40))
    lengths = draw(st.lists(st.integers(1, 2_000_000), min_size=1, max_size=6))
    pressure = st.lists(st.floats(0.0, SUPPLY), min_size=VALVES, max_size=VALVES)
    rows = draw(st.lists(pressure, min_size=len(lengths), max_size=len(lengths)))
    return Commands(onset, tuple(onset + int(end) for end in np.cumsum(lengths)), np.array(rows))


def test_phases_of_table_two_end_at_their_times() -> None:
    commands = MOTION.commands((0.5, 0.3), ONSET)
    u_m, u_2, u_3 = (np.array(phase.target) for phase in MOTION.phases)
    u_1 = u_m + 0.5 * np.array(MOTION.varied[0].direction)  # Eq. 1
    for first, last, expected in ((0, 99_999, u_1), (100_000, 299_999, u_2), (300_000, 1_199_999, u_3)):
        np.testing.assert_array_equal(commands.target(ONSET + first), expected)
        np.testing.assert_array_equal(commands.target(ONSET + last), expected)
    for outside in (ONSET - 1, ONSET + 1_200_000, ONSET + 10**9):
        assert commands.target(outside) is None
    assert commands.end_utime == ONSET + 1_200_000


def test_k_raises_the_right_knee_and_lowers_the_left_by_150_kilopascals() -> None:
    high, low = (MOTION.commands((k, 0.3), ONSET).targets[0] for k in (1.0, 0.0))
    np.testing.assert_allclose(high - low, [0.0, 150e3, 0.0, 0.0, -150e3, 0.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("theta", TRAINING_MOTIONS)
def test_motions_of_table_three_are_allowed(theta: Theta) -> None:
    assert len(MOTION.commands(theta, 0).switch_utime) == 3


def test_table_three_has_fifteen_motions() -> None:
    assert len(set(TRAINING_MOTIONS)) == 15


@pytest.mark.parametrize(
    ("theta", "named"),
    [
        ((1.001, 0.3), "k is 1.001; give -1 to 1"),
        ((float("nan"), 0.3), "k is nan"),
        ((0.0, 0.1), "t_w is 0.1 s; give more than 0.1 s and less than 1.2 s"),
        ((0.0, 0.1000001), "t_w is 0.1 s"),
        ((0.0, 1.2), "t_w is 1.2 s"),
        ((0.0, float("inf")), "t_w is inf"),
        ((0.0, 0.3, 0.0), "give 2 values: k, t_w"),
        ((0.0,), "give 2 values: k, t_w"),
    ],
)
def test_theta_out_of_range_is_named(theta: Theta, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        MOTION.commands(theta, 0)


def with_k(**values: Any) -> dict[str, Any]:
    k, t_w = MOTION.varied
    return {"varied": [{**k.model_dump(), **values}, t_w.model_dump()]}


def with_phase(number: int, **values: Any) -> dict[str, Any]:
    phases = [phase.model_dump() for phase in MOTION.phases]
    phases[number - 1].update(values)
    return {"phases": phases}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        # The right knee would need -50 kPa.
        (with_k(range=(-2.0, 1.0)), "targets of phase 1 reach -50000 to 550000; narrow a range"),
        (with_k(range=(1.0, -1.0)), "give the lower bound first"),
        (with_k(range=None), "k has no range"),
        (with_k(phase=4), "k changes phase 4; give 1 to 3"),
        (with_k(also=(4,)), "k changes phase 4; give 1 to 3"),
        (with_k(also=(1,)), "k changes phase 1 and also .1,.; give later ones"),
        (with_k(direction=(1.0,) * 7), "direction of k has 7 values; give 8"),
        (with_k(direction=None), "phase 1 ends at 0.1 and by"),
        (with_k(name="t_w"), "varied names t_w, t_w; give each parameter a name of its own"),
        (with_k(name="1 k"), "pattern"),
        (with_phase(1, until=1.3), "strictly increasing"),
        (with_phase(1, until=0.0), "strictly increasing"),
        (with_phase(2, until=0.2), "phase 2 ends at 0.2 and by"),
        (with_phase(1, until=None), "phase 1 ends at None and by no parameter"),
        (with_phase(3, until=None), "phase 3 ends at None and by no parameter"),
        (with_phase(1, target=(0.0,) * 7), "phase 2 has 8 targets, the first one 7"),
        ({"swing_phase": 4}, "swing_phase is 4; give 1 to 3"),
        ({"varied": []}, "at least 1 item"),
        ({"unknown": 1}, "Extra inputs"),
    ],
)
def test_template_that_cannot_be_executed_is_refused(change: dict[str, Any], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        PhasedMotion.model_validate({**MOTION.model_dump(), **change})


def test_a_changed_target_shows_when_its_phase_starts_and_a_changed_end_there() -> None:
    shows = [template.shows_from([(0.5, 0.3)])[0].tolist() for template in OF_THE_PAPER]
    assert shows == [[0.0, 0.3], [0.1, 0.3], [0.3, 0.3], [0.0, 0.3], [0.3, 0.3]]
    assert [template.last_change((0.5, 0.3)) for template in OF_THE_PAPER] == [0.3] * 5


def test_a_parameter_changes_the_targets_of_every_phase_it_names() -> None:
    both = PhasedMotion.model_validate({**MOTION.model_dump(), **with_k(also=(2,), range=(0.0, 0.1))})
    rest, changed = (np.array(both.commands((k, 0.3), 0).targets) for k in (0.0, 0.1))
    step = 0.1 * np.array(both.varied[0].direction)
    np.testing.assert_allclose(changed - rest, [step, step, np.zeros(8)], atol=1e-9)


def test_the_swing_begins_where_the_phase_before_it_ends() -> None:
    assert MOTION.swing_of((0.5, 0.3)) == 0.3
    assert MOTION.swing_start([(0.5, 0.3), (0.0, 0.25)]).tolist() == [0.3, 0.25]
    assert MADE_UP[0].swing_of((0.5,)) == 0.1
    first = MADE_UP[0].model_copy(update={"swing_phase": 1})
    assert first.swing_of((0.5,)) == 0.0


def test_only_k_changes_its_sign_in_the_mirrored_motion() -> None:
    assert MOTION.mirror is not None
    assert MOTION.mirror.tolist() == [-1.0, 1.0]
    assert MADE_UP[0].mirror is None


def test_theta_is_rounded_to_the_microseconds_of_the_messages_and_told_with_its_units() -> None:
    assert MOTION.rounded((0.12345678, 0.12345678)) == (0.12345678, 0.123457)
    assert MOTION.label((0.5, 0.3)) == "k = 0.5, t_w = 0.3 s"


@given(commands=all_commands(), utime=st.integers(0, 2**62), sequence=st.integers(0, 2**31 - 1))
def test_commands_survive_the_bus(commands: Commands, utime: int, sequence: int) -> None:
    message = actuator_command_t.decode(commands.to_message(utime, sequence).encode())
    assert Commands.from_message(message, CHANNELS) == commands
    assert (message.utime, message.command_sequence) == (utime, sequence)


@given(data=st.data())
def test_commands_of_any_number_of_channels_survive_the_bus(data: st.DataObject) -> None:
    template = data.draw(st.sampled_from(MADE_UP))
    channels = tuple(replace(CHANNELS[0], low=-10.0, high=30.0) for _ in range(2))
    commands = template.commands(data.draw(thetas(template)), ONSET)
    message = actuator_command_t.decode(commands.to_message(0, 1).encode())
    assert message.num_targets == 2
    assert Commands.from_message(message, channels) == commands


@pytest.mark.parametrize("value", [-1.0, SUPPLY + 1.0])
def test_message_with_an_impossible_pressure_is_refused(value: float) -> None:
    message = MOTION.commands((0.0, 0.3), ONSET).to_message(0, 0)
    message.target[1][4] = value
    with pytest.raises(MessageError, match=r"'valve 5: extends left knee' in phase 2 is .* give 0 to 900000 Pa"):
        Commands.from_message(message, CHANNELS)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_message_with_a_target_that_is_no_number_is_refused(value: float) -> None:
    message = MOTION.commands((0.0, 0.3), ONSET).to_message(0, 0)
    message.target[1][4] = value
    with pytest.raises(MessageError, match="target of channel 5 in phase 2 is"):
        Commands.from_message(message, CHANNELS)


def test_highest_pressure_is_that_of_the_channel() -> None:
    message = MOTION.commands((0.0, 0.3), ONSET).to_message(0, 0)
    with pytest.raises(MessageError, match="give 0 to 500000 Pa"):
        Commands.from_message(message, [replace(channel, high=5e5) for channel in CHANNELS])


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("switch_utime", [ONSET, ONSET + 1, ONSET + 2], "switch_utime 5000000 does not come after 5000000"),
        ("switch_utime", [ONSET + 2, ONSET + 1, ONSET + 3], "switch_utime 5000001"),
        ("switch_utime", [ONSET + 1, ONSET + 2], "switch_utime has 2 entries"),
        ("target", [[0.0] * 8, [0.0] * 7, [0.0] * 8], "phase 2 has 7 targets; give 8, one per channel"),
        ("target", [[0.0] * 9] * 3, "phase 1 has 9 targets; give 8, one per channel"),
        ("num_phases", 2, "num_phases promises 2"),
    ],
)
def test_malformed_message_is_refused(field: str, value: object, named: str) -> None:
    message = MOTION.commands((0.0, 0.3), ONSET).to_message(0, 0)
    setattr(message, field, value)
    with pytest.raises(MessageError, match=named):
        Commands.from_message(message, CHANNELS)


def test_empty_message_is_refused() -> None:
    with pytest.raises(MessageError, match="no phases"):
        Commands.from_message(actuator_command_t(), CHANNELS)


def test_commands_cannot_be_changed_from_outside() -> None:
    pressure = np.zeros((1, VALVES))
    commands = Commands(0, (1,), pressure)
    pressure[0, 0] = 1.0
    assert commands.targets[0, 0] == 0.0
    held = commands.target(0)
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


@given(data=st.data(), elapsed=st.integers(1, 1_300_000))
def test_matching_motions_agree_at_every_sampled_time_before(data: st.DataObject, elapsed: int) -> None:
    template = data.draw(st.sampled_from(OF_THE_PAPER + MADE_UP))
    a, b = (template.commands(data.draw(thetas(template)), ONSET) for _ in range(2))
    changes = [at for at in (*a.switch_utime, *b.switch_utime) if at < ONSET + elapsed]
    sampled = [*range(ONSET, ONSET + elapsed, 5_000), *changes, ONSET + elapsed - 1]
    # After its end a motion has no target: None there.
    agree = all(np.array_equal(np.array(a.target(at)), np.array(b.target(at))) for at in sampled)
    assert a.matches_until(b, ONSET + elapsed) == agree


def test_commands_change_as_in_figure_four_e() -> None:
    executed = MOTION.commands((0.2, 0.30), ONSET)
    elapsed = ONSET + 250_000
    assert MOTION.commands((0.2, 0.35), ONSET).matches_until(executed, elapsed)
    assert MOTION.commands((0.2, 0.25), ONSET).matches_until(executed, elapsed)  # it switches now
    assert not MOTION.commands((0.2, 0.24), ONSET).matches_until(executed, elapsed)
    assert not MOTION.commands((0.3, 0.30), ONSET).matches_until(executed, elapsed)
    assert MOTION.commands((0.3, 0.21), ONSET).matches_until(executed, ONSET)  # nothing is executed yet


def test_commands_that_differ_in_one_number_are_not_equal() -> None:
    commands = MOTION.commands((0.2, 0.3), ONSET)
    assert commands == replace(commands)
    assert commands != replace(commands, onset_utime=ONSET - 1)
    assert commands != replace(commands, targets=commands.targets + 1.0)
