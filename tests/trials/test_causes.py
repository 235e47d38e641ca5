"""Why a ball was missed, on hand-made logs in which the cause is known."""

from pathlib import Path

import numpy as np
import pytest
from liberobot import BODY, CONFIG, GRID, HAND, MOTION
from played_trials import event, mocap, plan

from imolo.config.experiment import MethodConfig
from imolo.contracts.trial import EventName
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.method.forward_model import PAPER_SVR, TrainingData
from imolo.method.planner import PlannerConfig
from imolo.method.table import LookupTable
from imolo.trials.causes import Cause
from imolo.trials.metrics import TrialResult, judge_campaign, judge_trial
from imolo_msgs import actuator_command_t, ball_state_t, marker_t, plan_t

FRAMES = np.round(np.arange(1, 121) * 1e6 / 120).astype(int)  # [µs]
ONSET, T_W, HIT = 400_000, 300_000, 860_000  # [µs] the motion, t_w since its onset, and when the two are to meet
LANDING = 950_000  # [µs]
TOUCH = 0.5 * BODY.effectors[0].width + CONFIG.simulation.ball.radius  # [m]
METHOD = MethodConfig(grid=GRID, planner=PlannerConfig(lead_time=0.008))
LAST_CHANGE = ONSET + T_W - 8_000  # [µs] frames before this one could still change t_w
OFF = np.array([0.0, 0.2, 0.0])  # [m] a clear miss


UP = np.array([0.0, 0.0, 1.0])


def ball_at(utime: float) -> np.ndarray:
    return np.array([5.0, 0.35, 1.1]) + np.array([-5.0, -0.4, 1.0]) * utime * 1e-6


GRID_POINT = ball_at(HIT)


def made_log(
    *,
    started: bool = True,
    hand_off: float = 0.0,
    wrong_until: int = 0,
    aims_at: np.ndarray = GRID_POINT,
    onset_late: int | None = 0,
    seen_until: int = LANDING,
) -> Log:
    """Return the log of a ball that was missed.

    Args:
        started: Whether there was a motion.
        hand_off: How far the hand passed the selected grid point [m].
        wrong_until: Until when the predicted path was `OFF` [µs].
        aims_at: The selected grid point [m].
        onset_late: How much later than planned the motion began [µs]; None if no event tells.
        seen_until: When the ball was last seen [µs].
    """
    log = Log(Path("made.lcmlog"))
    for number, utime in enumerate(FRAMES.tolist()):
        seen = utime <= seen_until
        markers = [(HAND, aims_at + UP * (hand_off + 5.0 * (utime - HIT) * 1e-6))]
        markers += [(marker_t.UNLABELLED, ball_at(utime))] if seen else []
        log.messages[channels.MOCAP].append(mocap(utime, number, *markers))
        message = plan(utime, plan_t.WAITING)
        if seen and utime < LANDING:
            state = ball_state_t()
            state.utime, state.ball_position = utime, ball_at(utime).tolist()
            log.messages[channels.BALL_STATE].append(state)
            path = [ball_at(utime + 10_000 * (step + 1)) + OFF * (utime < wrong_until) for step in range(90)]
            message = plan(utime, plan_t.TRACKING, prediction_step=0.01, num_predictions=90, predicted_position=path)
        if started and utime > ONSET:
            message.theta, message.plan_onset_utime, message.state = [0.3, T_W * 1e-6], ONSET, plan_t.KEPT
            message.hit_utime, message.target_position = HIT, aims_at.tolist()
        log.messages[channels.PLAN].append(message)
    log.messages[channels.TRIAL].append(event(EventName.START, 0))
    if started and onset_late is not None:
        log.messages[channels.TRIAL].append(event(EventName.ONSET, ONSET + onset_late))
    log.messages[channels.TRIAL].append(event(EventName.BALL_LANDED, LANDING))
    return log


def cause(log: Log, table: LookupTable | None = None, method: MethodConfig = METHOD) -> str | None:
    return judge_trial(log, CONFIG, method, table).cause


def table_of(*tuples: tuple[np.ndarray, float]) -> LookupTable:
    """Return a table of the given positions [m] and times since the onset [s]."""
    grid = GRID.model_copy(update={"match": "cell"})
    cell = np.floor(np.array([position for position, _ in tuples]) / grid.spacing + 0.5).astype(np.int64)
    time = np.array([time for _, time in tuples])
    theta = np.column_stack((np.zeros(len(time)), time - 0.17))
    return LookupTable(
        cell,
        time,
        theta,
        np.zeros((len(np.unique(theta, axis=0)), 3)),
        grid=grid,
        template=MOTION,
        forward_model=PAPER_SVR,
        training=TrainingData(np.zeros((1, 2)), np.zeros(1), np.zeros((1, 3))),
        robot="liberobot",
        origin={},
    )


# With a motion.


def test_ball_that_was_hit_has_no_cause() -> None:
    log = made_log()
    log.messages[channels.TRIAL].append(event(EventName.TOUCH, HIT))
    assert cause(log) is None


def test_hand_far_from_the_grid_point_is_a_hand_error() -> None:
    result = judge_trial(made_log(hand_off=0.2), CONFIG, METHOD)
    assert result.cause == Cause.HAND
    assert result.hand_error == pytest.approx(0.2, abs=1e-9)
    # The ball flies straight, and a straight line between two frames is exact but for the rounding to microseconds.
    assert result.ball_error == pytest.approx(0.0, abs=6e-6)


def test_ball_that_came_elsewhere_is_a_prediction_error_if_it_was_learned_too_late() -> None:
    result = judge_trial(made_log(aims_at=GRID_POINT + OFF, wrong_until=LAST_CHANGE), CONFIG, METHOD)
    assert result.cause == Cause.PREDICTION
    assert result.ball_error == pytest.approx(np.linalg.norm(OFF), abs=1e-5)


def test_update_was_impossible_if_the_miss_was_known_while_t_w_could_change() -> None:
    log = made_log(aims_at=GRID_POINT + OFF, wrong_until=LAST_CHANGE - 20_000)
    assert cause(log) == Cause.UPDATE


def test_known_miss_of_less_than_plate_and_ball_needs_no_update() -> None:
    near = GRID_POINT + OFF / np.linalg.norm(OFF) * 0.9 * TOUCH
    far = GRID_POINT + OFF / np.linalg.norm(OFF) * 1.1 * TOUCH
    assert cause(made_log(aims_at=near)) == Cause.PREDICTION
    assert cause(made_log(aims_at=far)) == Cause.UPDATE


@pytest.mark.parametrize(("theta", "effector"), [([], -1), ([0.3], 7), ([0.3, 0.3, 0.3], -8)])
def test_plans_that_name_no_theta_and_no_effector_of_the_robot_are_judged(theta: list[float], effector: int) -> None:
    log = made_log(aims_at=GRID_POINT + OFF, wrong_until=LAST_CHANGE - 20_000)
    named = judge_trial(log, CONFIG)
    for message in log.messages[channels.PLAN]:
        if message.plan_onset_utime:
            message.num_parameters, message.theta, message.effector = len(theta), theta, effector
    result = judge_trial(log, CONFIG)
    assert (result.theta, result.cause) == ((), Cause.PREDICTION)
    assert (result.outcome, result.hand_error, result.ball_error) == (
        named.outcome,
        named.hand_error,
        named.ball_error,
    )


def test_planner_that_updates_nothing_makes_prediction_errors() -> None:
    method = METHOD.model_copy(update={"planner": PlannerConfig(update=False)})
    assert cause(made_log(aims_at=GRID_POINT + OFF), method=method) == Cause.PREDICTION


@pytest.mark.parametrize(("hand_off", "expected"), [(0.19, Cause.UPDATE), (0.21, Cause.HAND)])
def test_the_larger_of_two_errors_is_the_cause(hand_off: float, expected: Cause) -> None:
    assert cause(made_log(aims_at=GRID_POINT + OFF, hand_off=hand_off)) == expected


@pytest.mark.parametrize(("late", "expected"), [(4_000, Cause.HAND), (5_000, Cause.LATE)])
def test_motion_that_began_late_by_more_than_half_a_time_step_is_a_late_start(late: int, expected: Cause) -> None:
    # Δt / 2 is 4.15 ms.
    assert cause(made_log(hand_off=0.2, onset_late=late)) == expected


def test_first_command_after_the_onset_is_a_late_start_where_no_event_tells() -> None:
    log = made_log(onset_late=None)
    log.messages[channels.ACTUATOR_COMMAND].append(actuator_command_t())
    log.received[channels.ACTUATOR_COMMAND].append(ONSET + 10_000)
    assert cause(log) == Cause.LATE


def test_ball_out_of_sight_at_the_hit_is_told_as_such() -> None:
    assert cause(made_log(seen_until=HIT - 100_000)) == Cause.UNSEEN
    assert cause(made_log(seen_until=HIT - 100_000, hand_off=0.2)) == Cause.HAND


# Without a motion.


def test_ball_that_was_never_seen_is_told_as_such() -> None:
    result = judge_trial(made_log(started=False, seen_until=0), CONFIG, METHOD)
    assert (result.cause, result.outcome, result.thrown_from) == (Cause.UNSEEN, "no motion found", None)


# The ball is at the grid point at 0.86 s; the first frame, at 8 ms, is the first that may start a motion.
@pytest.mark.parametrize(
    ("since_onset", "where", "expected"),
    [
        (0.95, GRID_POINT, Cause.LATE),  # no onset is early enough
        (0.50, GRID_POINT, Cause.NO_ENTRY),  # in time, so it was something else that failed
        (0.95, GRID_POINT + OFF, Cause.NO_ENTRY),  # the path goes nowhere near
    ],
)
def test_start_is_late_if_the_path_was_in_the_table_but_sooner_than_any_motion(
    since_onset: float, where: np.ndarray, expected: Cause
) -> None:
    # All cells around the point, so that the path, of which every tenth of a metre is predicted, meets one.
    around = [
        (where + 0.01 * np.array([x, y, z]), since_onset)
        for x in range(-5, 6)
        for y in range(-2, 3)
        for z in (-1, 0, 1)
    ]
    assert cause(made_log(started=False), table_of(*around)) == expected


@pytest.mark.parametrize(("observed", "expected"), [(0.1, Cause.NO_ENTRY), (0.7, Cause.LATE), (0.945, Cause.LATE)])
def test_without_the_table_the_fastest_motion_of_the_grid_tells_a_late_start(observed: float, expected: Cause) -> None:
    # The fastest motion takes 0.21 + 0.14 s, and the ball lands at 0.95 s.
    method = MethodConfig(grid=GRID, planner=PlannerConfig(observation_time=observed))
    assert cause(made_log(started=False), method=method) == expected


# Campaigns.


def test_ball_is_told_by_the_position_it_was_thrown_from() -> None:
    assert judge_trial(made_log(), CONFIG, METHOD).thrown_from == 1  # y = +0.4 m


def test_campaign_counts_causes_and_positions() -> None:
    def trial(index: int, why: Cause | None, place: int | None) -> TrialResult:
        return TrialResult(
            trial=index,
            hit=why is None,
            outcome="hit" if why is None else "missed",
            theta=None,
            updates=0,
            hand_error=None,
            prediction_error={},
            cause=why,
            thrown_from=place,
        )

    campaign = judge_campaign([trial(0, None, 0), trial(1, Cause.HAND, 1), trial(2, Cause.HAND, 0)])
    assert campaign.causes == {**dict.fromkeys(Cause, 0), Cause.HAND: 2}
    assert [(p.thrown_from, p.hits, p.balls) for p in campaign.positions] == [(0, 1, 2), (1, 0, 1)]
    assert sum(campaign.causes.values()) == campaign.balls - campaign.hits


def test_methods_of_the_paper_and_ours_judge_the_same_hit() -> None:
    log = made_log()
    log.messages[channels.TRIAL].append(event(EventName.TOUCH, HIT))
    assert len({judge_trial(log, CONFIG, method).model_dump_json() for method in CONFIG.methods.values()}) == 1
