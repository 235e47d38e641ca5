"""The robot as a backend, against a board and a Motive that fail as told: never a hang, and the log is kept."""

import contextlib
import re
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scripted_robot import (
    BODY,
    PATIENCE,
    Watched,
    backend,
    config,
    events,
    memory_bus,
    play,
    player,
    scripted_robot,
    void,
)

from imolo.campaigns.campaign import TrialTask, run_tasks
from imolo.contracts.registry import ready_simulations
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.errors import BackendError, ConfigError, TrialVoidError
from imolo.live.backend_program import BackendProgram
from imolo.live.identity import ClockMode
from imolo.live.program import Console, Stop
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.channels import STREAMS
from imolo.messaging.log import read_log
from imolo.trials.trainer import START_MARGIN
from imolo.trials.trial import Bystander
from imolo_drivers.natnet.messages import LabelledMarker
from imolo_msgs import mocap_frame_t

NUM_VALVES = 8  # of the default robot
HELD_UP = 30_000  # [µs] by which nothing is late on a machine that has time

Markers = list[LabelledMarker]


def test_motion_reaches_the_valves_and_the_streams_come_back(tmp_path: Path) -> None:
    with scripted_robot() as robot:
        log = play(config(robot), tmp_path / "log", player(), START_MARGIN + 0.3)
    spoken = {name for name, messages in log.messages.items() if messages}
    assert spoken == set(STREAMS) - {channels.BALL_STATE, channels.TRUTH_ROBOT, channels.TRUTH_BALL}
    assert events(log) == [EventName.START, EventName.ONSET, EventName.END]
    assert {(event.robot, event.backend) for event in log.messages[channels.TRIAL]} == {("liberobot", "hardware")}
    (onset,) = (event for event in log.messages[channels.TRIAL] if event.event == EventName.ONSET)
    commanded = log.messages[channels.ACTUATOR_COMMAND][0].onset_utime
    assert onset.utime >= commanded - 1000
    assert re.fullmatch(r"-?\d+ us after the commanded onset", onset.detail)
    # The simulated valves follow what the board lets rise: to the pressures of U, one phase after the other. None of
    # the first two is passed over, unless the machine holds the programs up.
    states = log.messages[channels.ACTUATOR_STATE]
    phases = [tuple(row) for row in log.messages[channels.ACTUATOR_COMMAND][0].target]
    given = [phases.index(tuple(state.measured)) for state in states if tuple(state.measured) in phases]
    assert given
    assert given == sorted(given)
    pauses = np.diff([state.utime for state in states])
    held_up = max(onset.utime - commanded, pauses.max()) > HELD_UP
    assert held_up or {0, 1} <= set(given)


def test_streams_are_numbered_and_their_clocks_increase(tmp_path: Path) -> None:
    with scripted_robot() as robot:
        log = play(config(robot), tmp_path / "log", Bystander(), 0.4)
    for name in (channels.ACTUATOR_STATE, channels.MOCAP):
        utimes = [message.utime for message in log.messages[name]]
        assert len(utimes) > 10
        assert utimes == sorted(set(utimes))
        assert utimes[0] > 0
        assert all(utime <= received + 2000 for utime, received in zip(utimes, log.received[name], strict=True))
    assert log.messages[channels.ACTUATOR_STATE][0].state_sequence == 1


def test_markers_are_where_they_are() -> None:
    with scripted_robot() as robot, contextlib.closing(Watched(robot)) as watched:
        watched.see(10)
    for frame in watched.frames:
        seen = {m.marker_id: m.marker_position for m in frame.markers if m.marker_id >= 0}
        assert seen.keys() == BODY.keys()
        assert np.allclose([seen[label] for label in BODY], list(BODY.values()), atol=1e-6)  # of a float


def test_ball_that_lands_is_told_and_is_no_hit(tmp_path: Path) -> None:
    with scripted_robot() as robot:
        log = play(config(robot), tmp_path / "log", Bystander(), PATIENCE, TrialKind.THROW)
    assert events(log) == [EventName.START, EventName.THROW, EventName.BALL_LANDED, EventName.END]
    assert robot.said.count("throw trial 0, seed 1") == 1


def test_throw_needs_no_arming(tmp_path: Path) -> None:
    with scripted_robot(armed=False) as robot:
        play(config(robot), tmp_path / "log", Bystander(), 0.1, TrialKind.THROW)
        assert robot.server.board.state.name == "VENTED"


def test_nobody_who_arms_ends_the_wait_in_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with scripted_robot(armed=False) as robot, pytest.raises(BackendError, match="nobody armed the robot"):
        play(config(robot, arm_patience=0.1), tmp_path / "log", player())
    assert "then `imolo arm 127.0.0.1" in caplog.text


def test_fault_between_arming_and_the_start_is_told_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may come in the same millisecond, so that no state ever says `armed`."""

    def break_down(pressure: Sequence[float]) -> None:
        if any(pressure):
            raise BackendError("the DAC does not answer")

    with scripted_robot() as robot:
        monkeypatch.setattr(robot.valves, "write", break_down)
        with pytest.raises(TrialVoidError, match="the board is latched: the DAC does not answer"):
            play(config(robot, arm_patience=5.0), tmp_path / "log", player())
    assert robot.said.count("latched: the DAC does not answer") == 1


def test_person_who_disarms_before_the_start_is_heard(tmp_path: Path) -> None:
    with scripted_robot() as robot:
        arm = robot.server.board.arm

        def arm_and_disarm(session: int, utime: int) -> None:
            arm(session, utime)
            robot.server.board.disarm(utime, "disarmed by Ada")

        robot.server.board.arm = arm_and_disarm  # type: ignore[method-assign]
        with pytest.raises(TrialVoidError, match="the board is vented: disarmed by Ada"):
            play(config(robot, arm_patience=5.0), tmp_path / "log", player())


def test_dry_run_moves_nothing(tmp_path: Path) -> None:
    with scripted_robot() as robot:
        log = play(config(robot, dry_run=True), tmp_path / "log", player(), START_MARGIN + 0.2)
    assert EventName.ONSET in events(log)
    assert {tuple(message.measured) for message in log.messages[channels.ACTUATOR_STATE]} == {(0.0,) * NUM_VALVES}


def test_robot_is_vented_and_disarmed_after_the_trial(tmp_path: Path) -> None:
    with scripted_robot() as robot:
        play(config(robot), tmp_path / "log", player(), START_MARGIN + 0.1)
        play(config(robot), tmp_path / "again", Bystander(), 0.05, TrialKind.THROW)
        assert robot.server.board.state.name == "VENTED"
        assert robot.server.board.cause == "disarmed by the end of the trial"
        assert robot.valves.pressure == (0.0,) * NUM_VALVES


# What goes wrong in a trial.


def test_lost_board_voids_the_trial_and_the_log_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with scripted_robot() as robot:

        def cut(utime: int) -> None:
            if utime > 150_000:
                for connection in list(robot.server._connections):
                    connection.link.shutdown(2)

        with pytest.raises(TrialVoidError, match="the link to the valve board"):
            play(config(robot), path, player(), PATIENCE, after_slice=cut)
    assert "is lost" in void(path)
    assert robot.valves.pressure == (0.0,) * NUM_VALVES


def test_person_who_disarms_ends_the_trial(tmp_path: Path) -> None:
    with scripted_robot() as robot:

        def disarm(utime: int) -> None:
            if utime > 100_000:
                robot.server.board.disarm(robot.server._clock(), "disarmed by a person")

        with pytest.raises(TrialVoidError, match="the board is vented: disarmed by a person"):
            play(config(robot), tmp_path / "log", player(), PATIENCE, after_slice=disarm)
    assert "disarmed by a person" in void(tmp_path / "log")


def test_campaign_keeps_the_log_of_a_void_trial_and_goes_on_when_asked_again(tmp_path: Path) -> None:
    trial, path = Trial(TrialKind.TRAINING, 0, 1), tmp_path / "training_000.lcmlog"

    def stall(elapsed: float, markers: Markers) -> Markers | None:
        return markers if elapsed < 0.15 else None

    with scripted_robot(stall) as robot, pytest.raises(TrialVoidError, match=r"is void: no camera frame .*void/"):
        run_tasks([TrialTask(config(robot, camera_patience=0.25), trial, path)], jobs=2)
    assert "no camera frame" in void(tmp_path / "void/training_000_0.lcmlog")
    assert not path.exists()
    with scripted_robot() as robot:
        run_tasks([TrialTask(config(robot), trial, path)], jobs=2)
    assert events(read_log(path))[-1] == EventName.END


class Mute:
    """A planner that commands until it stops."""

    def __init__(self, until: int) -> None:
        self._player, self._until = player(), until

    def attach(self, bus: Bus) -> None:
        self._player._bus = bus

        def on_frame(frame: mocap_frame_t) -> None:
            if frame.utime < self._until:
                self._player._on_frame(frame)

        bus.subscribe(channels.MOCAP, on_frame)


def test_planner_that_stops_is_vented_by_the_board(tmp_path: Path) -> None:
    with (
        scripted_robot(watchdog=0.5) as robot,
        pytest.raises(TrialVoidError, match="latched: no valid command for"),
    ):
        play(config(robot), tmp_path / "log", Mute(100_000), PATIENCE)
    assert "no valid command" in void(tmp_path / "log")


def test_jump_of_the_boards_clock_voids_the_trial(tmp_path: Path) -> None:
    with scripted_robot() as robot:
        clock = robot.server._clock

        def jump(utime: int) -> None:
            if utime > 100_000:
                robot.server._clock = lambda: clock() + 20_000

        with pytest.raises(TrialVoidError, match="the clock of the board jumped by"):
            play(config(robot), tmp_path / "log", Bystander(), PATIENCE, after_slice=jump)


def test_controller_that_computes_too_long_cannot_pass_for_a_trial(tmp_path: Path) -> None:
    """The clock on the wall is past the end of the trial when it returns, but the board has vented meanwhile."""

    def think(_: int) -> None:
        time.sleep(0.6)

    with scripted_robot(watchdog=0.1) as robot, pytest.raises(TrialVoidError, match="latched: nothing heard"):
        play(config(robot), tmp_path / "log", Bystander(), 0.3, after_slice=think)


def test_no_board_is_told(tmp_path: Path) -> None:
    with scripted_robot() as robot:
        chosen = config(robot, patience=0.1)
    with pytest.raises(BackendError, match="no valve board answers"):
        play(chosen, tmp_path / "log", player())


def test_board_of_another_robot_is_refused(tmp_path: Path) -> None:
    board = {"robot": "athlete", "channels": [{"name": f"muscle {number}"} for number in range(NUM_VALVES)]}
    with scripted_robot(**board) as robot, pytest.raises(BackendError, match="moves robot 'athlete'"):
        play(config(robot), tmp_path / "log", player())


@pytest.mark.parametrize(
    ("option", "value", "complaint"), [("board", "x:y", "is no address"), ("bord", "x", "'board'")]
)
def test_wrong_options_are_told(option: str, value: str, complaint: str) -> None:
    with scripted_robot() as robot, pytest.raises(ConfigError, match=complaint):
        backend(config(robot, **{option: value}))


def test_backend_that_was_not_started_says_so() -> None:
    with scripted_robot() as robot:
        one = backend(config(robot))
    assert one.utime == 0
    with pytest.raises(BackendError, match="has not been started"):
        one.advance(1000)
    one.close()


def test_sockets_are_closed_when_the_start_fails() -> None:
    with scripted_robot() as robot:
        one = backend(config(robot, patience=0.2, cameras={"command_port": 1}))
        with pytest.raises(BackendError):
            one.start(memory_bus(), Trial(TrialKind.TRAINING, 0, 1))
        assert (one._board, one._cameras) == (None, None)


def test_no_command_without_a_config_chooses_the_robot() -> None:
    assert "hardware" not in ready_simulations()


def test_robot_is_not_run_in_lock_step(tmp_path: Path) -> None:
    with scripted_robot() as robot:
        chosen = config(robot)
    with pytest.raises(ConfigError, match="waits for nobody; give --clock realtime"):
        BackendProgram(chosen, memory_bus(), ClockMode.LOCKSTEP, tmp_path, Stop(), Console("backend"))


def test_frames_of_every_trial_are_numbered_from_one() -> None:
    with scripted_robot() as robot:
        for _ in range(2):
            with contextlib.closing(Watched(robot)) as watched:
                watched.see(2)
            assert watched.frames[0].frame_number == 1


def test_frames_of_a_take_in_a_loop_are_numbered_on() -> None:
    with scripted_robot() as robot:
        robot.take = 10
        with contextlib.closing(Watched(robot)) as watched:
            watched.see(robot.take + 2)
    numbers = [frame.frame_number for frame in watched.frames]
    assert numbers == sorted(set(numbers))
