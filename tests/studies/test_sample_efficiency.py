"""The count of trials, on hands whose truth is a formula, and a small run of the whole on engines."""

from pathlib import Path

import numpy as np
import pytest
from liberobot import GRID, MOTION
from played_trials import config

from imolo.campaigns.motion_recorder import Recording, Window
from imolo.campaigns.results import ResultsFolder
from imolo.errors import ConfigError
from imolo.method.active import least_certain
from imolo.method.forward_model import PAPER_SVR, ForwardModel
from imolo.method.motion import Theta
from imolo.report.sections import trials_tables
from imolo.studies.interpolation import draw_theta
from imolo.studies.sample_efficiency import (
    ACTIVE,
    CONFIGURED,
    MODEL,
    PAPER,
    PLAIN,
    START,
    UNDISTURBED,
    Floor,
    Point,
    SampleEfficiency,
    Sizes,
    active_trials,
    choose_motions,
    fit,
    rate,
    repeatability,
    study,
    upon,
)
from imolo.studies.sample_efficiency_report import draw_study, point_text
from imolo.trials.metrics import Statistic

WINDOW = Window(0.13, 0.22)
FRAMES = np.arange(0.0, 0.7, 1 / 120)
SIZES = Sizes(dense=8, candidates=6, tests=4)


def recorded(theta: Theta, offset: float = 0.0) -> Recording:
    """Return a smooth hand, off by so much along x [m]."""
    k, t_w = theta
    since = FRAMES - t_w
    sideways = np.full(len(since), 0.3 * k + 0.1 * k**3)
    hand = np.column_stack((t_w + since + offset, sideways, 1.0 + 3.0 * since))
    return Recording(theta, FRAMES, hand)


def all_at(k: list[float]) -> list[Recording]:
    return [recorded((value, 0.3 + 0.01 * number)) for number, value in enumerate(k)]


@pytest.fixture(scope="module")
def known_on_one_side() -> ForwardModel:
    return fit(ForwardModel(MODEL, MOTION), all_at([-1.0, -0.8, -0.6, -0.4, -0.2]), WINDOW)


def test_motion_farthest_from_what_was_tried_is_chosen(known_on_one_side: ForwardModel) -> None:
    motions = np.array([[-0.9, 0.32], [-0.5, 0.32], [1.0, 0.32], [0.1, 0.32]])
    assert least_certain(known_on_one_side, motions, (0.14, 0.2)) == 2


def test_active_choice_goes_where_nothing_was_tried_and_tries_nothing_twice() -> None:
    candidates = all_at([-0.9, -0.5, 0.0, 0.5, 1.0])
    start = all_at([-1.0, -0.8, -0.6, -0.4, -0.2])
    done = [trials for trials, _ in active_trials(ForwardModel(MODEL, MOTION), start, candidates, WINDOW, searched=())]
    assert [len(trials) for trials in done] == [5, 6, 7, 8, 9, 10]
    assert done[1][-1].theta[0] == 1.0
    assert sorted(recording.theta for recording in done[-1]) == sorted(r.theta for r in (*start, *candidates))


def test_choice_does_not_look_at_where_the_hand_went() -> None:
    start, order = all_at([-1.0, -0.6, -0.2]), []
    for offset in (0.0, 5.0):
        candidates = [recorded(r.theta, offset) for r in all_at([-0.9, 0.0, 1.0])]
        steps = active_trials(ForwardModel(MODEL, MOTION), start, candidates, WINDOW, searched=())
        next(steps)
        order.append(next(steps)[0][-1].theta)
    assert order[0] == order[1]


def test_repeatability_is_the_distance_to_the_true_mean() -> None:
    rng = np.random.default_rng(0)
    motions = [(k, 0.3) for k in np.linspace(-1.0, 1.0, 200)]
    repeated = [recorded(theta, offset) for theta in motions for offset in rng.normal(0.0, 0.01, 4)]
    # Along one axis the mean distance of a normal distribution is 0.798 of its standard deviation.
    assert repeatability(repeated, MOTION, WINDOW).mean == pytest.approx(0.00798, rel=0.1)


def test_error_is_the_mean_distance_of_motions() -> None:
    motions = draw_theta(MOTION, GRID, 22, np.random.default_rng(0))
    model = fit(ForwardModel(MODEL, MOTION), [recorded(theta) for theta in motions[2:]], WINDOW)
    exact, _ = rate(model, [recorded(theta) for theta in motions[:2]], WINDOW)
    off, nees = rate(model, [recorded(theta, 0.2) for theta in motions[:2]], WINDOW)
    assert exact.mean is not None
    assert exact.mean < 0.02
    assert off.mean == pytest.approx(0.2, abs=exact.mean)
    assert nees is not None
    assert nees > 10.0


def test_model_without_variance_is_not_judged_by_it() -> None:
    model = fit(ForwardModel(PAPER_SVR, MOTION), all_at([-1.0, 0.0, 1.0]), WINDOW)
    assert rate(model, all_at([0.5]), WINDOW)[1] is None


def test_first_trials_are_those_of_the_config_and_no_test_motion_is_tried() -> None:
    chosen = config("mujoco")
    motions = choose_motions(chosen, 20, SIZES)
    assert tuple(motions.trials[:15]) == chosen.training.motions
    assert (len(motions.trials), len(motions.dense), len(motions.candidates), len(motions.tests)) == (20, 8, 6, 4)
    assert not set(motions.tests) & {*motions.trials, *motions.candidates, *motions.dense}


@pytest.mark.parametrize(
    ("trials", "sizes", "text"),
    [((4, 8), SIZES, "give 5 or more"), ((5, 12), SIZES, "6 candidates cannot serve 12 trials; give 7 or more")],
)
def test_numbers_that_cannot_be_served_are_refused(
    trials: tuple[int, ...], sizes: Sizes, text: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=text):
        study([config("mujoco")], trials, sizes, ResultsFolder(tmp_path), jobs=1)


def made_up() -> SampleEfficiency:
    names = ("alpha", "beta")
    points = [
        Point(backend=b, setting=s, model=m, prior=None, trials=n, error=Statistic.of([0.1 / n]), nees=None)
        for b, other in (names, names[::-1])
        for s in (UNDISTURBED, CONFIGURED)
        for m in (PAPER, PLAIN, ACTIVE, upon(other), upon(other, active=True))
        for n in (5, 10)
    ]
    floors = tuple(Floor(backend=name, error=Statistic.of([0.002])) for name in names)
    return SampleEfficiency(
        seed=1,
        sizes=SIZES,
        versions={},
        configs=dict.fromkeys(names, "0"),
        points=tuple(points),
        floors=floors,
    )


def test_report_holds_every_model_of_every_backend(tmp_path: Path) -> None:
    path = tmp_path / "trials.json"
    path.write_text(made_up().model_dump_json())
    grids = trials_tables(path)["grids"]
    assert [grid.caption for grid in grids] == [UNDISTURBED, CONFIGURED]
    assert grids[0].columns == ("backend", "model", "5", "10")
    assert ("alpha", "upon beta, active", "20.0", "10.0") in grids[1].rows
    assert ("alpha", "floor", "0.0", "") in grids[0].rows
    assert ("beta", "floor", "2.0", "") in grids[1].rows
    assert len(grids[0].rows) == 12


def test_figure_has_a_panel_for_every_backend_and_setting() -> None:
    figure = draw_study(made_up())
    assert [axes.get_title() for axes in figure.axes] == ["trials in alpha", "trials in beta", "", ""]


def test_missing_point_is_left_empty() -> None:
    assert point_text(None) == ""


@pytest.mark.slow
def test_study_on_engines_repeats_and_is_written_as_it_is_returned(tmp_path: Path) -> None:
    results = [
        study([config("mujoco"), config("pybullet")], (5, 8), SIZES, ResultsFolder(tmp_path / str(jobs)), jobs)
        for jobs in (1, 2)
    ]
    assert results[0] == results[1]
    assert SampleEfficiency.model_validate_json((tmp_path / "1" / "trials.json").read_text()) == results[0]
    assert [p.trials for p in results[0].curve("mujoco", CONFIGURED, upon("pybullet"))] == [0, 5, 8]
    assert [p.trials for p in results[0].curve("mujoco", UNDISTURBED, ACTIVE)] == [5, 8]
    assert START == 5
    floor = results[0].floor("mujoco", CONFIGURED)
    assert floor is not None
    assert 0.0 < floor < 0.05
