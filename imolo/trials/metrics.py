"""What the logs say about a campaign; nothing here knows a backend or looks at simulation truth (Sec. VII)."""

from collections.abc import Sequence
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, NonNegativeInt

from imolo.config.experiment import ExperimentConfig, MethodConfig
from imolo.config.loading import body_of, create_task, task_plugin
from imolo.contracts.task import Verdict
from imolo.errors import BusError
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.method.table import LookupTable
from imolo.trials.causes import Cause, distance_of_ball, find_cause, throw_position
from imolo.trials.recordings import effector_of, hand_at, last_plan, nearest_unlabelled, theta_of
from imolo_msgs import plan_t

Array = NDArray[np.float64]

HORIZONS = (0.25, 0.50, 0.75)  # [s] Sec. VII-C


class TrialResult(BaseModel):
    """One ball.

    Attributes:
        trial: Index of the trial.
        hit: Whether the task was done.
        outcome: "hit" (or what the task calls it), "missed" or "no motion found".
        theta: Of the last plan; None without a motion, empty if the planner names none.
        updates: How often the commands were updated after the onset.
        hand_error: Distance between the selected grid point and the hand when it was to be there [m]; None without a
            motion or if the hand was not seen.
        prediction_error: Distance between the ball where it ended and where it had been predicted, by lead time [m].
        cause: Why it was missed, one of `causes.Cause`; None if it was hit.
        ball_error: Distance between the selected grid point and the ball when the hand was to be there [m]; None
            without a motion or if the ball was not seen.
        thrown_from: Which of the thrower's positions it came from, counted from 0; None if the ball was not seen.
        measures: What the task measures beside it, by name with the unit in brackets.
    """

    model_config = ConfigDict(frozen=True)

    trial: NonNegativeInt
    hit: bool
    outcome: str
    theta: tuple[float, ...] | None
    updates: NonNegativeInt
    hand_error: float | None
    prediction_error: dict[str, float]
    cause: str | None = None
    ball_error: float | None = None
    thrown_from: int | None = None
    measures: dict[str, float] = {}


class Statistic(BaseModel):
    """Mean, standard deviation and number of some distances [m]."""

    model_config = ConfigDict(frozen=True)

    mean: float | None
    sd: float | None
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> "Statistic":
        """Summarise values; a NaN among them stays one."""
        if not values:
            return cls(mean=None, sd=None, count=0)
        spread = float(np.std(values, ddof=1)) if len(values) > 1 else None
        return cls(mean=float(np.mean(values)), sd=spread, count=len(values))


class PositionResult(BaseModel):
    """The balls from one position of the thrower.

    Attributes:
        thrown_from: Which position, counted from 0; -1 for balls that were not seen.
        hits: Number of balls that were hit.
        balls: Number of balls.
        interval: Wilson 95 % interval of the hit rate.
    """

    model_config = ConfigDict(frozen=True)

    thrown_from: int
    hits: int
    balls: int
    interval: tuple[float, float]


class MethodResult(BaseModel):
    """One method on one backend.

    Attributes:
        hits: Number of balls that were hit.
        balls: Number of balls.
        interval: Wilson 95 % interval of the hit rate.
        started: Number of balls for which a motion was found.
        hand_error: Of all trials with a motion [m].
        prediction_error: By lead time [m].
        trials: Ball by ball.
        causes: How many balls were missed for each of `causes.Cause`, zeros included, and for causes of the task's own.
        measures: What the task measures beside it, by name with the unit in brackets.
        positions: The hits by position of the thrower.
    """

    model_config = ConfigDict(frozen=True)

    hits: int
    balls: int
    interval: tuple[float, float]
    started: int
    hand_error: Statistic
    prediction_error: dict[str, Statistic]
    trials: tuple[TrialResult, ...]
    causes: dict[str, int] = {}
    measures: dict[str, Statistic] = {}
    positions: tuple[PositionResult, ...] = ()


def judge_trial(
    log: Log, config: ExperimentConfig, method: MethodConfig | None = None, table: LookupTable | None = None
) -> TrialResult:
    """Judge one ball by its log.

    Args:
        log: Of the trial.
        config: Of the experiment.
        method: That planned; the first one of the config if not given.
        table: That it planned with, to tell a late start from a missing entry; see `causes`.

    Raises:
        BusError: The log holds no trial.
    """
    events = log.messages[channels.TRIAL]
    if not events:
        raise BusError(f"{log.path} holds no trial event; was it recorded by imolo?")
    plan = last_plan(log)
    task = create_task(config)
    verdict = Verdict(False) if plan is None else task.judge(log, plan.plan_onset_utime)
    outcome = "no motion found" if plan is None else task_plugin(config).success if verdict.success else "missed"
    updates = sum(message.state == plan_t.UPDATED for message in log.messages[channels.PLAN])
    end = next((event.utime for event in events if task.ends(event)), None)
    hand_error = None if plan is None else _hand_error(log, plan, config)
    ball_error = None if plan is None else distance_of_ball(log, plan)
    cause = None
    if not verdict.success:
        method = method or next(iter(config.methods.values()))
        cause = verdict.cause or find_cause(log, config, method, table, hand_error, ball_error)
    return TrialResult(
        trial=events[0].trial,
        hit=verdict.success,
        outcome=outcome,
        theta=None if plan is None else theta_of(plan, config.motion),
        updates=updates,
        hand_error=hand_error,
        prediction_error={} if end is None else _prediction_errors(log, end),
        cause=cause,
        ball_error=ball_error,
        thrown_from=throw_position(log, config),
        measures=dict(verdict.measures),
    )


def judge_campaign(trials: Sequence[TrialResult]) -> MethodResult:
    """Summarise the balls of one method on one backend."""
    hits = sum(trial.hit for trial in trials)
    keys = [f"{horizon:.2f}" for horizon in HORIZONS]
    return MethodResult(
        hits=hits,
        balls=len(trials),
        interval=wilson_interval(hits, len(trials)),
        started=sum(trial.theta is not None for trial in trials),
        hand_error=Statistic.of([trial.hand_error for trial in trials if trial.hand_error is not None]),
        prediction_error={
            key: Statistic.of([t.prediction_error[key] for t in trials if key in t.prediction_error]) for key in keys
        },
        trials=tuple(trials),
        causes=_count_causes(trials),
        measures={
            name: Statistic.of([trial.measures[name] for trial in trials if name in trial.measures])
            for name in sorted({name for trial in trials for name in trial.measures})
        },
        positions=_by_position(trials),
    )


def _count_causes(trials: Sequence[TrialResult]) -> dict[str, int]:
    counts = dict.fromkeys((cause.value for cause in Cause), 0)
    for trial in trials:
        if trial.cause is not None:
            counts[trial.cause] = counts.get(trial.cause, 0) + 1
    return counts


def wilson_interval(successes: int, total: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Return the Wilson score interval of a proportion; z = 1.96 gives 95 % (Wilson 1927, JASA 22, 209)."""
    if total == 0:
        return 0.0, 1.0
    rate = successes / total
    center = (rate + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z / (1 + z**2 / total) * sqrt(rate * (1 - rate) / total + z**2 / (4 * total**2))
    # At the ends rounding would leave 1e-17 of a hit.
    low = 0.0 if successes == 0 else center - half
    high = 1.0 if successes == total else center + half
    return low, high


def _by_position(trials: Sequence[TrialResult]) -> tuple[PositionResult, ...]:
    groups: dict[int, list[bool]] = {}
    for trial in trials:
        groups.setdefault(-1 if trial.thrown_from is None else trial.thrown_from, []).append(trial.hit)
    return tuple(
        PositionResult(
            thrown_from=place, hits=sum(hits), balls=len(hits), interval=wilson_interval(sum(hits), len(hits))
        )
        for place, hits in sorted(groups.items())
    )


def _hand_error(log: Log, plan: plan_t, config: ExperimentConfig) -> float | None:
    body = body_of(config.robot)
    hand = hand_at(log, body.effector_marker(effector_of(plan, body)), plan.hit_utime * 1e-6)
    return None if hand is None else float(np.linalg.norm(hand - np.array(plan.target_position)))


def _prediction_errors(log: Log, end_utime: int) -> dict[str, float]:
    """Compare the last ball position before `end_utime` with the paths that were predicted earlier (Sec. VII-C)."""
    frames = {frame.utime: frame for frame in log.messages[channels.MOCAP]}
    final: Array | None = None
    for state in reversed(log.messages[channels.BALL_STATE]):
        if state.utime < end_utime and state.utime in frames:
            final = nearest_unlabelled(frames[state.utime], np.array(state.ball_position))
            if final is not None:
                final_utime = state.utime
                break
    if final is None:
        return {}
    errors = {}
    for horizon in HORIZONS:
        earlier = [
            plan
            for plan in log.messages[channels.PLAN]
            if plan.num_predictions and plan.utime <= final_utime - horizon * 1e6 + 1
        ]
        if not earlier or final_utime - earlier[-1].utime > (horizon + 0.05) * 1e6:
            continue
        plan = earlier[-1]
        path = np.array(plan.predicted_position)
        times = plan.prediction_step * np.arange(1, len(path) + 1)
        lead = (final_utime - plan.utime) * 1e-6
        if lead > times[-1]:
            continue
        predicted = np.array([np.interp(lead, times, path[:, axis]) for axis in range(3)])
        errors[f"{horizon:.2f}"] = float(np.linalg.norm(predicted - final))
    return errors
