"""Why do two backends differ? One ingredient is swapped at a time, and what each explains is told in millimetres.

The yardstick is the mean distance of the hands of two backends under the same commands (`Comparison.disagreement`).
First every swap is made alone; then, from the two as they are, the swap that brings the hands closest is made and kept,
then the next one, until none is left that helps: a waterfall from the disagreement to what no swap explains. Where no
single swap helps, two at once may, since softness here can hide softness there. What both backends share, the time step
and what the robot declares, comes last, because it changes the question.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from imolo.campaigns.campaign import TrialTask, log_name, run_tasks
from imolo.campaigns.motion_recorder import NO_CHANCE
from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import backend_options, backend_plugin, merged
from imolo.contracts.registry import ROBOTS
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import ConfigError, TrainingDataError
from imolo.messaging.log import read_log
from imolo.trials.metrics import Statistic
from imolo.trials.recordings import hand_in_swing

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

LEAST_GAIN = 1e-3  # [m] a swap that brings the hands less than this closer is no explanation
Settings = Mapping[str, Any]


class Swap(BaseModel):
    """One ingredient, exchanged on one side or on both.

    Attributes:
        ingredient: What it is, for example "friction cone".
        side: Backend that is changed, or "both".
        change: The new setting, as it would be written in a config.
    """

    model_config = ConfigDict(frozen=True)

    ingredient: str
    side: str
    change: str


class SwapResult(BaseModel):
    """What became of the disagreement.

    Attributes:
        swap: What was exchanged.
        moved: How far the hand of the changed backend went by it, mean over the motions [m].
        disagreement: Distance of the hands afterwards [m].
    """

    model_config = ConfigDict(frozen=True)

    swap: Swap
    moved: float
    disagreement: Statistic

    @property
    def mean(self) -> float:
        """Mean disagreement [m]."""
        return np.inf if self.disagreement.mean is None else self.disagreement.mean


class Attribution(BaseModel):
    """The whole answer.

    Attributes:
        backends: The two.
        motions: Number of motions it is the mean of.
        start: Disagreement of the two as configured [m].
        alone: Every swap made alone.
        waterfall: The swaps that were kept, one upon the other, in their order.
    """

    model_config = ConfigDict(frozen=True)

    backends: tuple[str, str]
    motions: int
    start: Statistic
    alone: tuple[SwapResult, ...]
    waterfall: tuple[SwapResult, ...]


@dataclass(frozen=True)
class _Change:
    """A swap and what it does to the two configs: settings of their `backend` sections, and of both configs."""

    swap: Swap
    backend: tuple[Settings, Settings]
    shared: Settings

    @property
    def options(self) -> frozenset[tuple[str, str]]:
        """What is set, by side and key; two swaps that share one cannot both be made."""
        return frozenset((self.swap.side, key) for part in (*self.backend, self.shared) for key in part)

    def with_another(self, other: "_Change") -> "_Change":
        """Return both swaps as one."""
        swap = Swap(
            ingredient=f"{self.swap.ingredient} and {other.swap.ingredient}",
            side=self.swap.side,
            change=f"{self.swap.change}, {other.swap.change}",
        )
        first, second = ({**mine, **theirs} for mine, theirs in zip(self.backend, other.backend, strict=True))
        return _Change(swap, (first, second), merged(self.shared, other.shared))


BOTH = "both"
_NO_CHANGE = _Change(Swap(ingredient="nothing", side=BOTH, change=""), ({}, {}), {})


def attribute(
    configs: tuple[ExperimentConfig, ExperimentConfig],
    folder: ResultsFolder,
    jobs: int,
    progress: Progress = lambda *_: None,
) -> Attribution:
    """Find out which ingredients the disagreement of two backends comes from.

    Args:
        configs: The two, with the motions to compare over; disturbance and camera noise are switched off.
        folder: Where to write the logs and attribution.json.
        jobs: Number of processes.
        progress: Told what is done.

    Raises:
        ConfigError: The two name the same backend.
        ImoloError: A trial failed.
    """
    names = (configs[0].backend.name, configs[1].backend.name)
    if names[0] == names[1]:
        raise ConfigError(f"both configs are of backend {names[0]!r}; give two different ones")
    folder.prepare()
    bench = _Bench(folder, jobs, progress)
    quiet = {"simulation": NO_CHANCE}
    pair = (_changed(configs[0], {}, quiet), _changed(configs[1], {}, quiet))
    changes = _changes(pair)
    start, *alone = bench.try_all("one swap at a time", pair, [_NO_CHANGE, *changes])
    attribution = Attribution(
        backends=names,
        motions=len(configs[0].training.motions),
        start=start.disagreement,
        alone=tuple(alone),
        waterfall=tuple(_descend(bench, pair, changes, start.disagreement)),
    )
    folder.save_json("attribution.json", attribution)
    return attribution


def _descend(
    bench: "_Bench", pair: tuple[ExperimentConfig, ExperimentConfig], changes: Sequence[_Change], start: Statistic
) -> list[SwapResult]:
    """Make and keep the swaps that help most, one upon the other."""
    kept: list[SwapResult] = []
    level = start.mean or 0.0
    own = [change for change in changes if change.swap.side != BOTH]
    shared = [change for change in changes if change.swap.side == BOTH]
    for what, group in (("swap", own), ("shared swap", shared)):
        left = group
        while left:
            for number, candidates in ((1, left), (2, _pairs(left))):
                if not candidates:
                    continue
                results = bench.try_all(f"{what} {len(kept) + 1}, {number} at a time", pair, candidates)
                best = min(range(len(results)), key=lambda i: results[i].mean)
                if results[best].mean < level - LEAST_GAIN:
                    break
            else:
                break
            chosen = candidates[best]
            kept.append(results[best])
            level = results[best].mean
            pair = _apply(pair, chosen)
            left = [change for change in left if not change.options & chosen.options]
    return kept


def _pairs(changes: Sequence[_Change]) -> list[_Change]:
    """Return the swaps of two ingredients of one backend at once."""
    return [
        first.with_another(second)
        for first, second in combinations(changes, 2)
        if first.swap.side == second.swap.side != BOTH and not first.options & second.options
    ]


def _changes(pair: tuple[ExperimentConfig, ExperimentConfig]) -> list[_Change]:
    """Return all swaps: the time step and what the robot declares on both sides, and each backend's own."""
    finer = pair[0].simulation.timestep / 2.0
    step = Swap(ingredient="time step", side=BOTH, change=f"timestep: {finer:g}")
    changes = [_Change(step, ({}, {}), {"simulation": {"timestep": finer}})]
    for ingredient, alternatives in ROBOTS.load(pair[0].robot.name).ingredients.items():
        for shared in alternatives:
            if merged(pair[0].model_dump(), shared) != pair[0].model_dump():
                swap = Swap(ingredient=ingredient, side=BOTH, change=_written(shared))
                changes.append(_Change(swap, ({}, {}), shared))
    for side, config in enumerate(pair):
        options = backend_options(config).model_dump()
        for ingredient, alternatives in backend_plugin(config).ingredients.items():
            for settings in alternatives:
                if all(options[key] == value for key, value in settings.items()):
                    continue
                swap = Swap(ingredient=ingredient, side=config.backend.name, change=_written(settings))
                backend: tuple[Settings, Settings] = (settings, {}) if side == 0 else ({}, settings)
                changes.append(_Change(swap, backend, {}))
    return changes


def _written(settings: Settings) -> str:
    """Return settings as a config would have them, the innermost keys alone."""
    return ", ".join(
        _written(value) if isinstance(value, Mapping) else f"{key}: {_plain(value)}" for key, value in settings.items()
    )


def _plain(value: object) -> str:
    return f"{list(value)}" if isinstance(value, tuple) else str(value)


def _changed(config: ExperimentConfig, backend: Settings, shared: Settings) -> ExperimentConfig:
    if not backend and not shared:
        return config
    content = config.model_dump()
    content["backend"].update(backend)
    # A disturbance is replaced: the values of one profile are not those of another.
    content["simulation"].update(shared.get("simulation", {}))
    return type(config).model_validate(merged(content, {k: v for k, v in shared.items() if k != "simulation"}))


def _apply(
    pair: tuple[ExperimentConfig, ExperimentConfig], change: _Change
) -> tuple[ExperimentConfig, ExperimentConfig]:
    first, second = (
        _changed(config, backend, change.shared) for config, backend in zip(pair, change.backend, strict=True)
    )
    return first, second


class _Bench:
    """Runs the motions of configs, each config once."""

    def __init__(self, folder: ResultsFolder, jobs: int, progress: Progress) -> None:
        self._folder = folder
        self._jobs = jobs
        self._progress = progress
        self._hands: dict[str, Array] = {}

    def try_all(
        self, label: str, pair: tuple[ExperimentConfig, ExperimentConfig], changes: Sequence[_Change]
    ) -> list[SwapResult]:
        """Return what each change does to the disagreement of the pair."""
        changed = [_apply(pair, change) for change in changes]
        self._run(label, [*pair, *(config for two in changed for config in two)])
        before = [self._hands[config.digest()] for config in pair]
        results = []
        for change, two in zip(changes, changed, strict=True):
            after = [self._hands[config.digest()] for config in two]
            moved = max(float(_distance(a, b).mean()) for a, b in zip(before, after, strict=True))
            distance = _distance(after[0], after[1])
            results.append(
                SwapResult(swap=change.swap, moved=moved, disagreement=Statistic.of([float(d) for d in distance]))
            )
        return results

    def _run(self, label: str, configs: Sequence[ExperimentConfig]) -> None:
        new = {c.digest(): c for c in configs if c.digest() not in self._hands}
        tasks = {
            digest: [
                TrialTask(config, trial, self._folder.path / "logs" / digest / log_name(trial))
                for trial in (
                    Trial(TrialKind.TRAINING, index, config.seed) for index in range(len(config.training.motions))
                )
            ]
            for digest, config in new.items()
        }
        flat = [task for group in tasks.values() for task in group]
        if not flat:
            return
        done = 0

        def count(_: TrialTask) -> None:
            nonlocal done
            done += 1
            self._progress(label, done, len(flat))

        self._progress(label, 0, len(flat))
        run_tasks(flat, self._jobs, count)
        for digest, group in tasks.items():
            self._hands[digest] = np.array([_hand(task) for task in group])


def _hand(task: TrialTask) -> Array:
    hand = hand_in_swing(read_log(task.log_path), task.config)
    if hand is None:
        raise TrainingDataError(f"{task.log_path} does not show the effector in the swing")
    return hand


def _distance(a: Array, b: Array) -> Array:
    distance: Array = np.linalg.norm(a - b, axis=1)
    return distance
