"""Judgements of hand-made logs, whose numbers are known."""

from math import nan, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from liberobot import BODY, CONFIG, HAND
from played_trials import event, mocap, plan

from imolo.contracts.trial import EventName
from imolo.errors import TrainingDataError
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.trials.metrics import HORIZONS, Statistic, TrialResult, judge_campaign, judge_trial, wilson_interval
from imolo.trials.recordings import hand_at, hand_samples, last_plan, merge, theta_of
from imolo_msgs import ball_state_t, marker_t, plan_t

ONSET, HIT_UTIME = 200_000, 700_000  # [µs]
START, VELOCITY = np.array([0.5, -0.2, 1.0]), np.array([3.0, 0.5, 7.0])  # of the hand [m], [m/s]
BALL, BALL_VELOCITY = np.array([5.0, 0.3, 1.1]), np.array([-5.0, -0.4, 1.0])
TARGET = START + VELOCITY * HIT_UTIME * 1e-6 + [0.003, 0.0, -0.004]  # 5 mm from where the hand will be
PERIOD = 8333  # [µs]


def made_log(*, swings: bool = True, touched: bool = True, landed: bool = True, miss: float = 0.0) -> Log:
    """Return the log of a hand and a ball at constant velocity.

    Args:
        swings: Whether a motion was found.
        touched: Whether the ball touched an arm at 0.8 s.
        landed: Whether the ball landed at 0.9 s.
        miss: By how much every predicted path is off along y [m].
    """
    log = Log(Path("made.lcmlog"))
    for number in range(1, 120):
        utime = PERIOD * number
        ball = BALL + BALL_VELOCITY * utime * 1e-6
        frame = mocap(utime, number, (HAND, START + VELOCITY * utime * 1e-6), (marker_t.UNLABELLED, ball))
        log.messages[channels.MOCAP].append(frame)
        state = ball_state_t()
        state.utime, state.ball_position = utime, ball.tolist()
        log.messages[channels.BALL_STATE].append(state)
        ahead = 0.01 * np.arange(1, 81)[:, None]
        message = plan(
            utime,
            prediction_step=0.01,
            num_predictions=80,
            predicted_position=(ball + BALL_VELOCITY * ahead + [0.0, miss, 0.0]).tolist(),
        )
        if swings and utime > ONSET:
            message.theta, message.plan_onset_utime = [0.3, 0.33], ONSET
            message.hit_utime, message.target_position = HIT_UTIME, TARGET.tolist()
            message.state = plan_t.UPDATED if number % 10 == 0 else plan_t.KEPT
        log.messages[channels.PLAN].append(message)
    told = [event(EventName.START, 0, trial=7)]
    told += [event(EventName.TOUCH, 800_000, trial=7)] if touched else []
    told += [event(EventName.BALL_LANDED, 900_000, trial=7)] if landed else []
    log.messages[channels.TRIAL] += told
    return log


@pytest.mark.parametrize(
    ("swings", "touched", "outcome"),
    [(True, True, "hit"), (True, False, "missed"), (False, False, "no motion found"), (False, True, "no motion found")],
)
def test_ball_counts_as_hit_if_a_moving_arm_touched_it(swings: bool, touched: bool, outcome: str) -> None:
    result = judge_trial(made_log(swings=swings, touched=touched), CONFIG)
    assert (result.outcome, result.hit, result.trial) == (outcome, outcome == "hit", 7)
    assert result.theta == ((0.3, 0.33) if swings else None)


def test_ball_that_touched_the_robot_before_the_onset_was_not_hit() -> None:
    log = made_log()
    next(e for e in log.messages[channels.TRIAL] if e.event == EventName.TOUCH).utime = ONSET - 1
    assert judge_trial(log, CONFIG).outcome == "missed"


def test_hand_error_is_the_distance_to_the_grid_point_when_it_counts() -> None:
    # A cubic through points of a straight line is that line, to rounding.
    assert judge_trial(made_log(), CONFIG).hand_error == pytest.approx(0.005, abs=1e-12)


def test_hand_error_is_that_of_the_hand_that_was_chosen() -> None:
    log = made_log()
    for message in log.messages[channels.PLAN]:
        message.effector = 1
    for frame in log.messages[channels.MOCAP]:
        other = frame.markers[0]
        assert other.marker_id == HAND
        other.marker_id = BODY.effector_marker(1)
    assert judge_trial(log, CONFIG).hand_error == pytest.approx(0.005, abs=1e-12)
    assert judge_trial(made_log(), CONFIG).hand_error is not None


def test_motion_that_names_no_effector_is_judged_by_the_one_that_learns() -> None:
    log = made_log()
    for message in log.messages[channels.PLAN]:
        message.effector = -1
    assert judge_trial(log, CONFIG).hand_error == pytest.approx(0.005, abs=1e-12)


def test_there_is_no_hand_error_without_a_motion_or_a_hand() -> None:
    assert judge_trial(made_log(swings=False), CONFIG).hand_error is None
    log = made_log()
    for frame in log.messages[channels.MOCAP]:
        frame.markers = [marker for marker in frame.markers if marker.marker_id != HAND]
    assert judge_trial(log, CONFIG).hand_error is None


def test_updates_are_counted() -> None:
    updated = [number for number in range(1, 120) if PERIOD * number > ONSET and number % 10 == 0]
    assert judge_trial(made_log(), CONFIG).updates == len(updated) == 9


@pytest.mark.parametrize("miss", [0.0, 0.02])
def test_prediction_error_is_how_far_the_predicted_path_was_off(miss: float) -> None:
    errors = judge_trial(made_log(miss=miss), CONFIG).prediction_error
    assert errors.keys() == {f"{horizon:.2f}" for horizon in HORIZONS}
    # Linear between the predictions, as the path is.
    assert list(errors.values()) == pytest.approx([miss] * 3, abs=1e-9)


def test_there_is_no_prediction_error_for_a_ball_that_never_ended() -> None:
    assert judge_trial(made_log(touched=False, landed=False), CONFIG).prediction_error == {}


def test_hand_is_interpolated_by_a_cubic() -> None:
    """A cubic in time is met exactly."""
    log = Log(Path("made"))
    times = [0.1 + 0.01 * number for number in range(30)]
    log.messages[channels.MOCAP] += [mocap(round(t * 1e6), n, (HAND, (t**3, t**2, t))) for n, t in enumerate(times)]
    hand = hand_at(log, HAND, 0.2345)
    assert hand == pytest.approx([0.2345**3, 0.2345**2, 0.2345], abs=1e-12)


@pytest.mark.parametrize("time", [0.0, 0.9999])
def test_hand_is_not_extrapolated(time: float) -> None:
    assert hand_at(made_log(), HAND, time) is None


def test_last_plan_is_the_one_of_the_motion() -> None:
    log = made_log()
    found = last_plan(log)
    assert found is log.messages[channels.PLAN][-1]
    assert last_plan(made_log(swings=False)) is None


def test_samples_are_those_of_the_swing() -> None:
    log = made_log()
    samples = hand_samples(log, CONFIG)
    since = samples.time - 0.33
    assert ((since > 0.13) & (since < 0.22)).all()
    # 90 ms at 120 Hz.
    assert len(since) in (10, 11)
    assert np.abs(samples.position - (START + VELOCITY * (samples.time + ONSET * 1e-6)[:, None])).max() < 1e-12
    assert (samples.theta == [0.3, 0.33]).all()


def test_log_without_a_motion_cannot_be_learned_from() -> None:
    with pytest.raises(TrainingDataError, match=r"made\.lcmlog holds no motion"):
        hand_samples(made_log(swings=False), CONFIG)


def test_log_without_the_hand_cannot_be_learned_from() -> None:
    log = made_log()
    for frame in log.messages[channels.MOCAP]:
        frame.markers = [marker for marker in frame.markers if marker.marker_id != HAND]
    with pytest.raises(TrainingDataError, match=r"marker 6 \(right_hand\) was not seen 0\.13 to 0\.22 s after"):
        hand_samples(log, CONFIG)


def test_no_trials_at_all_cannot_be_learned_from() -> None:
    with pytest.raises(TrainingDataError, match=r"no training trials; give at least one motion in training\.motions"):
        merge([])


# Statistics.


def test_wilson_interval_of_the_paper_is_58_to_92_per_cent() -> None:
    # 16 of 20 balls (Sec. VII-C); worked out by hand from Wilson 1927, to the digits given.
    low, high = wilson_interval(16, 20)
    assert (round(low, 3), round(high, 3)) == (0.584, 0.919)


@given(st.integers(1, 1000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_bounds_are_where_the_score_test_turns(counts: tuple[int, int]) -> None:
    """Each bound p solves (x/n - p)² = z² p (1 - p) / n."""
    successes, total = counts
    z = 1.959963984540054
    low, high = wilson_interval(successes, total)
    assert 0.0 <= low <= successes / total + 1e-15 <= high + 2e-15 <= 1.0 + 2e-15
    for bound in (low, high):
        score = (successes / total - bound) ** 2 - z**2 * bound * (1 - bound) / total
        assert abs(score) < 1e-12


def test_wilson_interval_of_nothing_is_everything() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_statistic_is_that_of_a_sample() -> None:
    found = Statistic.of([1.0, 2.0, 4.0])
    assert (found.mean, found.sd, found.count) == (pytest.approx(7 / 3), pytest.approx(sqrt(7 / 3)), 3)
    assert Statistic.of([2.5]) == Statistic(mean=2.5, sd=None, count=1)
    assert Statistic.of([]) == Statistic(mean=None, sd=None, count=0)


def test_statistic_does_not_swallow_nan() -> None:
    found = Statistic.of([1.0, nan, 2.0])
    assert found.mean is not None
    assert np.isnan([found.mean, found.sd]).all()
    assert found.count == 3


def result(trial: int, hit: bool, theta: tuple[float, float] | None, error: float | None) -> TrialResult:
    return TrialResult(
        trial=trial,
        hit=hit,
        outcome="hit" if hit else "missed",
        theta=theta,
        updates=0,
        hand_error=error,
        prediction_error={"0.25": 0.01 * trial} if trial else {},
    )


def test_campaign_counts_hits_motions_and_errors_that_there_are() -> None:
    trials = [result(0, True, (0.0, 0.3), 0.01), result(1, False, (0.1, 0.3), 0.03), result(2, False, None, None)]
    campaign = judge_campaign(trials)
    assert (campaign.hits, campaign.balls, campaign.started) == (1, 3, 2)
    assert campaign.interval == wilson_interval(1, 3)
    assert campaign.hand_error.mean == pytest.approx(0.02)
    assert campaign.hand_error.count == 2
    assert campaign.prediction_error["0.25"].mean == pytest.approx(0.015)
    assert campaign.prediction_error["0.75"].count == 0


@pytest.mark.parametrize(
    ("theta", "known", "told"),
    [((0.3, 0.33), True, 0), ((), False, 0), ((0.3,), False, 1), ((0.3, 0.33, 0.1), False, 1)],
)
def test_theta_of_another_motion_is_told(
    theta: tuple[float, ...], known: bool, told: int, caplog: pytest.LogCaptureFixture
) -> None:
    message = plan(0, theta=list(theta))
    assert theta_of(message, CONFIG.motion) == (theta if known else ())
    assert sum(f"a PLAN has a theta of {len(theta)} values, the motion has 2" in one for one in caplog.messages) == told
