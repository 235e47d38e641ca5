"""The comparison as tables in the terminal, beside the paper's own numbers."""

from collections.abc import Mapping
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table

from imolo.campaigns.comparison import Comparison, Timing
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import task_plugin
from imolo.contracts.registry import ROBOTS
from imolo.trials.metrics import HORIZONS, MethodResult, PositionResult, Statistic

TABLE_STYLE: Any = {"box": box.SIMPLE_HEAD, "title_justify": "left", "caption_justify": "left", "padding": 0}
CAPTION = (
    "hits with the Wilson 95 % interval; hand: from the selected grid point, mean ± sd; ball: from where it was "
    "predicted that many seconds before; decide: median of a planner decision; speed: of one process, in real time."
)


Results = Mapping[str, Mapping[str, MethodResult]]
Timings = Mapping[str, Mapping[str, Timing]]


def render_comparison(comparison: Comparison, timing: Timings, config: ExperimentConfig) -> RenderableType:
    """Return the tables of a comparison."""
    tables = [render_results(comparison.results, timing, config), render_causes(comparison.results)]
    if comparison.disagreement:
        tables.append(render_disagreement(comparison.disagreement, config.training.comparison_time))
    return Group(*tables)


def render_results(results: Results, timing: Timings, config: ExperimentConfig) -> Table:
    """Return a line for every backend and method, and those that are published of the robot itself."""
    published = ROBOTS.load(config.robot.name).published
    caption = CAPTION + "".join(f" In italics: {one.source}." for one in published)
    measures = sorted({name for methods in results.values() for one in methods.values() for name in one.measures})
    table = Table(title=f"{task_plugin(config).title}, {config.robot.name}", caption=caption, **TABLE_STYLE)
    table.add_column("backend", no_wrap=True, min_width=8)
    table.add_column("method", no_wrap=True, min_width=8)
    table.add_column(task_plugin(config).successes, justify="right")
    table.add_column("95 %", justify="right")
    table.add_column("hand\nmm", justify="right")
    for horizon in HORIZONS:
        table.add_column(f"ball {horizon:.2f}\nmm", justify="right")
    for name in measures:
        table.add_column(name.replace(" [", "\n[").replace("[", "").replace("]", ""), justify="right")
    table.add_column("decide\nms", justify="right")
    table.add_column("speed\n×", justify="right")
    for backend, methods in results.items():
        for method, result in methods.items():
            speed = timing[backend][method]
            low, high = result.interval
            table.add_row(
                backend,
                method,
                f"{result.hits}/{result.balls}",
                f"{100 * low:.0f}-{100 * high:.0f}",
                millimetres(result.hand_error),
                *(millimetres(result.prediction_error[f"{horizon:.2f}"]) for horizon in HORIZONS),
                *(_plain(result.measures.get(name)) for name in measures),
                f"{1e3 * speed.decision_median:.2f}",
                f"{speed.real_time_factor:.1f}",
            )
        table.add_section()
    for one in published:
        balls = (one.ball_errors.get(f"{horizon:.2f}", "-") for horizon in HORIZONS)
        cells = ("robot", one.method, one.successes, one.interval, one.hand_error, *balls, *("-" for _ in measures))
        table.add_row(*cells, "-", "-", style="italic")
    return table


def _plain(statistic: Statistic | None) -> str:
    if statistic is None or statistic.mean is None:
        return "-"
    return f"{statistic.mean:.2f}" + ("" if statistic.sd is None else f"±{statistic.sd:.2f}")


def render_causes(results: Results) -> Table:
    """Return how often each cause made a miss, and how many balls from each position were hit."""
    causes = [
        cause
        for cause in dict.fromkeys(cause for m in results.values() for r in m.values() for cause in r.causes)
        if any(r.causes.get(cause) for m in results.values() for r in m.values())
    ]
    missed = "Why balls were missed, and hits by the position they were thrown from"
    table = Table(
        title=f"{missed if causes else 'Hits by the position balls were thrown from'} (Wilson 95 %)",
        caption="Causes are defined in docs/experiments.md; they are told from the logs alone." if causes else None,
        **TABLE_STYLE,
    )
    for title in ("backend", "method"):
        table.add_column(title, no_wrap=True, min_width=8)
    for title in ("missed", *(cause.replace(" ", "\n") for cause in causes), "from each position"):
        table.add_column(title, justify="right")
    for backend, methods in results.items():
        for method, result in methods.items():
            counts = [str(result.causes.get(cause, 0)) for cause in causes]
            places = "\n".join(_position(place) for place in result.positions)
            table.add_row(backend, method, str(result.balls - result.hits), *counts, places)
        table.add_section()
    return table


def _position(place: PositionResult) -> str:
    name = "unseen" if place.thrown_from < 0 else f"{place.thrown_from + 1}"
    low, high = place.interval
    return f"{name}: {place.hits}/{place.balls} ({100 * low:.0f}-{100 * high:.0f} %)"


def render_disagreement(disagreement: Mapping[str, Statistic], time: float) -> Table:
    """Return how far the hands of two backends are apart under the same commands, `time` after the swing began [s]."""
    table = Table(title=f"Hands of two backends under the same command, {time:g} s into the swing", **TABLE_STYLE)
    table.add_column("backends")
    table.add_column("mean±sd [mm]", justify="right")
    table.add_column("motions", justify="right")
    for pair, statistic in disagreement.items():
        table.add_row(pair, millimetres(statistic), str(statistic.count))
    return table


def millimetres(statistic: Statistic) -> str:
    """Return mean and standard deviation in whole millimetres, or a dash where there is nothing."""
    if statistic.mean is None:
        return "-"
    spread = "" if statistic.sd is None else f"±{1e3 * statistic.sd:.0f}"
    return f"{1e3 * statistic.mean:.0f}{spread}"
