"""Hand error against number of trials, as a table and as curves."""

from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.table import Table

from imolo.campaigns.appearance import GRID, SERIES, SOFT, Appearance, engine_appearance
from imolo.campaigns.appearance import STYLE as FIGURE_STYLE
from imolo.campaigns.summary import TABLE_STYLE
from imolo.studies.sample_efficiency import (
    ACTIVE,
    CONFIGURED,
    PAPER,
    PLAIN,
    UNDISTURBED,
    Point,
    SampleEfficiency,
    upon,
)
from imolo.studies.transfer_report import PAPER_HAND_ERROR

DODGE = 0.2  # [trials] between the points of two models
SETTINGS = (UNDISTURBED, CONFIGURED)


def backends(study: SampleEfficiency) -> list[str]:
    """Return the backends of a study."""
    return list(study.configs)


def models(study: SampleEfficiency, backend: str) -> list[str]:
    """Return the models of a backend."""
    priors = [name for name in backends(study) if name != backend]
    return [PAPER, PLAIN, ACTIVE, *(upon(name, active=active) for name in priors for active in (False, True))]


def numbers(study: SampleEfficiency) -> list[int]:
    """Return the numbers of trials, 0 for a prior alone included."""
    return sorted({point.trials for point in study.points})


def point_text(point: Point | None) -> str:
    """Return the error of a point [mm] and how honest its variance is."""
    if point is None or point.error.mean is None:
        return ""
    return f"{1e3 * point.error.mean:.1f}" + ("" if point.nees is None else f" ({point.nees:.1f})")


def render_study(study: SampleEfficiency) -> RenderableType:
    """Return a table for each setting: errors by number of trials."""
    return Group(*(_table(study, setting) for setting in SETTINGS))


def _table(study: SampleEfficiency, setting: str) -> Table:
    table = Table(
        title=f"Hand error on {study.sizes.tests} other motions [mm], and squared error over variance (1 is honest): "
        f"{setting}",
        caption=f"0: the prior as it is. Floor: hand to its mean over repetitions. The paper: "
        f"{1e3 * PAPER_HAND_ERROR:.1f} mm with 15 trials.",
        **TABLE_STYLE,
    )
    for name in ("backend", "model"):
        table.add_column(name, no_wrap=True)
    for number in numbers(study):
        table.add_column(str(number), justify="right")
    for backend in backends(study):
        for model in models(study, backend):
            found = {point.trials: point for point in study.curve(backend, setting, model)}
            table.add_row(backend, model, *(point_text(found.get(number)) for number in numbers(study)))
        table.add_row(backend, "floor", f"{1e3 * (study.floor(backend, setting) or 0.0):.1f}", style="dim")
        table.add_section()
    return table


def draw_study(study: SampleEfficiency) -> Figure:
    """Draw the curves: a column for each backend, a row for each setting."""
    with mpl.rc_context(FIGURE_STYLE):
        names = backends(study)
        figure = Figure(figsize=(3.0 * len(names) + 0.6, 6.4), layout="constrained")
        panels = figure.subplots(2, len(names), squeeze=False, sharex=True, sharey=True)
        handles: dict[str, Artist] = {}
        for row, setting in zip(panels, SETTINGS, strict=True):
            for axes, name in zip(row, names, strict=True):
                handles |= _draw(axes, study, name, setting)
            row[0].set_ylabel(f"{setting}\nhand error [mm]")
        for axes, name in zip(panels[0], names, strict=True):
            axes.set_title(f"trials in {name}")
        for axes in panels[-1]:
            axes.set_xlabel("trials")
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=5)
    return figure


def _draw(axes: Axes, study: SampleEfficiency, backend: str, setting: str) -> dict[str, Artist]:
    handles: dict[str, Artist] = {}
    shown = models(study, backend)
    looks = {PAPER: SERIES[2], PLAIN: SERIES[0], ACTIVE: SERIES[0]}
    for name in backends(study):
        looks |= dict.fromkeys((upon(name), upon(name, active=True)), engine_appearance(name))
    for number, model in enumerate(shown):
        points = study.curve(backend, setting, model)
        errors = [1e3 * (point.error.mean or 0.0) for point in points]
        # Side by side, since many curves lie on each other.
        beside = DODGE * (number - 0.5 * (len(shown) - 1))
        line = _line(looks[model], active=model.endswith("active"))
        (handles[model],) = axes.plot([point.trials + beside for point in points], errors, **line)
    handles["floor"] = axes.axhspan(0.0, 1e3 * (study.floor(backend, setting) or 0.0), color=GRID, lw=0)
    handles["paper's robot"] = axes.axhline(1e3 * PAPER_HAND_ERROR, color=SOFT, lw=1.0, ls=(0, (1, 2)))
    axes.set_yscale("log")
    axes.set_ylim(2.0, 400.0)
    return handles


def _line(look: Appearance, *, active: bool) -> dict[str, Any]:
    """Return how a model is drawn; open where it chose its trials itself."""
    return look.style(markersize=4.5, linewidth=0.8 if active else 1.2, fillstyle="none" if active else "full")
