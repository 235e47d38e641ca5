"""What a study found, as tables for the terminal and the page, and as a figure."""

from collections.abc import Sequence

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table

from imolo.campaigns.appearance import FILLS, SOFT, STYLE, engine_appearance
from imolo.campaigns.summary import TABLE_STYLE
from imolo.identification.judge import Spread
from imolo.identification.study import Identification

CHECK_TITLE = "What can be identified: effects where the search starts"
FITS_TITLE = "Errors on recordings that no fit has seen"
PARAMETERS_TITLE = "What was fitted, with 90 % intervals"
PAIRS_TITLE = "Engines on the same recordings: second less first, 95 % interval of the mean"
FITS_NOTE = (
    "mean ± sd over the recordings, and the 95 % bootstrap interval of the mean; * is taken. A fit with more "
    "parameters is taken only if it surely wins on the recordings held out."
)
CHECK_NOTE = (
    "effect: change of a recording's loss over 5 % of the range; most like: the other parameter whose effects are the "
    "most alike, of which at ±1.00 only one can be told"
)
DATA_COLUMNS = ("data", "")
CHECK_COLUMNS = ("engine", "setting", "start", "effect", "most like", "")
PARAMETER_COLUMNS = ("engine", "fit", "setting", "value", "90 % interval", "searched", "")


def fit_columns(result: Identification) -> tuple[str, ...]:
    """Return the titles of the table of fits."""
    return (
        "engine",
        "fit",
        "parameters",
        "played",
        "CPU s",
        "loss",
        *(f"{name} [{unit}]" for name, unit, _ in result.quantities),
    )


def fit_rows(result: Identification) -> list[list[str]]:
    """Return a row for each fit of each engine."""
    rows = []
    for engine, found in result.engines.items():
        for one in found.candidates:
            star = " *" if one.name == found.taken else ""
            sizes = [_spread(one.sizes.get(name), factor) for name, _, factor in result.quantities]
            loss = "" if one.loss is None else f"{one.loss.mean:.3g}"
            cost = (str(one.evaluations), f"{one.seconds:.0f}")
            rows.append([engine, one.name + star, str(len(one.parameters)), *cost, loss, *sizes])
    return rows


def check_rows(result: Identification) -> list[list[str]]:
    """Return a row for each parameter and what it does before the fit."""
    return [
        [
            engine,
            one.path,
            f"{one.start:.4g}",
            f"{100.0 * one.effect:.1f} %",
            "" if one.like is None else f"{one.like} {one.likeness:+.2f}",
            "" if one.fitted else "does nothing; left as it is",
        ]
        for engine, found in result.engines.items()
        for one in found.checked
    ]


def parameter_rows(result: Identification) -> list[list[str]]:
    """Return a row for each parameter of each fit."""
    return [
        [
            engine,
            one.name,
            parameter.path,
            f"{parameter.value:.4g}",
            f"{parameter.low:.4g} … {parameter.high:.4g}",
            f"{parameter.searched[0]:.3g} … {parameter.searched[1]:.3g}",
            ", ".join(parameter.flags),
        ]
        for engine, found in result.engines.items()
        for one in found.candidates
        for parameter in one.parameters
    ]


def pair_columns(result: Identification) -> tuple[str, ...]:
    """Return the titles of the table of engines against each other."""
    return ("engines", *(f"{name} [{unit}]" for name, unit, _ in result.quantities))


def pair_rows(result: Identification) -> list[list[str]]:
    """Return a row for each pair of engines."""
    rows = []
    for pair in result.differences:
        cells = []
        for name, _, factor in result.quantities:
            value = pair.sizes.get(name)
            text = (
                ""
                if value is None
                else f"{_signed(value.mean * factor)} [{_signed(value.low * factor)}, {_signed(value.high * factor)}]"
            )
            cells.append(text + (" differ" if value is not None and value.excludes_zero else ""))
        rows.append([f"{pair.engines[0]}, {pair.engines[1]}", *cells])
    return rows


def data_rows(result: Identification) -> list[list[str]]:
    """Return a row for each finding about the data."""
    rows = []
    for finding in result.findings:
        which = (
            f" ({', '.join(finding.recordings[:12])}{' …' if len(finding.recordings) > 12 else ''})"
            if finding.recordings
            else ""
        )
        rows.append([f"{'! ' if finding.warning else ''}{finding.what}", finding.text + which])
    rows.append(["recordings", f"{len(result.training)} to fit, {len(result.held_out)} held out"])
    return rows


def render(result: Identification) -> RenderableType:
    """Return everything as tables."""
    parts: list[RenderableType] = [
        _table(result.title, DATA_COLUMNS, data_rows(result)),
        _table(CHECK_TITLE, CHECK_COLUMNS, check_rows(result)),
        CHECK_NOTE,
        _table(PARAMETERS_TITLE, PARAMETER_COLUMNS, parameter_rows(result)),
        _table(FITS_TITLE, fit_columns(result), fit_rows(result)),
        FITS_NOTE,
    ]
    if result.differences:
        parts.append(_table(PAIRS_TITLE, pair_columns(result), pair_rows(result)))
    return Group(*parts, *problems(result))


def problems(result: Identification) -> list[str]:
    """Return a line for each engine that could not play everything."""
    some = {engine: found.problem for engine, found in result.engines.items() if found.problem}
    return [f"{engine}: {problem}" for engine, problem in {**some, **result.failed}.items()]


def figure(result: Identification) -> Figure:
    """Return the errors of each engine and fit, one panel per quantity, with the intervals of their means."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(4.2 * len(result.quantities), 0.5 + 0.75 * len(result.engines)), layout="constrained")
        axes = drawn.subplots(1, len(result.quantities), squeeze=False, sharey=True)[0]
        names = ("default", "simplest", "full")
        for axis, (quantity, unit, factor) in zip(axes, result.quantities, strict=True):
            for row, (engine, found) in enumerate(result.engines.items()):
                look = engine_appearance(engine)
                for one in found.candidates:
                    value = one.sizes.get(quantity)
                    if value is None:
                        continue
                    index = names.index(one.name)
                    mean, low, high = (factor * number for number in (value.mean, value.low, value.high))
                    place = row + 0.24 * (index - 1)
                    axis.errorbar(
                        mean,
                        place,
                        xerr=[[mean - low], [high - mean]],
                        fmt=look.marker,
                        color=look.color,
                        fillstyle=FILLS[index],
                    )
                    if one.name == found.taken:
                        axis.annotate("*", (high, place), (4, -4), textcoords="offset points", va="center")
            axis.set_xlabel(f"{quantity} off [{unit}]")
            axis.set_xlim(left=0.0)
        axes[0].set_yticks(range(len(result.engines)), list(result.engines))
        axes[0].invert_yaxis()
        marks = [Line2D([], [], color=SOFT, marker="o", ls="none", fillstyle=FILLS[i]) for i in range(len(names))]
        drawn.legend(marks, names, title="fit; * is taken", loc="outside right upper")
        drawn.suptitle(result.title)
    return drawn


def _table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title, **TABLE_STYLE)
    for name in columns:
        table.add_column(escape(name), no_wrap=name in ("engine", "fit"))
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def _spread(value: Spread | None, factor: float) -> str:
    if value is None:
        return "none could be played"
    mean, sd, low, high = (factor * number for number in (value.mean, value.sd, value.low, value.high))
    return f"{mean:.1f} ± {sd:.1f} [{low:.1f}, {high:.1f}]"


def _signed(value: float) -> str:
    return f"{value:+.2f}"
