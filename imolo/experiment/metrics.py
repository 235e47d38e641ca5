"""What the logs say about a campaign; nothing here knows a backend or looks at simulation truth (Sec. VII)."""

from collections.abc import Sequence
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from imolo import channels
from imolo.backend import EventName
from imolo.config.experiment import ExperimentConfig
from imolo.errors import BusError
from imolo.experiment.recordings import hand_at, last_plan, nearest_unlabelled
from imolo.log import Log
from imolo_msgs import plan_t

Array = NDArray[np.float64]

HORIZONS = (0.25, 0.50, 0.75)  # [s] Sec. VII-C


class TrialResult(BaseModel):
    """One ball.

    Attributes:
        trial: Index of the trial.
        hit: Whether an arm of the moving robot touched the ball before it landed.
        outcome: "hit", "missed" or "no motion found".
        theta: k [-] and t_w [s] of the last plan; None without a motion.
        updates: How often the commands were updated after the onset.
        hand_error: Distance between the selected grid point and the hand when it was to be there [m]; None without a
            motion or if the hand was not seen.
        prediction_error: Distance between the ball where it ended and where it had been predicted, by lead time [m].
    """

    model_config = ConfigDict(frozen=True)

    trial: int
    hit: bool
    outcome: str
    theta: tuple[float, float] | None
    updates: int
    hand_error: float | None
    prediction_error: dict[str, float]


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
    """

    model_config = ConfigDict(frozen=True)

    hits: int
    balls: int
    interval: tuple[float, float]
    started: int
    hand_error: Statistic
    prediction_error: dict[str, Statistic]
    trials: tuple[TrialResult, ...]


def judge_trial(log: Log, config: ExperimentConfig) -> TrialResult:
    """Judge one ball by its log.

    Raises:
        BusError: The log holds no trial.
    """
    events = log.messages[channels.TRIAL]
    if not events:
        raise BusError(f"{log.path} holds no trial event; was it recorded by imolo?")
    plan = last_plan(log)
    # A ball that flies against the resting robot was not hit by it.
    hit = plan is not None and any(
        event.event == EventName.HIT and event.utime >= plan.plan_onset_utime for event in events
    )
    outcome = "hit" if hit else "missed" if plan is not None else "no motion found"
    updates = sum(message.state == plan_t.UPDATED for message in log.messages[channels.PLAN])
    end_names = (EventName.HIT, EventName.BALL_LANDED)
    end = next((event.utime for event in events if event.event in end_names), None)
    return TrialResult(
        trial=events[0].trial,
        hit=hit,
        outcome=outcome,
        theta=None if plan is None else (plan.theta[0], plan.theta[1]),
        updates=updates,
        hand_error=None if plan is None else _hand_error(log, plan, config.robot.hand_marker),
        prediction_error={} if end is None else _prediction_errors(log, end),
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
    )


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


def _hand_error(log: Log, plan: plan_t, hand_marker: int) -> float | None:
    hand = hand_at(log, hand_marker, plan.hit_utime * 1e-6)
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
