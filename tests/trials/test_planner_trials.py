"""The planner in whole trials: with a table learned in MuJoCo, and with frames made by hand."""

import itertools
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from liberobot import CHANNELS
from played_trials import config, event, mocap, play
from requirements import AVAILABLE, BACKEND_NAMES, needs

from imolo.ball.model import BallModel
from imolo.campaigns.campaign import TrialTask, learning_tasks, run_task, run_tasks
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.errors import TableFileError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import Log, read_log
from imolo.method.commands import Commands
from imolo.method.forward_model import ForwardModelConfig
from imolo.method.planner import Planner, PlannerConfig
from imolo.method.table import LookupTable
from imolo.method.table_grid import GridAxis, TableGrid
from imolo.trials.learning import build_table, learn_ball, learn_motions
from imolo.trials.metrics import judge_trial
from imolo.trials.trial import SLICE
from imolo_msgs import marker_t, plan_t

CONFIG = config("mujoco")
FEW_THROWS = CONFIG.model_copy(update={"campaign": CONFIG.campaign.model_copy(update={"learning_throws": 4})})
# A fifth of the paper's predictions along each axis and twice its tolerances: as many queries are answered.
GRID = TableGrid(
    parameters={
        "t_w": GridAxis(start=0.21, stop=0.41, step=0.01),
        "k": GridAxis(start=-1.0, stop=1.0, step=0.05),
    },
    time_since_swing=GridAxis(start=0.14, stop=0.21, step=0.01),
    spacing=0.02,
    time_tolerance=0.02,
    unique="all",
)
# Fits in milliseconds; how well it predicts is not the point here.
QUICK = ForwardModelConfig(parameters={"C": 100.0, "epsilon": 0.001, "gamma": 0.3}, inputs="standardized")
LEAD = round(PlannerConfig().lead_time * 1e6)  # [µs]


@dataclass(frozen=True)
class Learned:
    table: LookupTable
    ball_model: BallModel

    def planner(self, robot: str | None = None, **values: bool) -> Planner:
        table = self.table
        if robot is not None:
            table.robot = robot
        return Planner(table, self.ball_model, PlannerConfig(**values), CONFIG.tracker)


@pytest.fixture(scope="session")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Learned:
    tasks = learning_tasks(FEW_THROWS, tmp_path_factory.mktemp("learning"))
    run_tasks(tasks, jobs=1)
    by_kind = {kind: [task.log_path for task in tasks if task.trial.kind is kind] for kind in TrialKind}
    ball_model = learn_ball(CONFIG.methods["paper"], by_kind[TrialKind.THROW])
    data = learn_motions(CONFIG, by_kind[TrialKind.TRAINING])
    method = CONFIG.methods["paper"].model_copy(update={"grid": GRID, "forward_model": QUICK})
    return Learned(build_table(CONFIG, method, data, ball_model), ball_model)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param((name, ball), marks=needs(name), id=f"{name}-ball{ball}")
        for name, ball in itertools.product(BACKEND_NAMES, (0, 1))
    ],
)
def hit(request: pytest.FixtureRequest, learned: Learned, tmp_path_factory: pytest.TempPathFactory) -> Log:
    backend, ball = request.param
    path = tmp_path_factory.mktemp("hit") / "log"
    return play(config(backend), path, learned.planner(), 1.6, TrialKind.HIT, ball)


def test_robot_swings_at_the_ball(hit: Log) -> None:
    names = [event.event for event in hit.messages[channels.TRIAL]]
    assert names[:3] == [EventName.START, EventName.THROW, EventName.ONSET]
    assert names[-1] == EventName.END


def test_every_frame_is_answered_once(hit: Log) -> None:
    frames = [(frame.utime, frame.frame_number) for frame in hit.messages[channels.MOCAP]]
    assert [(plan.utime, plan.answered_frame) for plan in hit.messages[channels.PLAN]] == frames
    assert hit.received[channels.PLAN] == hit.received[channels.MOCAP]


def test_every_frame_from_the_start_of_the_motion_is_answered_with_commands(hit: Log) -> None:
    states = [plan.state for plan in hit.messages[channels.PLAN]]
    first = states.index(plan_t.STARTED)
    assert set(states[:first]) <= {plan_t.WAITING, plan_t.TRACKING}
    assert set(states[first + 1 :]) <= {plan_t.UPDATED, plan_t.KEPT}
    commands = hit.messages[channels.ACTUATOR_COMMAND]
    assert [c.utime for c in commands] == [plan.utime for plan in hit.messages[channels.PLAN][first:]]
    assert [c.command_sequence for c in commands] == list(range(1, len(commands) + 1))


def test_onset_is_one_lead_after_the_frame_that_starts_the_motion(hit: Log) -> None:
    start = next(plan for plan in hit.messages[channels.PLAN] if plan.state == plan_t.STARTED)
    assert {c.onset_utime for c in hit.messages[channels.ACTUATOR_COMMAND]} == {start.utime + LEAD}


def test_first_command_arrives_before_its_onset(hit: Log) -> None:
    assert hit.received[channels.ACTUATOR_COMMAND][0] <= hit.messages[channels.ACTUATOR_COMMAND][0].onset_utime
    (onset,) = (event for event in hit.messages[channels.TRIAL] if event.event == EventName.ONSET)
    late, unit = onset.detail.split()[:2]
    # One engine step of 500 µs is all the lateness there is.
    assert (int(late) < 500, unit) == (True, "us")


def test_executed_part_of_the_commands_never_changes(hit: Log) -> None:
    commands = [Commands.from_message(message, CHANNELS) for message in hit.messages[channels.ACTUATOR_COMMAND]]
    received = hit.received[channels.ACTUATOR_COMMAND]
    for (before, after), effective in zip(pairwise(commands), received[1:], strict=True):
        assert before.matches_until(after, effective)


def test_only_updates_change_the_commands(hit: Log) -> None:
    commands = [Commands.from_message(message, CHANNELS) for message in hit.messages[channels.ACTUATOR_COMMAND]]
    states = [plan.state for plan in hit.messages[channels.PLAN]][-len(commands) :]
    for (before, after), state in zip(pairwise(commands), states[1:], strict=True):
        assert (before == after) == (state == plan_t.KEPT)


def test_plan_tells_the_motion_that_is_commanded(hit: Log, learned: Learned) -> None:
    plans = [plan for plan in hit.messages[channels.PLAN] if plan.plan_onset_utime]
    for plan, message in zip(plans, hit.messages[channels.ACTUATOR_COMMAND], strict=True):
        expected = learned.table.template.commands(tuple(plan.theta), plan.plan_onset_utime)
        assert Commands.from_message(message, CHANNELS) == expected
        assert plan.hit_utime > plan.plan_onset_utime


def test_target_is_a_grid_point_on_the_predicted_path(hit: Log) -> None:
    for plan in hit.messages[channels.PLAN]:
        if plan.state in (plan_t.STARTED, plan_t.UPDATED):
            target = np.array(plan.target_position)
            assert np.abs(target / GRID.spacing - np.rint(target / GRID.spacing)).max() < 1e-9
            distance = np.linalg.norm(np.array(plan.predicted_position) - target, axis=1)
            # Within half a cell along each axis; positions are sent in single precision.
            assert distance.min() <= np.sqrt(3) * GRID.spacing / 2 + 1e-6


def test_without_updates_the_first_motion_is_kept(learned: Learned, tmp_path: Path) -> None:
    log = play(CONFIG, tmp_path / "log", learned.planner(update=False), 1.0, TrialKind.HIT, 0)
    assert len({message.encode()[28:] for message in log.messages[channels.ACTUATOR_COMMAND]}) == 1
    assert not any(plan.state == plan_t.UPDATED for plan in log.messages[channels.PLAN])
    assert judge_trial(log, CONFIG).updates == 0


def test_one_planner_plays_a_trial_again_as_the_first_time(learned: Learned, tmp_path: Path) -> None:
    planner = learned.planner()
    for name in ("first", "again"):
        play(CONFIG, tmp_path / name, planner, 0.6, TrialKind.HIT, 0)
    assert (tmp_path / "first").read_bytes() == (tmp_path / "again").read_bytes()


def test_one_planner_with_one_table_file_makes_every_backend_speak_alike(learned: Learned, tmp_path: Path) -> None:
    """The same channels and types, and until the first trial ends the same clocks."""
    table = tmp_path / "table.npz"
    learned.table.save(table)
    logs = []
    for backend in AVAILABLE:
        path = tmp_path / backend
        run_task(TrialTask(config(backend), Trial(TrialKind.HIT, 0, 1), path, "paper", table))
        logs.append(read_log(path))
    spoken = [{name: type(messages[0]) for name, messages in log.messages.items() if messages} for log in logs]
    assert spoken == [{name: channel.message_type for name, channel in channels.STREAMS.items()}] * len(AVAILABLE)
    # When things happen, motions start and the ball is struck is for engine and planner to say.
    clocked = set(channels.STREAMS) - {channels.TRIAL, channels.ACTUATOR_COMMAND, channels.BALL_STATE}
    end = min(log.messages[channels.TRIAL][-1].utime for log in logs) - 10 * SLICE  # a frame may be under way
    for name in clocked:
        clocks = [[message.utime for message in log.messages[name] if message.utime < end] for log in logs]
        assert clocks == [clocks[0]] * len(AVAILABLE), name


def test_table_of_another_robot_ends_the_trial(learned: Learned, tmp_path: Path) -> None:
    own = learned.table.robot
    try:
        with pytest.raises(TableFileError, match=r"learned on robot 'atlas', but 'liberobot' is on the bus; train"):
            play(CONFIG, tmp_path / "log", learned.planner(robot="atlas"), 0.1, TrialKind.HIT)
    finally:
        learned.table.robot = own


# Frames by hand.


def answers(planner: Planner, *frames: object) -> tuple[list[plan_t], int]:
    """Return the plans with which a planner answers frames, and the number of its commands."""
    bus, plans, commands = Bus(), [], []
    planner.attach(bus)
    bus.subscribe(channels.PLAN, plans.append)
    bus.subscribe(channels.ACTUATOR_COMMAND, commands.append)
    bus.publish(channels.TRIAL, event(EventName.START, 0))
    for frame in frames:
        bus.publish(channels.MOCAP, frame)
    bus.drain()
    return plans, len(commands)


NOWHERE = (float("nan"), float("inf"), 1.0)


@pytest.mark.parametrize("label", [6, marker_t.UNLABELLED])
def test_marker_that_is_not_a_number_neither_stops_nor_moves_the_planner(learned: Learned, label: int) -> None:
    frames = [mocap(8333 * n, n, (0, (0.0, 0.0, 1.0)), (label, NOWHERE)) for n in range(1, 30)]
    plans, commands = answers(learned.planner(), *frames)
    assert [plan.answered_frame for plan in plans] == list(range(1, 30))
    assert {plan.state for plan in plans} == {plan_t.WAITING}
    assert commands == 0


def test_empty_frames_are_answered(learned: Learned) -> None:
    plans, commands = answers(learned.planner(), *(mocap(8333 * n, n) for n in range(1, 10)))
    assert [plan.answered_frame for plan in plans] == list(range(1, 10))
    assert commands == 0


def test_frame_that_is_not_newer_is_not_answered(learned: Learned) -> None:
    plans, _ = answers(learned.planner(), mocap(2000, 2), mocap(1000, 1), mocap(2000, 2), mocap(3000, 3))
    assert [plan.answered_frame for plan in plans] == [2, 3]


def test_nan_in_the_middle_of_a_flight_does_not_stop_the_motion(learned: Learned, hit: Log) -> None:
    """The frames of a real trial again, each with one more marker that is not a number."""
    frames = hit.messages[channels.MOCAP]
    broken = [mocap(f.utime, f.frame_number, *((m.marker_id, m.marker_position) for m in f.markers)) for f in frames]
    for frame in broken:
        frame.markers.append(mocap(0, 0, (marker_t.UNLABELLED, NOWHERE)).markers[0])
        frame.num_markers += 1
    clean, _ = answers(learned.planner(), *frames)
    plans, _ = answers(learned.planner(), *broken)
    assert [plan.encode() for plan in plans] == [plan.encode() for plan in clean]


def test_planner_that_was_warmed_up_plays_the_same_trial(learned: Learned, tmp_path: Path) -> None:
    cold, warm = learned.planner(), learned.planner()
    warm.warm_up()
    for name, planner in (("cold", cold), ("warm", warm)):
        play(CONFIG, tmp_path / name, planner, 0.9, TrialKind.HIT, index=1)
    assert (tmp_path / "cold").read_bytes() == (tmp_path / "warm").read_bytes()
    assert read_log(tmp_path / "cold").messages[channels.PLAN]
