"""Searches over recordings whose errors are a known function: what is found, flagged, kept and survived."""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from made_up_tosses import Parabola, cube_config

from imolo.config.experiment import ParallelConfig
from imolo.errors import BackendError, DivergenceError, IdentificationError
from imolo.identification.evaluation import FAILED, Bench
from imolo.identification.experiment import Experiment, Quantity, Recording
from imolo.identification.parameters import Parameter
from imolo.identification.solve import FINE_ENOUGH, explore, interval, judged, solve

FRICTION = Parameter("simulation.contact.friction", 0.05, 1.5, "log", 0.8)
RESTITUTION = Parameter("simulation.contact.restitution", 0.0, 1.0, "linear", 0.3)  # of a ball that is not there
QUANTITIES = (Quantity("position", "mm", 1e3, 1.0), Quantity("rotation", "deg", 57.3, 1.0))


def bench(folder: Path, recordings: Sequence[Recording], scale: float = 1.0) -> Bench:
    quantities = (Quantity("position", "mm", 1e3, scale), *QUANTITIES[1:])
    experiment = Experiment(recordings, quantities, (), {"mujoco": cube_config()})
    return Bench(experiment, folder, 1, ParallelConfig(), lambda *_: None)


def spread_truths(number: int = 20, around: float = 0.2, sd: float = 0.1) -> list[Parabola]:
    chance = np.random.default_rng(1)
    return [Parabola(str(i), around * float(np.exp(chance.normal(0.0, sd)))) for i in range(number)]


@pytest.mark.parametrize("others", [(), (RESTITUTION,)])
def test_the_best_value_is_found(tmp_path: Path, others: tuple[Parameter, ...]) -> None:
    recordings = [Parabola(str(i), 0.2) for i in range(4)]
    fit = solve(bench(tmp_path, recordings), "mujoco", [FRICTION, *others], range(4), 120, 1, "fitting")
    assert FRICTION.to_unit(fit.settings[FRICTION.path]) == pytest.approx(FRICTION.to_unit(0.2), abs=FINE_ENOUGH)


def test_the_interval_is_that_of_a_mean_over_recordings(tmp_path: Path) -> None:
    covered = 0
    for seed in range(20):
        chance = np.random.default_rng(seed)
        recordings = [Parabola(str(i), 0.2 * float(np.exp(chance.normal(0.0, 0.3)))) for i in range(30)]
        table = bench(tmp_path / str(seed), recordings)
        fit = solve(table, "mujoco", [FRICTION], range(30), 30, 1, "fitting")
        local = explore(table, "mujoco", [FRICTION], fit.settings, range(30), "slopes")
        low, high = interval(FRICTION, judged(fit, [FRICTION], local, None, 30))
        covered += low < 0.2 < high
    # Binomial with 90 % of 20: 18 ± 1.3.
    assert covered >= 18 - 3 * 1.3


def flags(table: Bench, parameters: list[Parameter], number: int) -> dict[str, tuple[str, ...]]:
    fit = solve(table, "mujoco", parameters, range(number), 60, 1, "fitting")
    local = explore(table, "mujoco", parameters, fit.settings, range(number), "slopes")
    return dict(judged(fit, parameters, local, local, number).flags)


def test_a_value_at_its_bound_is_flagged(tmp_path: Path) -> None:
    bounded = Parameter(FRICTION.path, 0.3, 1.5, "log", 0.8)
    assert flags(bench(tmp_path, spread_truths()), [bounded], 20) == {FRICTION.path: ("at its bound",)}


def test_a_value_that_does_nothing_is_flagged(tmp_path: Path) -> None:
    found = flags(bench(tmp_path, spread_truths()), [FRICTION, RESTITUTION], 20)
    assert found == {FRICTION.path: (), RESTITUTION.path: ("not identified",)}


def test_an_optimum_that_moves_with_the_time_step_is_flagged(tmp_path: Path) -> None:
    now, finer = bench(tmp_path / "a", spread_truths()), bench(tmp_path / "b", spread_truths(around=0.3))
    fit = solve(now, "mujoco", [FRICTION], range(20), 30, 1, "fitting")
    local, halved = (explore(one, "mujoco", [FRICTION], fit.settings, range(20), "slopes") for one in (now, finer))
    assert judged(fit, [FRICTION], local, halved, 20).flags[FRICTION.path] == ("depends on the time step",)


def test_what_does_nothing_is_seen_before_the_search(tmp_path: Path) -> None:
    both = [FRICTION, RESTITUTION]
    start = {one.path: one.start for one in both}
    local = explore(bench(tmp_path, spread_truths()), "mujoco", both, start, range(20), "check", pairs=False)
    # The mean change of |log mu| over 5 % of the range, relative to a mean error of log(.8/.2) or so.
    assert local.swing[0] == pytest.approx(0.05 * np.log(1.5 / 0.05) / np.log(0.8 / 0.2), rel=0.1)
    assert local.swing[1] == 0.0


def test_parameters_with_the_same_effect_are_told_to_be_alike(tmp_path: Path) -> None:
    both = [FRICTION, Parameter("simulation.gravity", 1.0, 30.0, "log", 9.81)]
    start = {one.path: one.start for one in both}
    local = explore(bench(tmp_path, spread_truths()), "mujoco", both, start, range(20), "check", pairs=False)
    # Their ranges are equally wide on a log scale, but for 1.5 / .05 to 30.
    assert local.likeness[0, 1] == pytest.approx(1.0, abs=1e-6)
    assert "cannot be told from simulation.gravity" in flags(bench(tmp_path, spread_truths()), both, 20)[FRICTION.path]


@pytest.mark.parametrize("problem", [DivergenceError, BackendError])
def test_an_engine_that_fails_in_mid_search_costs_one_line(
    tmp_path: Path, problem: type[Exception], caplog: pytest.LogCaptureFixture
) -> None:
    recordings = [Parabola(str(i), 0.2, problem) for i in range(4)]
    table = bench(tmp_path, recordings)
    with caplog.at_level(logging.WARNING):
        fit = solve(table, "mujoco", [FRICTION, RESTITUTION], range(4), 60, 3, "fitting")
    assert table.problems["mujoco"][0] > 0
    assert [record.message for record in caplog.records] == [
        "mujoco: 0 could not be played: the engine fell over; the search goes on without"
    ]
    assert fit.settings[FRICTION.path] == pytest.approx(0.2, rel=0.05)


def test_settings_that_the_engine_refuses_are_passed_over(tmp_path: Path) -> None:
    table = bench(tmp_path, spread_truths())
    refused, good = table.play("", "mujoco", [{"backend.solref.0": -1.0}, {}], range(4))
    assert refused.mean == FAILED
    assert "solref" in refused.problem
    assert good.mean < FAILED


def test_an_engine_that_can_play_nothing_at_the_start_is_an_error(tmp_path: Path) -> None:
    start = Parameter(FRICTION.path, 0.05, 0.5, "log", 0.06)
    recordings = [Parabola(str(i), 0.2, BackendError) for i in range(4)]
    with pytest.raises(IdentificationError, match=r"any recording where the search starts: .* fell over"):
        solve(bench(tmp_path, recordings), "mujoco", [start], range(4), 30, 1, "fitting")


def test_what_was_played_is_not_played_again(tmp_path: Path) -> None:
    first, again = spread_truths(), spread_truths()
    before = bench(tmp_path, first).play("", "mujoco", [{}, {FRICTION.path: 0.5}], range(20))
    after = bench(tmp_path, again).play("", "mujoco", [{}, {FRICTION.path: 0.5}], range(20))
    assert sum(one.plays for one in first) == 40
    assert sum(one.plays for one in again) == 0
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one.loss, other.loss)
        assert (one.seconds, one.problem) == (other.seconds, other.problem)


def test_other_settings_recordings_scales_or_damaged_files_are_played(tmp_path: Path) -> None:
    def plays(settings: dict[str, float], number: int, scale: float = 1.0) -> int:
        recordings = spread_truths()
        bench(tmp_path, recordings, scale).play("", "mujoco", [settings], range(number))
        return sum(one.plays for one in recordings)

    assert plays({}, 20) == 20
    assert plays({}, 20) == 0
    assert plays({FRICTION.path: 0.5}, 20) == 20
    assert plays({}, 10) == 10
    assert plays({}, 20, scale=2.0) == 20
    for file in tmp_path.glob("*.npz"):
        file.write_bytes(file.read_bytes()[:100])
    assert plays({}, 20) == 20
