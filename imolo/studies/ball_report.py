"""The rating of ball models as a table and a figure."""

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table

from imolo.ball.evaluation import PROTOCOLS, Evaluation, Rating
from imolo.campaigns.appearance import INK, SERIES
from imolo.campaigns.appearance import STYLE as FIGURE_STYLE
from imolo.campaigns.summary import TABLE_STYLE

MODEL_LOOKS = dict(zip(("spin", "drag", "linear"), SERIES, strict=False))
MODEL_NAMES = {"linear": "linear (paper)", "drag": "drag", "spin": "drag and lift"}
MOST_NAMED = 5  # of the flights that were left out; ball.json names all


def render_evaluation(evaluation: Evaluation) -> RenderableType:
    """Return a table for each protocol, and the flights that could not be used."""
    parts: list[RenderableType] = [_table(evaluation, protocol) for protocol in PROTOCOLS]
    for name, reason in list(evaluation.left_out.items())[:MOST_NAMED]:
        parts.append(f"flight {escape(name)} left out: {escape(reason)}")
    if len(evaluation.left_out) > MOST_NAMED:
        parts.append(f"... and {len(evaluation.left_out) - MOST_NAMED} more, see ball.json")
    return Group(*parts)


def _table(evaluation: Evaluation, protocol: str) -> Table:
    what = {
        "last point": "Last point of the flight, from all samples older than the lead time",
        "every sample": "Every sample of the flight, once some of it had been seen",
    }
    table = Table(
        title=f"{what[protocol]}; leave-one-out, {len(evaluation.flights)} flights",
        caption="NEES over its dimension is 1 for a right covariance, and 95 % lie inside the 95 % ellipsoid.",
        **TABLE_STYLE,
    )
    table.add_column("model", no_wrap=True)
    for title in ("lead s", "mean mm", "sd", "p95", "NEES/3", "inside", "n"):
        table.add_column(title, justify="right", no_wrap=True)
    previous = ""
    for rating in evaluation.ratings:
        if rating.protocol != protocol:
            continue
        if previous not in ("", rating.model):
            table.add_section()
        table.add_row(
            rating.model if rating.model != previous else "",
            f"{rating.horizon:g}",
            f"{1e3 * rating.mean:.1f}",
            f"{1e3 * rating.sd:.1f}",
            f"{1e3 * rating.quantiles[4]:.1f}",
            f"{rating.nees:.2f}",
            f"{100 * rating.inside:.0f} %",
            str(rating.count),
        )
        previous = rating.model
    return table


def draw_evaluation(evaluation: Evaluation) -> Figure:
    """Draw error and calibration against the lead time, both for the last point of each flight."""
    with mpl.rc_context(FIGURE_STYLE):
        figure = Figure(figsize=(8.0, 3.4), layout="constrained")
        error, calibration = figure.subplots(1, 2, width_ratios=(3, 2))
        for model in dict.fromkeys(rating.model for rating in evaluation.ratings):
            ratings = [r for r in evaluation.ratings if r.model == model and r.protocol == PROTOCOLS[0]]
            if not ratings:
                continue
            _draw_model(error, calibration, ratings)
        error.set(xlabel="lead time [s]", ylabel="distance to the ball [mm]", xlim=(0.0, None), ylim=(0.0, None))
        error.set_title("Error: mean, and 5 to 95 % of the flights", loc="left", fontsize=9)
        error.legend(loc="upper left")
        calibration.axhline(1.0, color=INK, linewidth=0.8, linestyle=":")
        calibration.set(xlabel="lead time [s]", ylabel="NEES / 3", yscale="log", xlim=(0.0, None))
        _include_decade(calibration)
        calibration.set_title("Calibration: 1 is right, more is too sure", loc="left", fontsize=9)
    return figure


def _draw_model(error: Axes, calibration: Axes, ratings: list[Rating]) -> None:
    model, horizons = ratings[0].model, [rating.horizon for rating in ratings]
    look = MODEL_LOOKS[model]
    low, high = ([1e3 * rating.quantiles[i] for rating in ratings] for i in (0, 4))
    error.fill_between(horizons, low, high, color=look.color, alpha=0.15, linewidth=0.0)
    means = [1e3 * rating.mean for rating in ratings]
    error.plot(horizons, means, **look.style(markersize=4, label=MODEL_NAMES[model]))
    calibration.plot(horizons, [rating.nees for rating in ratings], **look.style(markersize=4))


def _include_decade(axes: Axes) -> None:
    """Show at least 0.2 to 5, so that a calibration near 1 looks as near as it is; label 0.1, 0.2, 0.5, 1, ..."""
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.2), max(high, 5.0))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_locator(NullLocator())
