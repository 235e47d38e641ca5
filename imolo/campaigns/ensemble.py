"""The same comparison with every robot of an ensemble: how far results vary over what is not known of a robot."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from rich.table import Table

from imolo.campaigns.comparison import Comparison, Progress, compare
from imolo.campaigns.results import ResultsFolder
from imolo.campaigns.summary import TABLE_STYLE
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import merged, validated_config
from imolo.config.model import Model
from imolo.config.reading import check_model, read_yaml

LEAST = "it needs members, each a part of a config; `imolo identify` writes one"
CAPTION = (
    "lowest, median and highest over the members; within: median over the members of the standard deviation of a hand "
    "error in one campaign"
)


class EnsembleFile(Model):
    """What an ensemble's file says.

    Attributes:
        members: Parts of a config, each laid over the configs of the comparison.
    """

    members: Annotated[tuple[dict[str, Any], ...], Field(min_length=1)]


class Range(BaseModel):
    """One number over the members; None where a member has none.

    Attributes:
        values: Of each member.
    """

    model_config = ConfigDict(frozen=True)

    values: tuple[float | None, ...]

    def written(self, factor: float, digits: int = 0) -> str:
        """Return lowest, median and highest, times a factor."""
        known = factor * np.array([value for value in self.values if value is not None])
        if not len(known):
            return "-"
        return " … ".join(f"{value:.{digits}f}" for value in (known.min(), np.median(known), known.max()))


class EnsembleResult(BaseModel):
    """What came out.

    Attributes:
        members: How many.
        balls: Thrown at each, by each method.
        hit_rate: By backend, then by method: share of balls.
        hand_error: Likewise: mean distance from the selected grid point [m].
        hand_sd: Likewise: its standard deviation [m].
    """

    model_config = ConfigDict(frozen=True)

    members: int
    balls: int
    hit_rate: dict[str, dict[str, Range]]
    hand_error: dict[str, dict[str, Range]]
    hand_sd: dict[str, dict[str, Range]]


def read_ensemble(path: Path) -> tuple[dict[str, Any], ...]:
    """Read the members of an ensemble.

    Raises:
        ConfigError: The file cannot be read, or holds no members.
    """
    return check_model(read_yaml(path, LEAST), EnsembleFile, str(path)).members


def with_member(config: ExperimentConfig, member: Mapping[str, Any], where: str) -> ExperimentConfig:
    """Return a config with a member laid over it.

    Raises:
        ConfigError: The member has an unknown key, or a value out of range.
    """
    return validated_config(merged(config.model_dump(), member), where)


def compare_ensemble(
    configs: Sequence[ExperimentConfig],
    members: Sequence[Mapping[str, Any]],
    folder: ResultsFolder,
    jobs: int,
    progress: Progress,
    fresh: bool = False,
) -> EnsembleResult:
    """Compare with every member, each in a folder of its own, and write ensemble.json.

    Args:
        configs: One per backend, alike but for the backend.
        members: Parts of a config.
        folder: Where to write everything.
        jobs: Number of processes.
        progress: Told what is done.
        fresh: Whether trials that are there are deleted.

    Raises:
        ImoloError: Something failed; what was recorded until then stays.
    """
    folder.prepare()
    changed = [
        [with_member(config, member, f"member {number}") for config in configs]
        for number, member in enumerate(members, start=1)
    ]
    found: list[Comparison] = []
    progress("members", 0, len(members))
    for number, theirs in enumerate(changed, start=1):
        own = ResultsFolder(folder.path / f"member_{number:02d}")
        if fresh:
            own.discard_trials()
        comparison, _ = compare(theirs, own, jobs)
        found.append(comparison)
        progress("members", number, len(members))
    over = _over(found, configs[0].campaign.balls)
    folder.save_json("ensemble.json", over)
    return over


def _over(found: Sequence[Comparison], balls: int) -> EnsembleResult:
    names = {backend: list(methods) for backend, methods in found[0].results.items()}

    def collect(number: Callable[[Any], float | None]) -> dict[str, dict[str, Range]]:
        return {
            backend: {
                method: Range(values=tuple(number(one.results[backend][method]) for one in found)) for method in methods
            }
            for backend, methods in names.items()
        }

    return EnsembleResult(
        members=len(found),
        balls=balls,
        hit_rate=collect(lambda one: one.hits / one.balls),
        hand_error=collect(lambda one: one.hand_error.mean),
        hand_sd=collect(lambda one: one.hand_error.sd),
    )


def render_ensemble(result: EnsembleResult) -> Table:
    """Return a line for every backend and method."""
    title = f"Over {result.members} robots that are known equally well, {result.balls} balls each"
    table = Table(title=title, caption=CAPTION, **TABLE_STYLE)
    for name in ("backend", "method"):
        table.add_column(name, no_wrap=True, min_width=8)
    for name in ("successes %", "hand mm", "within mm"):
        table.add_column(name, justify="right")
    for backend, methods in result.hit_rate.items():
        for method, rate in methods.items():
            within = [value for value in result.hand_sd[backend][method].values if value is not None]
            table.add_row(
                backend,
                method,
                rate.written(100.0),
                result.hand_error[backend][method].written(1e3),
                f"{1e3 * float(np.median(within)):.0f}" if within else "-",
            )
        table.add_section()
    return table
