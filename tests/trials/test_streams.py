"""Every backend speaks the same streams on the same clock; nothing here may know which engine it is."""

from itertools import pairwise
from math import ceil
from pathlib import Path

import numpy as np
import pytest
from liberobot import AIR, CONFIG, HAND
from played_trials import COARSE, Commander, command, config, events, play, play_motion, quiet
from requirements import BACKEND_PARAMS

from imolo.contracts.trial import EventName, TrialKind
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.trials.recordings import hand_at, last_plan
from imolo.trials.trainer import START_MARGIN
from imolo.trials.trial import SLICE, describe_robot
from imolo_msgs import actuator_command_t

THETA = (0.5, 0.25)
STEP = round(COARSE * 1e6)  # [µs]
TICK = SLICE  # [µs] at which the bus is looked at
RATES = CONFIG.simulation
DURATION = START_MARGIN + THETA[1]  # [s] of the training trial


@pytest.fixture(scope="module", params=BACKEND_PARAMS)
def backend(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture(scope="module")
def training(backend: str, tmp_path_factory: pytest.TempPathFactory) -> Log:
    return play_motion(config(backend), tmp_path_factory.mktemp(backend) / "log", THETA, 0.0)


@pytest.fixture(scope="module")
def throw(backend: str, tmp_path_factory: pytest.TempPathFactory) -> Log:
    path = tmp_path_factory.mktemp(backend) / "log"
    return play(config(backend), path, duration=1.6, kind=TrialKind.THROW)


def test_training_trial_speaks_on_these_channels_alone(training: Log) -> None:
    assert {name for name, messages in training.messages.items() if messages} == {
        channels.ACTUATOR_COMMAND,
        channels.ACTUATOR_STATE,
        channels.MOCAP,
        channels.PLAN,
        channels.ROBOT,
        channels.TRIAL,
        channels.TRUTH_ROBOT,
        channels.TRUTH_BALL,
    }


@pytest.mark.parametrize(
    ("channel", "rate"),
    [
        (channels.ACTUATOR_STATE, RATES.sensor_rate),
        (channels.TRUTH_ROBOT, RATES.truth_rate),
        (channels.TRUTH_BALL, RATES.truth_rate),
    ],
)
def test_sensors_and_truth_come_at_their_rates(training: Log, channel: str, rate: float) -> None:
    utimes = [message.utime for message in training.messages[channel]]
    # On the first step after each instant.
    instants = np.arange(1, int(DURATION * rate + 1e-6) + 1) / rate
    assert utimes == [STEP * ceil(instant / COARSE - 1e-6) for instant in instants]
    # The bus is drained at the end of a slice.
    assert training.received[channel] == [SLICE * ceil(utime / SLICE) for utime in utimes]


def test_every_mocap_frame_has_its_truth(training: Log) -> None:
    truth = {message.utime for message in training.messages[channels.TRUTH_ROBOT]}
    assert {frame.utime for frame in training.messages[channels.MOCAP]} <= truth


def test_sensors_are_numbered_without_a_gap(training: Log) -> None:
    numbers = [message.state_sequence for message in training.messages[channels.ACTUATOR_STATE]]
    assert numbers == list(range(1, round(DURATION * RATES.sensor_rate) + 1))


def test_frames_are_exposed_at_120_hz(training: Log) -> None:
    frames = training.messages[channels.MOCAP]
    for frame in frames:
        # On the first step after the exposure, which the clock of the cameras counts from the start of the trial.
        assert frame.utime == STEP * ceil(frame.frame_number / 120.0 / COARSE - 1e-6)
    # All but the lost ones, a thousandth, and the last one, which is still under way.
    assert len(frames) >= 0.3 * 120 - 3


def test_frames_arrive_with_the_first_tick_after_their_latency(training: Log) -> None:
    latency = 5000
    for frame, received in zip(training.messages[channels.MOCAP], training.received[channels.MOCAP], strict=True):
        assert received == TICK * ceil((frame.utime + latency) / TICK)


def test_clock_of_the_log_never_goes_back(training: Log, throw: Log) -> None:
    for log in (training, throw):
        for times in log.received.values():
            assert all(before <= after for before, after in pairwise(times))


def test_clock_of_every_stream_is_strictly_increasing(training: Log, throw: Log) -> None:
    for log in (training, throw):
        for name in (channels.ACTUATOR_STATE, channels.MOCAP, channels.TRUTH_ROBOT, channels.TRUTH_BALL):
            utimes = [message.utime for message in log.messages[name]]
            assert all(before < after for before, after in pairwise(utimes))


def test_training_events_come_in_order(training: Log, backend: str) -> None:
    told = training.messages[channels.TRIAL]
    assert [event.event for event in told] == [EventName.START, EventName.ONSET, EventName.END]
    assert [event.utime for event in told] == sorted(event.utime for event in told)
    assert {(event.robot, event.backend, event.trial) for event in told} == {("liberobot", backend, 0)}
    assert told[0].utime == 0


def test_throw_events_come_in_order(throw: Log) -> None:
    names = [event.event for event in throw.messages[channels.TRIAL]]
    assert names[:2] == [EventName.START, EventName.THROW]
    assert names[-1] == EventName.END
    assert names.count(EventName.BALL_LANDED) == 1
    assert not {EventName.ONSET, EventName.TOUCH} & set(names)


def test_log_begins_with_what_its_numbers_mean(training: Log, throw: Log, backend: str) -> None:
    for log in (training, throw):
        (robot,) = log.messages[channels.ROBOT]
        assert robot.utime == log.received[channels.ROBOT][0] == 0
        assert robot.encode() == describe_robot(config(backend), 0).encode()
        assert (robot.robot_name, robot.task_name) == ("liberobot", "hit")
        assert (robot.parameter_name, robot.parameter_unit) == (["k", "t_w"], ["", "s"])
        assert list(zip(robot.effector_name, robot.effector_label, strict=True)) == [
            ("right_hand", 6),
            ("left_hand", 7),
        ]
        truth = log.messages[channels.TRUTH_ROBOT][0]
        assert (truth.num_joints, truth.num_effectors) == (robot.num_robot_joints, robot.num_robot_effectors) == (8, 2)
        state = log.messages[channels.ACTUATOR_STATE][0]
        assert state.num_measured == robot.num_channels == 8
        assert set(robot.channel_unit) == {"Pa"}


def test_texts_are_ascii_so_that_every_lcm_language_reads_them(training: Log, throw: Log) -> None:
    for log in (training, throw):
        for event in log.messages[channels.TRIAL]:
            assert "".join((event.event, event.robot, event.backend, event.detail)).isascii()


def test_onset_is_executed_at_the_commanded_time(training: Log) -> None:
    (onset,) = events(training, EventName.ONSET)
    plan = last_plan(training)
    assert plan is not None
    # On the first step that is not before it.
    assert onset.utime == STEP * ceil(plan.plan_onset_utime / STEP)
    assert onset.detail == f"{onset.utime - plan.plan_onset_utime} us after the commanded onset"


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_phase_switches_at_the_commanded_time(backend: str, phase: int, tmp_path: Path) -> None:
    """Two commands that differ in one phase alone give the same pressures until its start and one dead time."""
    onset = 20_000
    late = round(AIR.valve_dead_time * 1e6)

    def pressures(name: str, target: float) -> dict[int, list[float]]:
        message = command(onset, (0.0, 0.15))
        message.target[phase][2] = target
        exact = quiet(backend, actuators={"pressure_noise": 0.0})
        log = play(exact, tmp_path / name, Commander(lambda _: message), 0.2)
        return {m.utime: m.measured for m in log.messages[channels.ACTUATOR_STATE]}

    one, other = pressures("one", 0.0), pressures("other", 6e5)
    start = (onset, onset + 100_000, onset + 150_000)[phase]
    assert min(utime for utime in one if one[utime] != other[utime]) == start + (late // TICK + 1) * TICK


def test_same_seed_gives_the_same_log_to_the_byte(backend: str, tmp_path: Path) -> None:
    for name in ("one", "same"):
        play_motion(config(backend), tmp_path / name, THETA, 0.0)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "same").read_bytes()


def test_another_seed_gives_another_log(backend: str, training: Log, tmp_path: Path) -> None:
    other = play_motion(config(backend, seed=2), tmp_path / "log", THETA, 0.0)
    for name in (channels.MOCAP, channels.ACTUATOR_STATE, channels.TRUTH_ROBOT):
        assert [m.encode() for m in other.messages[name]] != [m.encode() for m in training.messages[name]]


def test_motion_commanded_too_late_is_announced_with_its_lateness(backend: str, tmp_path: Path) -> None:
    late = 4000
    sent: list[actuator_command_t] = []

    def answer(frame: object) -> actuator_command_t | None:
        if not sent:
            sent.append(command(frame.utime - late))  # type: ignore[attr-defined]
        return sent[0]

    log = play(quiet(backend), tmp_path / "log", Commander(answer), 0.05)
    (onset,) = events(log, EventName.ONSET)
    received = log.received[channels.ACTUATOR_COMMAND][0]
    assert onset.utime == received
    assert onset.detail == f"{received - sent[0].onset_utime} us after the commanded onset"
    assert received - sent[0].onset_utime > late


def bad_command(fault: str) -> actuator_command_t:
    message = command(20_000)
    if fault == "not finite":
        message.target[1][2] = float("nan")
    elif fault == "too high":
        message.target[1][2] = 5e6
    elif fault == "negative":
        message.target[0][0] = -1.0
    elif fault == "backwards":
        message.switch_utime.reverse()
    return message


@pytest.mark.parametrize("fault", ["not finite", "too high", "negative", "backwards"])
def test_bad_command_is_refused_and_nothing_moves(
    backend: str, fault: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    asked = play(quiet(backend), tmp_path / "asked", Commander(lambda _: bad_command(fault)), 0.06)
    resting = play(quiet(backend), tmp_path / "resting", duration=0.06)
    assert "refused a command" in caplog.text
    assert events(asked, EventName.ONSET) == []
    truths = ([m.encode() for m in log.messages[channels.TRUTH_ROBOT]] for log in (asked, resting))
    assert next(truths) == next(truths)


def test_bad_command_does_not_end_the_motion_under_way(backend: str, tmp_path: Path) -> None:
    def answer(frame: object) -> actuator_command_t:
        return command(20_000) if frame.frame_number < 3 else bad_command("too high")  # type: ignore[attr-defined]

    log = play(quiet(backend), tmp_path / "log", Commander(answer), 0.06)
    good = play(quiet(backend), tmp_path / "good", Commander(lambda _: command(20_000)), 0.06)
    assert [m.encode() for m in log.messages[channels.TRUTH_ROBOT]] == [
        m.encode() for m in good.messages[channels.TRUTH_ROBOT]
    ]


def test_hand_of_the_cameras_is_the_true_hand(backend: str, tmp_path: Path) -> None:
    log = play_motion(quiet(backend), tmp_path / "log", THETA, 0.2)
    truth = {message.utime: message.effector_position for message in log.messages[channels.TRUTH_ROBOT]}
    both = [frame.utime for frame in log.messages[channels.MOCAP] if frame.utime in truth]
    assert len(both) >= 3
    for utime in both:
        # A spline passes through its knots.
        assert hand_at(log, HAND, utime * 1e-6) == pytest.approx(truth[utime][0], abs=1e-12)
