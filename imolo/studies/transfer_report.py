"""The transfer matrix as a table and as heat maps."""

from collections.abc import Callable

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table

from imolo.campaigns.appearance import FAINT, INK
from imolo.campaigns.appearance import STYLE as FIGURE_STYLE
from imolo.campaigns.summary import TABLE_STYLE, millimetres
from imolo.studies.transfer import Cell, Transfer

PAPER_HAND_ERROR = 0.0129  # [m] Sec. VII-C
WORST_HAND_ERROR = 0.05  # [m] where the colours end
LIGHT = "#FDFDFD"  # on a dark cell, whatever the page
LUMA = (0.299, 0.587, 0.114)  # of red, green and blue in the brightness, ITU-R BT.601
ALONE = "trials alone"


def players(result: Transfer) -> list[str]:
    """Return the backends that threw balls."""
    return list(dict.fromkeys(cell.played_in for cell in result.cells))


def rows(result: Transfer, *, corrected: bool) -> list[str | None]:
    """Return where the tables of a matrix were learned; None is the trials alone."""
    known = {cell.learned_in for cell in result.cells if cell.corrected == corrected}
    return [name for name in (None, *players(result)) if name in known]


def title(result: Transfer, *, corrected: bool) -> str:
    """Return what the tables of a matrix know."""
    dense = f"{result.motions} motions in one engine"
    return f"{dense}, corrected by {result.trials} trials in the other" if corrected else f"{dense}, as it is"


def cell_text(cell: Cell | None) -> str:
    """Return hits, Wilson interval and hand error of a cell in words."""
    if cell is None:
        return "-"
    low, high = cell.interval
    return f"{cell.hits}/{cell.balls} ({100 * low:.0f}-{100 * high:.0f} %), {millimetres(cell.hand_error)} mm"


def render_transfer(result: Transfer) -> Table:
    """Return hits, Wilson 95 % intervals and hand errors of all tables on all backends."""
    table = Table(
        title="Tables of one backend, balls in another: hits (Wilson 95 %), hand and grid point mean±sd",
        caption="The paper's robot: 16/20 (58-92 %), 12.9±9.4 mm (Sec. VII-C).",
        **TABLE_STYLE,
    )
    table.add_column("learned in", no_wrap=True)
    for name in players(result):
        table.add_column(f"balls in {name}", justify="right")
    for corrected in (False, True):
        table.add_row(title(result, corrected=corrected), *("" for _ in players(result)), style="dim")
        for learned_in in rows(result, corrected=corrected):
            cells = (result.cell(learned_in, name, corrected) for name in players(result))
            table.add_row(learned_in or ALONE, *(cell_text(cell) for cell in cells))
        table.add_section()
    return table


def draw_transfer(result: Transfer) -> Figure:
    """Draw hit rates and hand errors as heat maps, without and with the correction."""
    with mpl.rc_context({**FIGURE_STYLE, "axes.grid": False}):
        figure = Figure(figsize=(9.5, 6.8), layout="constrained")
        panels = figure.subplots(2, 2, squeeze=False)
        for column, corrected in zip(panels.T, (False, True), strict=True):
            _draw(column[0], result, corrected, lambda cell: 100.0 * cell.rate, "hit rate [%]", "cividis", 100.0)
            _draw(
                column[1],
                result,
                corrected,
                lambda cell: np.nan if cell.hand_error.mean is None else 1e3 * cell.hand_error.mean,
                "hand error [mm]",
                "cividis_r",
                1e3 * WORST_HAND_ERROR,
            )
            column[0].set_title(title(result, corrected=corrected).replace(", ", ",\n"), fontsize=9)
        figure.suptitle(
            f"Rows: where a table was learned; columns: where the balls were thrown; brighter is better "
            f"(the paper's robot: 80 %, {1e3 * PAPER_HAND_ERROR:.1f} mm)",
            fontsize=9,
        )
    return figure


def _draw(
    axes: Axes,
    result: Transfer,
    corrected: bool,
    value: Callable[[Cell], float],
    label: str,
    colors: str,
    top: float,
) -> None:
    names, learned = players(result), rows(result, corrected=corrected)
    cells = [[result.cell(row, name, corrected) for name in names] for row in learned]
    values = np.array([[np.nan if cell is None else value(cell) for cell in row] for row in cells])
    image = axes.imshow(values, cmap=colors, vmin=0.0, vmax=top)
    for i, j in np.argwhere(np.isfinite(values)):
        brightness = np.dot(image.cmap(image.norm(values[i, j]))[:3], LUMA)
        color = INK if brightness > 0.5 else LIGHT
        axes.text(j, i, f"{values[i, j]:.0f}", ha="center", va="center", color=color, fontsize=9)
    for i, j in np.argwhere(~np.isfinite(values)):
        axes.plot(j, i, "x", color=FAINT)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(learned)), [row or ALONE for row in learned])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.figure.colorbar(image, ax=axes, label=label, shrink=0.85)
