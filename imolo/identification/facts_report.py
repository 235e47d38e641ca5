"""How a robot meets published facts, as tables and a figure."""

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table

from imolo.campaigns.appearance import FAINT, INK, SOFT, STYLE
from imolo.campaigns.summary import TABLE_STYLE
from imolo.identification.facts_study import FactFound, FactsResult

FACT_COLUMNS = ("fact", "published", "as it is", "best", "ensemble", "missed by", "source")
SETTING_COLUMNS = ("setting", "as it is", "best", "ensemble", "searched")
SETTINGS_TITLE = "What the facts leave open"
FACTS_NOTE = (
    "missed by: of the best set, in tolerances; ensemble: lowest and highest of the sets that meet the facts as well"
)


def fact_rows(result: FactsResult) -> list[list[str]]:
    """Return a row for each fact."""
    return [
        [
            one.name + (" (held out)" if one.held_out else ""),
            _published(one),
            _number(one.start),
            _number(one.best),
            f"{_number(one.low)} … {_number(one.high)}",
            f"{one.miss:.1f}" if one.miss else "",
            one.source,
        ]
        for one in result.facts
    ]


def setting_rows(result: FactsResult) -> list[list[str]]:
    """Return a row for each setting."""
    return [
        [
            one.path,
            _number(one.start),
            _number(one.best),
            f"{_number(one.low)} … {_number(one.high)}",
            f"{_number(one.searched[0])} … {_number(one.searched[1])}",
        ]
        for one in result.settings
    ]


def render(result: FactsResult) -> RenderableType:
    """Return everything as tables."""
    parts: list[RenderableType] = []
    for title, columns, rows in (
        (result.title, FACT_COLUMNS, fact_rows(result)),
        (SETTINGS_TITLE, SETTING_COLUMNS, setting_rows(result)),
    ):
        table = Table(title=escape(title), **TABLE_STYLE)
        for name in columns:
            table.add_column(name)
        for row in rows:
            table.add_row(*map(escape, row))
        parts.append(table)
    return Group(*parts, FACTS_NOTE, summary(result))


def summary(result: FactsResult) -> str:
    """Return how many robots were played and how near the best one comes."""
    return (
        f"{result.evaluations} robots in {result.backend}; squared misses {result.start_loss:.1f} as it is, "
        f"{result.best_loss:.2f} at best; {len(result.members)} sets in the ensemble"
    )


def figure(result: FactsResult) -> Figure:
    """Return where in its range each setting lies: as it is, at best, and over the ensemble."""
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(7.0, 0.6 + 0.28 * len(result.settings)), layout="constrained")
        axis = drawn.subplots()
        for row, one in enumerate(result.settings):
            low, high, best, start = (_place(value, one.searched) for value in (one.low, one.high, one.best, one.start))
            axis.plot([low, high], [row, row], color=FAINT, lw=5, solid_capstyle="butt")
            axis.plot(best, row, "o", color=INK, label="best, with the ensemble's range" if row == 0 else None)
            axis.plot(start, row, "|", color=SOFT, mew=2, ms=11, label="as it is" if row == 0 else None)
        axis.set_yticks(range(len(result.settings)), [one.path for one in result.settings])
        axis.invert_yaxis()
        axis.set_xlim(0.0, 1.0)
        axis.set_xticks([0.0, 1.0], ["lowest searched", "highest"])
        drawn.legend(loc="outside upper right", ncols=2)
    return drawn


def _place(value: float, searched: tuple[float, float]) -> float:
    low, high = searched
    if low > 0.0 and high / low > 10.0:
        return float(np.log(value / low) / np.log(high / low))
    return (value - low) / (high - low)


def _published(fact: FactFound) -> str:
    if fact.at_least is None:
        return f"≤ {_number(fact.at_most or 0.0)}"
    if fact.at_most is None:
        return f"≥ {_number(fact.at_least)}"
    return f"{_number(fact.at_least)} … {_number(fact.at_most)}"


def _number(value: float) -> str:
    return f"{value:.3g}"
