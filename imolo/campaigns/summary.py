"""The comparison as tables in the terminal, beside the paper's own numbers."""

from collections.abc import Mapping
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table

from imolo.campaigns.comparison import Comparison, Timing
from imolo.studies.attribution import Attribution, SwapResult
from imolo.trials.causes import Cause
from imolo.trials.metrics import HORIZONS, MethodResult, PositionResult, Statistic

PAPER = ("robot", "paper", "16/20", "58-92", "13±9", "46±34", "156±32", "338±36", "-", "-")  # Sec. VII-C
STYLE: Any = {"box": box.SIMPLE_HEAD, "title_justify": "left", "caption_justify": "left", "padding": 0}
CAPTION = (
    "hits with the Wilson 95 % interval; hand: from the selected grid point, mean ± sd; ball: from where it was "
    "predicted that many seconds before; decide: median of a planner decision; speed: of one process, in real time. "
    "Last line: Liberobot itself, Sec. VII-C."
)


Results = Mapping[str, Mapping[str, MethodResult]]
Timings = Mapping[str, Mapping[str, Timing]]


def render_comparison(comparison: Comparison, timing: Timings) -> RenderableType:
    """Return the tables of a comparison."""
    return Group(
        render_results(comparison.results, timing),
        render_causes(comparison.results),
        render_disagreement(comparison.disagreement),
    )


def render_results(results: Results, timing: Timings) -> Table:
    """Return a line for every backend and method, and one for the paper's robot."""
    table = Table(title="Jump and hit", caption=CAPTION, **STYLE)
    table.add_column("backend", no_wrap=True, min_width=8)
    table.add_column("method", no_wrap=True, min_width=8)
    table.add_column("hits", justify="right")
    table.add_column("95 %", justify="right")
    table.add_column("hand\nmm", justify="right")
    for horizon in HORIZONS:
        table.add_column(f"ball {horizon:.2f}\nmm", justify="right")
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
                f"{1e3 * speed.decision_median:.2f}",
                f"{speed.real_time_factor:.1f}",
            )
        table.add_section()
    table.add_row(*PAPER, style="italic")
    return table


def render_causes(results: Results) -> Table:
    """Return how often each cause made a miss, and how many balls from each position were hit."""
    table = Table(
        title="Why balls were missed, and hits by the position they were thrown from (Wilson 95 %)",
        caption="Causes are defined in docs/experiments.md; they are told from the logs alone.",
        **STYLE,
    )
    for title in ("backend", "method"):
        table.add_column(title, no_wrap=True, min_width=8)
    causes = [str(cause) for cause in Cause if any(r.causes.get(cause) for m in results.values() for r in m.values())]
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


def render_disagreement(disagreement: Mapping[str, Statistic]) -> Table:
    """Return how far the hands of two backends are apart under the same commands."""
    table = Table(title="Hands of two backends under the same command, t_w + 0.17 s", **STYLE)
    table.add_column("backends")
    table.add_column("mean±sd [mm]", justify="right")
    table.add_column("motions", justify="right")
    for pair, statistic in disagreement.items():
        table.add_row(pair, millimetres(statistic), str(statistic.count))
    return table


def render_attribution(answer: Attribution) -> RenderableType:
    """Return what every swap does alone, and what they explain one upon the other."""
    first, second = answer.backends
    alone = Table(
        title=f"{first} - {second}: hands {_tenths(answer.start)} mm apart, one thing swapped at a time",
        caption="hands: mean ± sd of their distance after the swap; by: how far the swap alone moved the hand.",
        **STYLE,
    )
    _add_swap_columns(alone)
    for result in answer.alone:
        alone.add_row(*_swap_cells(result), f"{1e3 * result.moved:.1f}")
    kept = Table(title="One upon the other, the most helpful first", **STYLE)
    _add_swap_columns(kept)
    before = answer.start.mean or 0.0
    for result in answer.waterfall:
        after = result.disagreement.mean or 0.0
        kept.add_row(*_swap_cells(result), f"-{1e3 * (before - after):.1f}")
        before = after
    kept.add_section()
    kept.add_row("not explained", "", "", f"{1e3 * before:.1f}", "")
    return Group(alone, kept)


def _add_swap_columns(table: Table) -> None:
    for title in ("ingredient", "side", "change"):
        table.add_column(title)
    for title in ("hands\nmm", "by\nmm"):
        table.add_column(title, justify="right")


def _swap_cells(result: SwapResult) -> tuple[str, str, str, str]:
    return result.swap.ingredient, result.swap.side, result.swap.change, _tenths(result.disagreement)


def _tenths(statistic: Statistic) -> str:
    return "-" if statistic.mean is None else f"{1e3 * statistic.mean:.1f}±{1e3 * (statistic.sd or 0.0):.1f}"


def millimetres(statistic: Statistic) -> str:
    """Return mean and standard deviation in whole millimetres, or a dash where there is nothing."""
    if statistic.mean is None:
        return "-"
    spread = "" if statistic.sd is None else f"±{1e3 * statistic.sd:.0f}"
    return f"{1e3 * statistic.mean:.0f}{spread}"
