"""Play recordings under many settings, on all cores, and keep what came out, so that a study can go on."""

import hashlib
import json
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from imolo.campaigns.campaign import leave_interrupts_to_the_parent
from imolo.campaigns.kept_trials import environment, plugin_code
from imolo.campaigns.workers import run_on_cores, run_on_dask
from imolo.config.experiment import ExperimentConfig, ParallelConfig
from imolo.contracts.provenance import provenance
from imolo.contracts.registry import BACKENDS
from imolo.errors import BackendError, ConfigError, DivergenceError, ResultsError
from imolo.identification.experiment import Experiment, Recording, loss_of, residuals, sizes
from imolo.identification.parameters import Settings, apply
from imolo.machine.files import whole_file

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], object]

logger = logging.getLogger(__name__)

FAILED = 1e9  # loss of a recording that could not be played; far above any square, and finite for the search
CHUNK = 8  # recordings a process plays in one go


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came out of playing recordings under one set of settings.

    Attributes:
        loss: Of each recording, shape (R,); `FAILED` where it could not be played.
        size: Mean size of the errors of each recording by quantity [SI], shape (R,); NaN where it could not be played.
        residual: Of each recording, for `loss: squared`; empty otherwise.
        problem: Why a recording could not be played; empty where all were.
        seconds: Processor time it took [s].
    """

    loss: Array
    size: Mapping[str, Array]
    residual: Sequence[Array] = ()
    problem: str = ""
    seconds: float = 0.0

    @property
    def mean(self) -> float:
        """Mean loss."""
        return float(self.loss.mean())


@dataclass(frozen=True, eq=False)
class _Chunk:
    """Some recordings under one config."""

    recordings: Sequence[Recording]
    config: Any
    experiment: Experiment
    what: str

    def __str__(self) -> str:
        return self.what


@dataclass(eq=False)
class Bench:
    """Plays the recordings of an experiment, each set of settings once.

    Attributes:
        experiment: What is played.
        folder: Where results are kept.
        jobs: Number of processes, or -1 for one per core.
        parallel: Where they run.
        progress: Told what is done.
        evaluations: How many sets of settings were played or read so far.
        seconds: Processor time of these, whenever they were played [s].
        problems: By engine, how many of its sets could not be played whole, and why the first one could not.
    """

    experiment: Experiment
    folder: Path
    jobs: int
    parallel: ParallelConfig
    progress: Progress
    evaluations: int = 0
    seconds: float = 0.0
    problems: dict[str, tuple[int, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._done: dict[str, int] = {}
        self._origin = {
            engine: json.dumps({**environment(), **_code_of(config)}, sort_keys=True)
            for engine, config in self.experiment.configs.items()
        }

    def play(
        self,
        label: str,
        engine: str,
        many: Sequence[Settings],
        indices: Sequence[int],
        changes: Settings | None = None,
        expected: int = 0,
    ) -> list[Outcome]:
        """Play recordings under several sets of settings of one engine.

        Args:
            label: For the progress.
            engine: Name of the engine.
            many: Sets of settings, by path.
            indices: Which recordings.
            changes: Settings on top of each set, such as another time step.
            expected: How many sets will be played under this label at most; as many as now if not given.

        Raises:
            WorkerError: A process died each time.
        """
        base = self.experiment.configs[engine]
        files = [self._file(engine, {**settings, **(changes or {})}, indices) for settings in many]
        found = [self._read(file) for file in files]
        chunks: list[_Chunk] = []
        places: list[tuple[int, int]] = []
        failed: dict[int, Outcome] = {}
        for number, settings in enumerate(many):
            if found[number] is not None:
                continue
            try:
                config = apply(base, {**settings, **(changes or {})})
            except ConfigError as error:
                failed[number] = self._refused(str(error), len(indices))
                continue
            for start in range(0, len(indices), CHUNK):
                part = [self.experiment.recordings[index] for index in indices[start : start + CHUNK]]
                light = Experiment((), self.experiment.quantities, (), {}, self.experiment.loss)
                chunks.append(_Chunk(part, config, light, f"{engine}: {label}"))
                places.append((number, start))
        parts: dict[int, dict[int, Outcome]] = {}
        wanted = len(range(0, len(indices), CHUNK))
        shown = f"{engine}: {label}"
        before = self._done.get(shown, 0)
        total = max(expected, before + len(many))
        for count, (index, outcome) in enumerate(self._run(chunks), start=1):
            number, start = places[index]
            there = parts.setdefault(number, {})
            there[start] = outcome
            if len(there) == wanted:  # at once, so that an interrupt loses no more than what is being played
                found[number] = _joined([there[start] for start in sorted(there)])
                self._write(files[number], found[number])
            self.progress(shown, before + len(many) * count // len(chunks), total)
        self._done[shown] = before + len(many)
        self.progress(shown, self._done[shown], total)
        results = [outcome or failed[number] for number, outcome in enumerate(found)]
        for outcome in results:
            self.evaluations += 1
            self.seconds += outcome.seconds
            if outcome.problem:
                count, first = self.problems.get(engine, (0, outcome.problem))
                if not count:
                    logger.warning("%s: %s; the search goes on without", engine, first)
                self.problems[engine] = count + 1, first
        return results

    def _run(self, chunks: Sequence[_Chunk]) -> Any:
        if not chunks:
            return ()
        if self.parallel.backend == "dask":
            return run_on_dask(_play, chunks, self.parallel)
        if self.jobs == 1:
            return enumerate(map(_play, chunks))
        return run_on_cores(_play, chunks, self.jobs, self.parallel.retries, lambda _: True)

    def _refused(self, problem: str, count: int) -> Outcome:
        nothing = np.full(count, np.nan)
        size = {one.name: nothing for one in self.experiment.quantities}
        return Outcome(np.full(count, FAILED), size, problem=problem)

    def _file(self, engine: str, settings: Settings, indices: Sequence[int]) -> Path:
        content = {
            "origin": self._origin[engine],
            "config": self.experiment.configs[engine].model_dump_json(),
            "settings": dict(settings),
            "recordings": list(indices),
            "data": self.experiment.digest,
            "loss": [self.experiment.loss, *map(str, self.experiment.quantities)],
        }
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
        return self.folder / f"{engine}_{digest}.npz"

    def _read(self, file: Path) -> Outcome | None:
        try:
            with file.open("rb") as opened, np.load(opened, allow_pickle=False) as stored:
                names = [one.name for one in self.experiment.quantities]
                size = {name: stored[f"size {name}"] for name in names}
                residual = [stored[f"residual {number}"] for number in range(int(stored["residuals"]))]
                return Outcome(stored["loss"], size, residual, str(stored["problem"]), float(stored["seconds"]))
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None

    def _write(self, file: Path, outcome: Outcome) -> None:
        arrays: dict[str, Any] = {"loss": outcome.loss, "problem": outcome.problem, "seconds": outcome.seconds}
        arrays["residuals"] = len(outcome.residual)
        arrays |= {f"size {name}": value for name, value in outcome.size.items()}
        arrays |= {f"residual {number}": vector for number, vector in enumerate(outcome.residual)}
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with whole_file(file) as opened:
                np.savez(opened, **arrays)
        except OSError as error:
            raise ResultsError(f"cannot write {file}: {error.strerror}; make room or choose another --out") from error


def _code_of(config: Any) -> dict[str, str]:
    if isinstance(config, ExperimentConfig):
        return plugin_code(config)
    return {"backend code": str(provenance(BACKENDS.group, config.backend.name))}


def _joined(parts: Sequence[Outcome]) -> Outcome:
    return Outcome(
        np.concatenate([part.loss for part in parts]),
        {name: np.concatenate([part.size[name] for part in parts]) for name in parts[0].size},
        [vector for part in parts for vector in part.residual],
        next((part.problem for part in parts if part.problem), ""),
        sum(part.seconds for part in parts),
    )


@cache
def _threads() -> ThreadpoolController:
    # To look for the libraries that have threads takes longer than to play a recording.
    return ThreadpoolController()


def _play(chunk: _Chunk) -> Outcome:
    leave_interrupts_to_the_parent()
    experiment = chunk.experiment
    loss: list[float] = []
    size: dict[str, list[float]] = {one.name: [] for one in experiment.quantities}
    vectors: list[Array] = []
    problem = ""
    began = time.process_time()
    with _threads().limit(limits=1):
        for recording in chunk.recordings:
            try:
                errors = recording.play(chunk.config)
                value = loss_of(errors, experiment)
                if not math.isfinite(value):
                    raise DivergenceError("the errors are not finite")
            except (BackendError, DivergenceError) as error:
                problem = problem or f"{recording.name} could not be played: {error}"
                loss.append(FAILED)
                for values in size.values():
                    values.append(math.nan)
                vectors.append(np.empty(0))
                continue
            loss.append(value)
            mean = sizes(errors)
            for name, values in size.items():
                values.append(mean[name])
            if experiment.loss == "squared":
                vectors.append(residuals(errors, experiment.quantities))
    sized = {name: np.array(values) for name, values in size.items()}
    return Outcome(np.array(loss), sized, vectors, problem, time.process_time() - began)
