"""Does nonlinear interpolation help? The paper's simulation experiment (Sec. VI, Fig. 7), free of any backend.

One repetition: a query (p_q, t_q) is taken from a random motion while it swings its arm; N_t other random motions are
the training trials; a table without voxels answers the query with a theta; and d_p is the distance between p_q and the
hand of that motion at t_q. The tables differ in their tuples (s, t, theta): those of the trials alone ("without"), or
those that a forward model learned from them predicts over the grid.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from scipy.stats import ttest_rel

from imolo.campaigns.motion_recorder import Recording, Window
from imolo.method.forward_model import GPR, PAPER_SVR, ForwardModel, ForwardModelConfig
from imolo.method.motion import MotionTemplate, Theta
from imolo.method.table_grid import TableGrid
from imolo.trials.metrics import Statistic

Array = NDArray[np.float64]

WITHOUT = "without"
MODELS: Mapping[str, ForwardModelConfig] = {"paper": PAPER_SVR, "improved": GPR}
VARIANTS = (WITHOUT, *MODELS)
# These predict, but choose no motions: they show what raw inputs and a small C cost the paper's regression.
STANDARDIZED, LOOSE = "paper, standardized inputs", "paper, C = 10"
RATED: Mapping[str, ForwardModelConfig] = {
    **MODELS,
    STANDARDIZED: PAPER_SVR.model_copy(update={"inputs": "standardized"}),
    LOOSE: PAPER_SVR.model_copy(update={"parameters": {**PAPER_SVR.parameters, "C": 10.0}}),
}


@dataclass(frozen=True, eq=False)
class Problem:
    """What one repetition asks.

    Attributes:
        trials: N_t.
        repetition: Counted from 0.
        position: p_q [m], shape (3,).
        time: t_q since the onset [s].
        training: Indices of the training trials among the pool.
    """

    trials: int
    repetition: int
    position: Array
    time: float
    training: tuple[int, ...]


@dataclass(frozen=True)
class Choice:
    """The answer of a table.

    Attributes:
        theta: Of the motion to execute.
        distance: Between p_q and the tuple that was chosen [m].
        in_time: Whether a tuple lay within half a time step of t_q; else the nearest in time was taken.
    """

    theta: Theta
    distance: float
    in_time: bool


@dataclass(frozen=True)
class Answer:
    """What the tables say to one problem.

    Attributes:
        choices: By variant.
        model_errors: Mean distance between predicted and recorded hand over motions not trained on, by model [m].
    """

    choices: dict[str, Choice]
    model_errors: dict[str, float]


class Bar(BaseModel):
    """One bar of Fig. 7.

    Attributes:
        trials: N_t.
        variant: "without", or the model that interpolates.
        error: d_p over the repetitions [m].
        errors: d_p of each repetition [m].
        out_of_time: In how many repetitions no tuple lay within half a time step of t_q.
        table_distance: Between p_q and the chosen tuple [m]: what the table is too sparse for.
    """

    model_config = ConfigDict(frozen=True)

    trials: int
    variant: str
    error: Statistic
    errors: tuple[float, ...]
    out_of_time: int
    table_distance: Statistic


class PairedTest(BaseModel):
    """With against without interpolation, on the same queries and trials.

    Attributes:
        trials: N_t.
        variant: The model that interpolates.
        difference: Mean of d_p with minus d_p without [m]; negative where interpolation helps.
        t: Statistic of the paired t-test; None where the differences do not vary.
        p: Its two-sided p value.
    """

    model_config = ConfigDict(frozen=True)

    trials: int
    variant: str
    difference: float
    t: float | None
    p: float | None


class ModelError(BaseModel):
    """How far a forward model is off on motions it was not trained on.

    Attributes:
        trials: N_t.
        model: Its name.
        error: Mean distance over the held-out motions, by repetition [m].
    """

    model_config = ConfigDict(frozen=True)

    trials: int
    model: str
    error: Statistic


class Interpolation(BaseModel):
    """Fig. 7 for one backend."""

    model_config = ConfigDict(frozen=True)

    bars: tuple[Bar, ...]
    tests: tuple[PairedTest, ...]
    models: tuple[ModelError, ...]

    @property
    def numbers_of_trials(self) -> tuple[int, ...]:
        """The values of N_t, in order."""
        return tuple(dict.fromkeys(bar.trials for bar in self.bars))

    def bar(self, trials: int, variant: str) -> Bar:
        """Return one bar."""
        return next(bar for bar in self.bars if (bar.trials, bar.variant) == (trials, variant))

    def test(self, trials: int, variant: str) -> PairedTest:
        """Return one test."""
        return next(test for test in self.tests if (test.trials, test.variant) == (trials, variant))

    def model_error(self, trials: int, model: str) -> Statistic:
        """Return how far a model is off."""
        return next(one.error for one in self.models if (one.trials, one.model) == (trials, model))


def draw_theta(motion: MotionTemplate, grid: TableGrid, count: int, rng: np.random.Generator) -> list[Theta]:
    """Draw motions, uniform over the grid's range, to whole microseconds of times."""
    columns = [rng.uniform(low, high, count) for low, high in zip(*grid.bounds(motion), strict=True)]
    return [motion.rounded(theta) for theta in np.column_stack(columns).tolist()]


def draw_problem(
    pool: Sequence[Recording], motion: MotionTemplate, window: Window, trials: int, repetition: int, seed: int
) -> Problem:
    """Draw the query and the training trials of one repetition; all are different motions of the pool."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, trials, repetition]))
    query, *training = rng.choice(len(pool), trials + 1, replace=False).tolist()
    time = motion.swing_of(pool[query].theta) + float(rng.uniform(window.start, window.stop))
    return Problem(trials, repetition, pool[query].hand(time), time, tuple(training))


def nearest_tuple(theta: Array, times: Array, positions: Array, problem: Problem, time_tolerance: float) -> Choice:
    """Choose the tuple nearest to p_q among those within half a time step of t_q (Sec. IV-A without voxels).

    Where there is none, the choice is among the tuples nearest to t_q.

    Args:
        theta: Motion parameters, shape (N, n).
        times: Since the onset [s], shape (N,).
        positions: [m], shape (N, 3).
        problem: The query.
        time_tolerance: Δt [s].
    """
    apart = np.abs(times - problem.time)
    near = apart < 0.5 * time_tolerance
    in_time = bool(near.any())
    if not in_time:
        near = apart <= apart.min() + 1e-9
    distance = np.where(near, np.linalg.norm(positions - problem.position, axis=1), np.inf)
    best = int(distance.argmin())
    return Choice(tuple(theta[best].tolist()), float(distance[best]), in_time)


def answer(
    problem: Problem, pool: Sequence[Recording], motion: MotionTemplate, window: Window, grid: TableGrid
) -> Answer:
    """Build the tables of one repetition and ask them.

    Of the predicted tuples only those near t_q are computed, which are the only ones that can be chosen.
    """
    data = window.samples([pool[index] for index in problem.training], motion)
    tolerance = grid.time_tolerance
    theta, time = _predictions_near(problem.time, motion, grid)
    left = [recording for index, recording in enumerate(pool) if index not in problem.training]
    held_out = window.samples(left, motion)
    choices = {WITHOUT: nearest_tuple(data.theta, data.time, data.position, problem, tolerance)}
    errors = {}
    for name, config in RATED.items():
        model = ForwardModel(config, motion).fit(data.theta, data.time, data.position)
        off = model.predict(held_out.theta, held_out.time) - held_out.position
        errors[name] = float(np.linalg.norm(off, axis=1).mean())
        if name in MODELS:
            choices[name] = nearest_tuple(theta, time, model.predict(theta, time), problem, tolerance)
    return Answer(choices, errors)


def judge(
    problems: Sequence[Problem], answers: Sequence[Answer], hand: Callable[[Theta, float], Array]
) -> Interpolation:
    """Execute what was chosen and test with against without.

    Args:
        problems: Of all repetitions.
        answers: To each of them.
        hand: Where the hand is when theta is executed, t [s] after the onset [m], shape (3,).
    """
    bars, tests, models = [], [], []
    for trials in dict.fromkeys(problem.trials for problem in problems):
        group = [(p, a) for p, a in zip(problems, answers, strict=True) if p.trials == trials]
        for variant in VARIANTS:
            choices = [a.choices[variant] for _, a in group]
            errors = tuple(
                float(np.linalg.norm(p.position - hand(choice.theta, p.time)))
                for (p, _), choice in zip(group, choices, strict=True)
            )
            bars.append(
                Bar(
                    trials=trials,
                    variant=variant,
                    error=Statistic.of(errors),
                    errors=errors,
                    out_of_time=sum(not choice.in_time for choice in choices),
                    table_distance=Statistic.of([choice.distance for choice in choices]),
                )
            )
        without = bars[-len(VARIANTS)]
        tests += [_paired(bar, without) for bar in bars[-len(MODELS) :]]
        for name in RATED:
            statistic = Statistic.of([a.model_errors[name] for _, a in group])
            models.append(ModelError(trials=trials, model=name, error=statistic))
    return Interpolation(bars=tuple(bars), tests=tuple(tests), models=tuple(models))


def _paired(bar: Bar, without: Bar) -> PairedTest:
    difference = np.array(bar.errors) - np.array(without.errors)
    told = len(difference) > 1 and np.ptp(difference) > 0.0
    found: Any = ttest_rel(bar.errors, without.errors) if told else None
    return PairedTest(
        trials=bar.trials,
        variant=bar.variant,
        difference=float(difference.mean()),
        t=None if found is None else float(found.statistic),
        p=None if found is None else float(found.pvalue),
    )


def _predictions_near(time: float, motion: MotionTemplate, grid: TableGrid) -> tuple[Array, Array]:
    """Return those tuples of the grid that are within half a time step of a time, or the nearest if none is."""
    theta, predicted = grid.predictions(motion)
    apart = np.abs(predicted - time)
    near = apart < 0.5 * grid.time_tolerance
    if not near.any():
        near = apart <= apart.min() + 1e-9
    return theta[near], predicted[near]
