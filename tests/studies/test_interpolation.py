"""Fig. 7 on hands whose truth is a formula, and a small run of the whole on an engine."""

from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from liberobot import GRID, MOTION
from played_trials import config
from scipy.stats import t as student
from scipy.stats import ttest_rel

from imolo.campaigns.motion_recorder import Recording, Window, record_motions, without_chance
from imolo.campaigns.results import ResultsFolder
from imolo.campaigns.summary import millimetres
from imolo.errors import ConfigError
from imolo.method.forward_model import GPR, ForwardModel
from imolo.method.motion import Theta
from imolo.report.sections import interpolation_tables
from imolo.studies.interpolation import (
    RATED,
    VARIANTS,
    WITHOUT,
    Answer,
    Choice,
    PairedTest,
    Problem,
    answer,
    draw_problem,
    draw_theta,
    judge,
    nearest_tuple,
)
from imolo.studies.interpolation_report import draw_study, findings, parse_trials
from imolo.studies.interpolation_study import InterpolationStudy, study

WINDOW = Window(0.13, 0.22)
FRAMES = np.arange(0.0, 0.7, 1 / 120)


def smooth(theta: Theta, time: float) -> np.ndarray:
    """Return a hand that k moves sideways, t_w forward and the swing up [m]; quadratic, so easily learned."""
    k, t_w = theta
    since = time - t_w
    return np.array([0.5 + 2.0 * t_w + since, -0.2 + 0.3 * k, 1.0 + 5.0 * since - 0.1 * k**2])


def pool_of(count: int, seed: int = 0) -> list[Recording]:
    motions = draw_theta(MOTION, GRID, count, np.random.default_rng(seed))
    return [Recording(theta, FRAMES, np.array([smooth(theta, time) for time in FRAMES])) for theta in motions]


POOL = pool_of(40)


def test_draw_depends_on_seed_trials_and_repetition_alone() -> None:
    first = draw_problem(POOL, MOTION, WINDOW, 8, 3, 1)
    again = draw_problem(POOL, MOTION, WINDOW, 8, 3, 1)
    assert (first.training, first.time, first.position.tolist()) == (
        again.training,
        again.time,
        again.position.tolist(),
    )
    others = [draw_problem(POOL, MOTION, WINDOW, *which) for which in ((8, 4, 1), (8, 3, 2), (16, 3, 1))]
    assert all(other.time != first.time for other in others)


def test_query_is_on_a_motion_that_is_not_trained_on_and_in_its_swing() -> None:
    for repetition in range(50):
        problem = draw_problem(POOL, MOTION, WINDOW, 16, repetition, 1)
        distance = [np.linalg.norm(r.hand(problem.time) - problem.position) for r in POOL]
        query = int(np.argmin(distance))
        assert query not in problem.training
        assert len(set(problem.training)) == 16
        assert 0.13 < problem.time - POOL[query].theta[1] < 0.22


def test_window_keeps_the_frames_of_the_swing() -> None:
    data = WINDOW.samples(POOL[:3], MOTION)
    since = data.time - data.theta[:, 1]
    # 0.09 s at 120 Hz hold 10 or 11 frames.
    assert 30 <= len(since) <= 33
    assert ((since > 0.13) & (since < 0.22)).all()


def query(time: float, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Problem:
    return Problem(1, 0, np.array(position), time, (0,))


def test_nearest_tuple_in_space_is_chosen_among_those_in_time() -> None:
    theta = np.array([[0.1, 0.3], [0.2, 0.3], [0.3, 0.3]])
    positions = np.array([[0.1, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.0, 0.0]])
    choice = nearest_tuple(theta, np.array([0.498, 0.501, 0.506]), positions, query(0.5), 0.0083)
    assert choice == Choice((0.1, 0.3), 0.1, in_time=True)


def test_tuple_nearest_in_time_is_chosen_where_none_is_in_time() -> None:
    theta = np.array([[0.1, 0.3], [0.2, 0.3]])
    choice = nearest_tuple(theta, np.array([0.45, 0.46]), np.array([[0.0] * 3, [1.0, 0.0, 0.0]]), query(0.5), 0.0083)
    assert choice == Choice((0.2, 0.3), 1.0, in_time=False)


def test_predicting_only_near_the_query_changes_no_choice() -> None:
    problem = draw_problem(POOL, MOTION, WINDOW, 8, 0, 1)
    data = WINDOW.samples([POOL[index] for index in problem.training], MOTION)
    model = ForwardModel(GPR, MOTION).fit(data.theta, data.time, data.position)
    theta, time = GRID.predictions(MOTION)
    whole = nearest_tuple(theta, time, model.predict(theta, time), problem, GRID.time_tolerance)
    chosen = answer(problem, POOL, MOTION, WINDOW, GRID).choices["improved"]
    assert chosen.theta == whole.theta
    # Kernels are rounded in another way among fewer points, and the large weights of a smooth process magnify that; its
    # standardised outputs have a scale below 1 m.
    assert model._kernel_sum is not None
    rounding = np.finfo(float).eps * np.abs(model._kernel_sum.weight).sum()
    assert chosen.distance == pytest.approx(whole.distance, abs=rounding)


def test_raw_table_chooses_a_motion_that_was_trained() -> None:
    problem = draw_problem(POOL, MOTION, WINDOW, 8, 1, 1)
    assert answer(problem, POOL, MOTION, WINDOW, GRID).choices[WITHOUT].theta in [
        POOL[i].theta for i in problem.training
    ]


def test_interpolation_helps_where_the_hand_is_smooth() -> None:
    problems = [draw_problem(POOL, MOTION, WINDOW, 8, repetition, 1) for repetition in range(8)]
    result = judge(problems, [answer(problem, POOL, MOTION, WINDOW, GRID) for problem in problems], smooth)
    found = result.test(8, "improved")
    assert found.p is not None
    assert found.p < 0.01
    assert found.difference < 0.0
    error = result.bar(8, "improved").error.mean
    # A choice off by half a step of the grid, Δt/2 of a hand at 5 m/s, is 21 mm off.
    assert error is not None
    assert error < 0.03
    learned = result.model_error(8, "improved").mean
    assert learned is not None
    assert learned < 0.01


def judged(without: list[float], with_: list[float]) -> PairedTest:
    """Judge choices whose hands are the given distances from the query."""
    problems = [query(0.5) for _ in without]
    answers = []
    for a, b in zip(without, with_, strict=True):
        choices = {name: Choice((a if name == WITHOUT else b, 0.3), 0.0, in_time=True) for name in VARIANTS}
        answers.append(Answer(choices, dict.fromkeys(RATED, 0.0)))
    return judge(problems, answers, lambda theta, _: np.array([theta[0], 0.0, 0.0])).test(1, "paper")


def test_paired_t_test_is_that_of_the_textbook_and_of_scipy() -> None:
    without, with_ = [0.10, 0.20, 0.15, 0.30], [0.05, 0.18, 0.16, 0.20]
    found = judged(without, with_)
    difference = np.array(with_) - np.array(without)
    t = difference.mean() / (difference.std(ddof=1) / sqrt(len(difference)))
    assert found.t == pytest.approx(t, rel=1e-12)
    assert found.p == pytest.approx(2.0 * student.sf(abs(t), len(difference) - 1), rel=1e-12)
    assert (found.t, found.p) == pytest.approx(tuple(ttest_rel(with_, without)), rel=1e-12)
    assert found.difference == pytest.approx(-0.04)


def test_no_test_is_told_where_nothing_differs() -> None:
    found = judged([0.1, 0.2], [0.1, 0.2])
    assert (found.t, found.p, found.difference) == (None, None, 0.0)


@pytest.mark.parametrize("text", ["", "8,x", "0", "-8", "8.5"])
def test_numbers_of_trials_are_checked(text: str) -> None:
    with pytest.raises(ConfigError, match="trials"):
        parse_trials(text)


def test_numbers_of_trials_are_sorted() -> None:
    assert parse_trials(" 16, 8,16 ,") == (8, 16)


# On an engine.


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[InterpolationStudy, Path]:
    folder = tmp_path_factory.mktemp("interpolation")
    return study([config("mujoco")], (3, 8), 2, 10, ResultsFolder(folder), jobs=1), folder


def test_study_is_written_as_it_is_returned(small: tuple[InterpolationStudy, Path]) -> None:
    result, folder = small
    assert InterpolationStudy.model_validate_json((folder / "interpolation.json").read_text()) == result
    bars = result.results["mujoco"].bars
    assert [(bar.trials, bar.variant) for bar in bars] == [(n, variant) for n in (3, 8) for variant in VARIANTS]
    assert all(0.0 < error < 2.0 for bar in bars for error in bar.errors)


def test_findings_name_the_paper_and_the_reason(small: tuple[InterpolationStudy, Path]) -> None:
    texts = [text for _, text in findings(small[0])]
    assert any(text.startswith("N_t = 8") and "paper" in text for text in texts)
    assert any(text.startswith("why") for text in texts)
    assert not any(text.startswith("N_t = 3") for text in texts)


def test_report_shows_the_same_rows_as_the_terminal(small: tuple[InterpolationStudy, Path]) -> None:
    result, folder = small
    section = interpolation_tables(folder / "interpolation.json")
    bars, models = section["grids"]
    assert [row[:2] for row in bars.rows] == [row[:2] for row in models.rows] == [("mujoco", "3"), ("mujoco", "8")]
    assert all(len(row) == len(grid.columns) for grid in (bars, models) for row in grid.rows)
    first = result.results["mujoco"].bar(3, VARIANTS[0]).error
    assert bars.rows[0][2] == millimetres(first)
    assert all(text in section["note"] for _, text in findings(result))


def test_figure_has_a_panel_for_every_backend(small: tuple[InterpolationStudy, Path]) -> None:
    figure = draw_study(small[0])
    assert [axes.get_title() for axes in figure.axes] == ["mujoco"]
    assert len(figure.axes[0].patches) == 2 * len(VARIANTS)


def test_motion_executed_again_is_the_recorded_one(tmp_path: Path) -> None:
    """What lets the raw table's choices go without a second execution, and without pressures in the log."""
    theta = (0.4, 0.25)
    told = without_chance(config("mujoco"))
    more = told.model_copy(
        update={"simulation": told.simulation.model_copy(update={"sensor_rate": 1000.0, "truth_rate": 240.0})}
    )
    hands = []
    for number, (chosen, end) in enumerate(((told, 0.47), (told, 0.40), (more, 0.47))):
        recording = record_motions(chosen, [(theta, end)], tmp_path / str(number), 1)[0]
        hands.append(recording.position[recording.time < 0.40])
    assert np.array_equal(hands[0], hands[1])
    assert np.array_equal(hands[0], hands[2])


def test_pool_must_hold_the_trials_and_a_query(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--pool 25"):
        study([config("mujoco")], (8, 24), 2, 24, ResultsFolder(tmp_path), jobs=1)
