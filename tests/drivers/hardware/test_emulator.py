"""The emulator takes part in the streams like an engine, through real sockets, and its board is the real one."""

import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import played_trials as trials
import pytest
from requirements import AVAILABLE
from running_emulator import PATIENCE, RunningEmulator, emulator

from imolo.config.loading import config_for
from imolo.contracts.planner import Controller
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.errors import BackendError, TrainingDataError
from imolo.messaging import channels
from imolo.messaging.channels import STREAMS
from imolo.messaging.log import Log, read_log
from imolo.method.motion import Theta
from imolo.trials.recordings import hand_samples
from imolo.trials.trainer import START_MARGIN, MotionPlayer
from imolo.trials.trial import Bystander, run_trial
from imolo_drivers.board.client import BoardClient
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.handshake import ClientRole
from imolo_drivers.emulator import EmulatedRobot
from imolo_drivers.natnet.config import NatNetServerConfig
from imolo_msgs import mocap_frame_t

SIMULATION_ONLY = {channels.TRUTH_ROBOT, channels.TRUTH_BALL}
THETA: Theta = (0.5, 0.25)
DURATION = START_MARGIN + THETA[1] + 0.3  # [s] of a training trial, of which the swing starts at t_w


class Played(NamedTuple):
    """A motion through the emulator and simulated, and how long the machine held the emulator up [s]."""

    robot: Log
    simulated: Log
    lost: float


def skip_if_held_up(lost: float) -> None:
    """Leave a test out if the machine was so busy that the robot has stood still in the middle of it [s]."""
    if lost:
        pytest.skip(f"the machine was too busy: the robot has stood still for {lost:.2f} s")


def play(
    running: RunningEmulator, path: Path, kind: TrialKind, controller: Controller, duration: float, index: int = 0
) -> Log:
    run_trial(running.config(), Trial(kind, index, 1), controller, path, duration)
    return read_log(path)


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=() if name == "mujoco" else pytest.mark.slow) for name in AVAILABLE],
)
def training(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Played:
    """Return the same motion through the emulator, and simulated in this process."""
    folder = tmp_path_factory.mktemp(request.param)
    with emulator(request.param) as running:
        player, before = MotionPlayer(running.config().motion, THETA), running.robot.lost
        log = play(running, folder / "robot", TrialKind.TRAINING, player, DURATION)
        lost = running.robot.lost - before
    return Played(log, trials.play_motion(trials.config(request.param), folder / "simulated", THETA, 0.3), lost)


def test_robot_speaks_on_the_channels_of_a_simulation_but_knows_no_truth(training: Played) -> None:
    robot, simulated = (
        {name for name, messages in log.messages.items() if messages} for log in (training.robot, training.simulated)
    )
    assert robot == simulated - SIMULATION_ONLY


def test_messages_of_the_robot_have_the_types_of_their_channels(training: Played) -> None:
    for name in training.robot.messages:
        assert all(isinstance(message, STREAMS[name].message_type) for message in training.robot.messages.get(name, []))


def test_events_of_the_robot_come_in_order(training: Played) -> None:
    names = [event.event for event in training.robot.messages[channels.TRIAL]]
    assert names == [EventName.START, EventName.ONSET, EventName.END]
    assert {(event.robot, event.backend) for event in training.robot.messages[channels.TRIAL]} == {
        ("liberobot", "hardware")
    }


def test_clocks_of_the_robot_increase_and_begin_with_the_trial(training: Played) -> None:
    for name in (channels.MOCAP, channels.ACTUATOR_STATE):
        utimes = [message.utime for message in training.robot.messages[name]]
        assert utimes == sorted(set(utimes))
        assert utimes[0] > 0
    numbers = [message.state_sequence for message in training.robot.messages[channels.ACTUATOR_STATE]]
    assert numbers == sorted(set(numbers))


def test_pressures_and_frames_come_no_faster_than_their_rates(training: Played) -> None:
    """By their own clocks and numbers; on a busy machine an engine in real time may fall behind."""
    for name, number, rate in (
        (channels.MOCAP, "frame_number", 120.0),
        (channels.ACTUATOR_STATE, "state_sequence", 1000.0),
    ):
        messages = training.robot.messages[name]
        count = getattr(messages[-1], number) - getattr(messages[0], number)
        assert count / (1e-6 * (messages[-1].utime - messages[0].utime)) < 1.1 * rate


def test_motion_can_be_learned_from_the_robot(training: Played) -> None:
    try:
        samples = hand_samples(training.robot, config_for("mujoco"))
    except TrainingDataError:
        skip_if_held_up(training.lost)
        raise
    assert np.isfinite(samples.position).all()
    assert set(map(tuple, samples.theta)) == {THETA}


def test_frames_go_on_past_the_end_of_their_numbers() -> None:
    robot = EmulatedRobot(trials.config("mujoco"), BoardConfig(), ("127.0.0.1", 0), NatNetServerConfig(command_port=0))
    robot._first_frame = 2**31 - 3
    frame, numbers = mocap_frame_t(), []
    for frame.frame_number in (1, 2, 3, 4):
        robot._show(frame)
        numbers.append(robot._frames)
    robot.close()
    assert numbers == [2**31 - 2, 2**31 - 1, 0, 1]


def test_trial_that_cannot_be_drawn_is_told_and_costs_no_link() -> None:
    with emulator() as running:
        client = BoardClient(running.robot.board.address, ClientRole.CONTROLLER, "test", PATIENCE)
        for kind, index, seed in (("hit", -1, 1), ("hit", 0, -1), ("jump", 0, 1)):
            client.announced = False
            client.announce(kind, index, seed)
            assert client.wait(lambda: client.announced, PATIENCE)
        client.close()
    assert sum(line.endswith("nothing will be thrown") for line in running.said) == 3


def test_emulator_throws_the_ball_that_the_trial_asks_for(tmp_path: Path) -> None:
    """Where it lands does not depend on when: seed and index say it."""
    places = {}
    with emulator() as running:
        for index in (0, 1):
            before = running.robot.lost
            log = play(running, tmp_path / str(index), TrialKind.THROW, Bystander(), PATIENCE, index)
            landed = trials.events(log, EventName.BALL_LANDED)
            if not landed:
                skip_if_held_up(running.robot.lost - before)
            places[index] = landed[0].event_position
    for index, place in places.items():
        simulated = trials.play(
            trials.config("mujoco"), tmp_path / f"sim{index}", duration=1.6, kind=TrialKind.THROW, index=index
        )
        (landed,) = trials.events(simulated, EventName.BALL_LANDED)
        # A contact point is a radius away from the centre, which the cameras find within half a frame of flight.
        assert np.linalg.norm(np.array(place) - np.array(landed.event_position)) < 0.12
    assert np.linalg.norm(np.array(places[0]) - np.array(places[1])) > 0.12


def test_robot_is_not_emulated_by_a_robot() -> None:
    config = config_for("hardware")
    with pytest.raises(BackendError, match="is no engine"):
        EmulatedRobot(config, BoardConfig(), ("127.0.0.1", 0), NatNetServerConfig(command_port=0))


def test_program_says_where_it_is_and_ends(tmp_path: Path) -> None:
    ports = ["--listen", "127.0.0.1:0", "--motive", "127.0.0.1:0"]
    command = [sys.executable, "-m", "imolo.command_line.main", "emulate", "mujoco", *ports]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as program:
        assert program.stderr is not None
        line = program.stderr.readline()
        program.terminate()
        assert re.match(r"imolo emulate: mujoco: board on 127\.0\.0\.1:\d+, Motive on 127\.0\.0\.1:\d+, \w", line)
        assert program.wait(PATIENCE) == 0
