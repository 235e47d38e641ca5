"""Searches by squares, over recordings whose errors are a known function of the settings."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from recorded_motions import robot

from imolo.config.experiment import ExperimentConfig, ParallelConfig
from imolo.errors import DivergenceError
from imolo.identification.evaluation import Bench
from imolo.identification.experiment import Errors, Experiment, Quantity
from imolo.identification.parameters import Parameter
from imolo.identification.solve import explore, interval, judged, solve

FRICTION = Parameter("simulation.contact.friction", 0.1, 1.5, "linear", 0.8)
LENGTH = Parameter("simulation.actuators.tube_length", 0.15, 1.5, "log", 0.5)
RADIUS = Parameter("simulation.ball.radius", 0.01, 0.1, "linear", 0.045)
TRUTH = (0.5, 0.7)


@dataclass
class Curve:
    """Errors of a curve that bends with both settings; it fails above a friction."""

    name: str
    noise: float = 0.0
    fails_above: float = np.inf

    def play(self, config: ExperimentConfig) -> Errors:
        friction = config.simulation.contact.friction
        length = getattr(config.simulation.actuators, "tube_length", TRUTH[1])
        if friction > self.fails_above:
            raise DivergenceError("the engine fell over")
        time = np.linspace(0.0, 1.0, 30)
        chance = np.random.default_rng(int(self.name))
        # One disturbance for all of a recording, as of a tank that was filled more.
        values = [m * (1.0 + chance.normal(0.0, self.noise)) * time**2 + np.exp(-time / n) for m, n in (TRUTH,)]
        return {"position": (friction * time**2 + np.exp(-time / length) - values[0])[:, None]}


def bench(folder: Path, make: Callable[[int], Curve], count: int = 6) -> Bench:
    recordings = [make(index) for index in range(count)]
    quantity = Quantity("position", "mm", 1e3, 0.01)
    experiment = Experiment(recordings, (quantity,), (), {"mujoco": robot()}, "squared", repr(recordings))
    return Bench(experiment, folder, 1, ParallelConfig(), lambda *_: None)


def test_the_best_settings_are_found_in_few_plays(tmp_path: Path) -> None:
    table = bench(tmp_path, lambda index: Curve(str(index)))
    fit = solve(table, "mujoco", [FRICTION, LENGTH], range(6), 100, 1, "fitting")
    assert [fit.settings[one.path] for one in (FRICTION, LENGTH)] == pytest.approx(TRUTH, rel=1e-3)
    assert fit.evaluations < 60


def test_a_setting_that_does_nothing_stays_and_is_flagged(tmp_path: Path) -> None:
    table = bench(tmp_path, lambda index: Curve(str(index), noise=0.02))
    both = [FRICTION, LENGTH, RADIUS]
    fit = solve(table, "mujoco", both, range(6), 100, 1, "fitting")
    assert fit.settings[RADIUS.path] == pytest.approx(RADIUS.start, abs=1e-9)
    local = explore(table, "mujoco", both, fit.settings, range(6), "slopes")
    assert "not identified" in judged(fit, both, local, None, 6).flags[RADIUS.path]


def test_a_bound_in_the_way_holds_one_setting_and_not_the_other(tmp_path: Path) -> None:
    table = bench(tmp_path, lambda index: Curve(str(index)))
    bounded = Parameter(FRICTION.path, 0.55, 1.5, "linear", 0.8)
    fit = solve(table, "mujoco", [bounded, LENGTH], range(6), 100, 1, "fitting")
    assert fit.settings[bounded.path] == pytest.approx(0.55)
    assert fit.settings[LENGTH.path] != pytest.approx(LENGTH.start, rel=0.05)


def test_a_prior_counts_as_one_more_residual(tmp_path: Path) -> None:
    sd = 1e-4
    sure = Parameter(FRICTION.path, 0.1, 1.5, "linear", 0.8, prior=(0.6, sd))
    fit = solve(bench(tmp_path, lambda index: Curve(str(index))), "mujoco", [sure, LENGTH], range(6), 100, 1, "fitting")
    # So sure that six recordings whose errors count one at .01 hardly move it.
    assert fit.settings[sure.path] == pytest.approx(0.6, abs=10 * sd)


def test_a_recording_that_cannot_be_played_on_the_way_does_not_end_the_search(tmp_path: Path) -> None:
    table = bench(tmp_path, lambda index: Curve(str(index), fails_above=0.82 if index == 0 else np.inf))
    fit = solve(table, "mujoco", [FRICTION, LENGTH], range(6), 100, 1, "fitting")
    assert [fit.settings[one.path] for one in (FRICTION, LENGTH)] == pytest.approx(TRUTH, rel=1e-2)


def disturbed(seed: int, index: int) -> Curve:
    return Curve(str(100 * seed + index), noise=0.1)


def test_ninety_per_cent_intervals_cover_what_differs_from_recording_to_recording(tmp_path: Path) -> None:
    covered, both = 0, [FRICTION, LENGTH]
    for seed in range(10):
        table = bench(tmp_path / str(seed), partial(disturbed, seed), 12)
        fit = solve(table, "mujoco", both, range(12), 60, 1, "fitting")
        local = explore(table, "mujoco", both, fit.settings, range(12), "slopes")
        low, high = interval(FRICTION, judged(fit, both, local, None, 12))
        covered += low < TRUTH[0] < high
    # Binomial with 90 % of 10: 9 ± .95.
    assert covered >= 9 - 3 * 0.95
