"""Fields of logs over time, as a figure."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imolo.campaigns.figures import COLORS, STYLE
from imolo.errors import ResultsError
from imolo.inspect.fields import Selector, series
from imolo.messaging.log import Log

LINES = ("-", "--", ":", "-.")  # one for each log; the colour is the element of the field
MANY = 8  # columns of a field beyond which a legend says less than nothing


def draw_fields(logs: Sequence[Log], selectors: Sequence[Selector]) -> Figure:
    """Draw each field in its own axes, the logs over each other.

    Raises:
        FieldError: A channel is silent in a log.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9, 1.2 + 2.1 * len(selectors)), layout="constrained")
        grid = figure.subplots(len(selectors), 1, squeeze=False, sharex=True)[:, 0]
        for axes, selector in zip(grid, selectors, strict=True):
            _draw_field(axes, logs, selector)
        grid[-1].set_xlabel("time [s]")
        if len(logs) == 1:
            figure.suptitle(str(logs[0].path), fontsize="medium")
    return figure


def _draw_field(axes: Axes, logs: Sequence[Log], selector: Selector) -> None:
    names = short_names([log.path for log in logs])
    several = False
    for log, name, line in zip(logs, names, (LINES * len(logs))[: len(logs)], strict=True):
        found = series(log, selector)
        several = several or len(found.labels) > 1
        for column, label in enumerate(found.labels):
            element = label.removeprefix(selector.channel + ".") if len(found.labels) > 1 else ""
            text = " ".join(part for part in (element, name if len(logs) > 1 else "") if part)
            color = COLORS[column % len(COLORS)] if len(found.labels) > 1 else COLORS[names.index(name) % len(COLORS)]
            # A single message is a point, and a line of one point is invisible.
            marker = "." if len(found.time) < 2 else ""
            axes.plot(found.time, found.values[:, column], line, marker=marker, color=color, label=text, linewidth=1.1)
    axes.set_title(selector.text, loc="left")
    axes.set_ylabel(f"[{selector.unit}]" if selector.unit else "")
    count = len(axes.lines)
    if 1 < count <= MANY * len(logs):
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")


def short_names(paths: Sequence[Path]) -> list[str]:
    """Return the parts of paths in which they differ; the file name where they do not."""
    parts = [path.with_suffix("").parts for path in paths]
    if len(set(parts)) < 2:
        return [path.stem for path in paths]
    width = min(map(len, parts))
    first = next((i for i in range(width) if len({p[i] for p in parts}) > 1), width)
    last = next((i for i in range(1, width - first + 1) if len({p[-i] for p in parts}) > 1), 1)
    return ["/".join(p[first : len(p) - last + 1]) or path.stem for p, path in zip(parts, paths, strict=True)]


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure; the ending of the file says how.

    Raises:
        ResultsError: The file cannot be written, or its ending names no format.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, bbox_inches="tight", facecolor="white")
    except (OSError, ValueError) as error:
        raise ResultsError(f"cannot write the figure {path}: {error}") from error


def show_figure(figure: Figure) -> None:
    """Open a figure in a window and wait until it is closed.

    Raises:
        ResultsError: There is no display.
    """
    import matplotlib.pyplot as plt

    if mpl.get_backend().lower() == "agg":
        raise ResultsError("there is no display to open a window on; write a file with --out plot.png")
    window = plt.figure(figsize=figure.get_size_inches())
    manager = window.canvas.manager
    # A figure that was made without a window takes the place of the empty one that has it.
    window.canvas.figure = figure
    figure.set_canvas(window.canvas)
    if manager is not None:
        manager.canvas.draw()
    plt.show()
