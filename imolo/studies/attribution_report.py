"""The attribution as tables in the terminal, and as a waterfall."""

from itertools import pairwise

import matplotlib as mpl
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.table import Table

from imolo.campaigns.appearance import FAINT, SOFT, STYLE
from imolo.campaigns.summary import TABLE_STYLE
from imolo.studies.attribution import Attribution, SwapResult
from imolo.trials.metrics import Statistic


def render_attribution(answer: Attribution) -> RenderableType:
    """Return what every swap does alone, and what they explain one upon the other."""
    first, second = answer.backends
    alone = Table(
        title=f"{first} - {second}: hands {_tenths(answer.start)} mm apart, one thing swapped at a time",
        caption="hands: mean ± sd of their distance after the swap; by: how far the swap alone moved the hand.",
        **TABLE_STYLE,
    )
    _add_swap_columns(alone)
    for result in answer.alone:
        alone.add_row(*_swap_cells(result), f"{1e3 * result.moved:.1f}")
    kept = Table(title="One upon the other, the most helpful first", **TABLE_STYLE)
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


def draw_waterfall(answer: Attribution) -> Figure:
    """Draw what each swap explains of the disagreement of two backends, one upon the other, down to the rest."""
    heights = [1e3 * (s.mean or 0.0) for s in (answer.start, *(step.disagreement for step in answer.waterfall))]
    labels = [f"{answer.backends[0]} - {answer.backends[1]}\nas configured"]
    labels += [f"{s.swap.ingredient}\n{s.swap.side}, {s.swap.change}" for s in answer.waterfall]
    labels += ["not explained"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.5, 0.55 * len(labels) + 1.0), layout="constrained")
        axes = figure.subplots()
        rows = range(len(labels))
        axes.barh(rows[0], heights[0], color=FAINT, height=0.6)
        axes.barh(rows[-1], heights[-1], color=FAINT, height=0.6)
        axes.text(heights[0], rows[0], f" {heights[0]:.1f}", va="center")
        axes.text(heights[-1], rows[-1], f" {heights[-1]:.1f}", va="center")
        for row, (before, after) in enumerate(pairwise(heights), start=1):
            axes.barh(row, before - after, left=after, color=SOFT, height=0.6)
            axes.plot([before, before], [row - 1, row], color=SOFT, lw=0.6)
            axes.text(before, row, f" -{before - after:.1f}", va="center")
        axes.plot([heights[-1]] * 2, rows[-2:], color=SOFT, lw=0.6)
        axes.set_yticks(rows, labels, fontsize=8)
        axes.invert_yaxis()
        axes.set_xlim(0.0, 1.12 * max(heights))
        axes.set_xlabel(f"distance of the hands, mean over {answer.motions} motions [mm]")
        axes.grid(axis="y", visible=False)
        axes.set_title(f"What makes the hands of {' and '.join(answer.backends)} part", loc="left")
    return figure
