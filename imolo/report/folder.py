"""Read a results folder for the report; what is damaged is named together with the way to get it again."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from imolo.campaigns.campaign import log_name
from imolo.campaigns.comparison import Comparison, Timings
from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import validated_config
from imolo.config.reading import read_yaml
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import ConfigError, ResultsError
from imolo.machine.files import read_bounded
from imolo.report.plausibility import check_numbers, check_result
from imolo.trials.metrics import MethodResult, Statistic, TrialResult

MOST_BYTES = 100_000_000  # the summary of 10,000 balls has 5,000,000
AGAIN = "run `imolo compare` or `imolo hit` again, or restore the file"

Content = TypeVar("Content", bound=BaseModel)


@dataclass(frozen=True)
class ReportedTrial:
    """One ball of one method on one backend.

    Attributes:
        backend: Name.
        method: Name.
        result: As in the summary.
        log_path: Its log, which may be missing.
    """

    backend: str
    method: str
    result: TrialResult
    log_path: Path


@dataclass(frozen=True)
class Campaign:
    """Balls that were thrown, and how that ended.

    Attributes:
        results: By backend, then by method.
        configs: By backend.
        config_texts: The YAML of each, as it lies in the folder.
        trials: Every ball.
        timings: None where the folder has none, as after `imolo hit`.
        seed: Of all chance.
        versions: Of the packages; empty where the folder does not tell.
        digests: Hash of each config; empty where the folder does not tell.
        disagreement: Of the hands of two backends [m]; empty where the folder does not tell.
    """

    results: dict[str, dict[str, MethodResult]]
    configs: dict[str, ExperimentConfig]
    config_texts: dict[str, str]
    trials: tuple[ReportedTrial, ...]
    timings: Timings | None
    seed: int
    versions: dict[str, str]
    digests: dict[str, str]
    disagreement: dict[str, Statistic]


def read_campaign(path: Path) -> Campaign | None:
    """Return the campaign of a results folder, of `imolo compare` or `imolo hit`; None if it has no summary.json.

    Raises:
        ResultsError: Something in it is damaged, or its configs are missing.
    """
    if not (path / "summary.json").exists():
        return None
    folder = ResultsFolder(path)
    text = read_text(path / "summary.json")
    configs, texts = _read_configs(path)
    summary = parse(Comparison, text, path / "summary.json")
    results, timings = summary.results, None
    if not results or not all(results.values()):
        raise ResultsError(
            f"{path / 'summary.json'} is damaged: a backend or method is missing in its results; {AGAIN}"
        )
    if (path / "timing.json").exists():
        timings = parse(Timings, read_text(path / "timing.json"), path / "timing.json")
    for backend, methods in results.items():
        file = path / "configs" / f"{backend}.yaml"
        if backend not in configs:
            raise ResultsError(f"{file} is missing, but summary.json names it; {AGAIN}")
        for method, result in methods.items():
            if method not in configs[backend].methods:
                raise ResultsError(f"{file} has no method {method!r}, but summary.json names it; {AGAIN}")
            try:
                check_result(f"{backend}, {method}", result)
            except ValueError as error:
                raise ResultsError(f"{path / 'summary.json'} is damaged: {error}; {AGAIN}") from error
    return Campaign(
        results=results,
        configs={backend: configs[backend] for backend in results},
        config_texts={backend: texts[backend] for backend in results},
        trials=tuple(_trials(folder, results, summary.seed)),
        timings=timings,
        seed=summary.seed,
        versions=summary.versions,
        digests=summary.configs,
        disagreement=summary.disagreement,
    )


def read_text(path: Path) -> str:
    """Return what a file says.

    Raises:
        ResultsError: It cannot be read.
    """
    try:
        return read_bounded(path, MOST_BYTES).decode()
    except OSError as error:
        raise ResultsError(f"cannot read {path}: {error.strerror}; {AGAIN}") from error
    except UnicodeDecodeError as error:
        raise ResultsError(f"{path} is no text: {error.reason} at byte {error.start}; {AGAIN}") from error


def parse(model: type[Content], text: str, path: Path) -> Content:
    """Return the content of a JSON file of ours.

    Raises:
        ResultsError: It is damaged, or of another version of imolo.
    """
    try:
        content = model.model_validate_json(text)
        check_numbers(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        reason = f"{place}: {first['msg']}" if place else first["msg"]
        raise ResultsError(f"{path} is damaged: {reason}; {AGAIN}") from error
    except ValueError as error:
        raise ResultsError(f"{path} is damaged: {error}; {AGAIN}") from error
    return content


def _read_configs(path: Path) -> tuple[dict[str, ExperimentConfig], dict[str, str]]:
    """Read the resolved configs; their backends need not be installed here."""
    configs: dict[str, ExperimentConfig] = {}
    texts: dict[str, str] = {}
    for file in sorted((path / "configs").glob("*.yaml")):
        texts[file.stem] = read_text(file)
        try:
            content = read_yaml(file, "it needs a backend")
            _refuse_older(content, file)
            configs[file.stem] = validated_config(content, f"{file} is damaged")
        except ConfigError as error:
            raise ResultsError(f"{error}; {AGAIN}") from error
    return configs, texts


def _refuse_older(content: Any, file: Path) -> None:
    if isinstance(content, Mapping) and "robot" in content and "task" not in content:
        raise ResultsError(
            f"{file} was written before robots were plug-ins; read it with imolo 0.1, or run `imolo compare` again"
        )


def _trials(folder: ResultsFolder, results: dict[str, dict[str, MethodResult]], seed: int) -> Iterator[ReportedTrial]:
    for backend, methods in results.items():
        for method, result in methods.items():
            for trial in result.trials:
                name = log_name(Trial(TrialKind.HIT, trial.trial, seed))
                yield ReportedTrial(backend, method, trial, folder.hits(backend, method) / name)
