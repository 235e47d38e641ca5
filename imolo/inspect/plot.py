"""Fields of logs over time, as a figure."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imolo.campaigns.appearance import STYLE, appearances, element_colors, write_figure
from imolo.command_line.terminal import plain
from imolo.errors import ResultsError
from imolo.inspect.fields import Selector
from imolo.inspect.series import Series, read_series
from imolo.messaging.log import LOG_SUFFIX

MANY = 8  # columns of a field beyond which a legend says less than nothing


def draw_fields(paths: Sequence[Path], selectors: Sequence[Selector], trial: int | None = None) -> Figure:
    """Draw each field in its own axes, the logs over each other.

    Args:
        paths: Of the logs.
        selectors: The fields.
        trial: Which trial of the logs, from 0; None for all, one after the other.

    Raises:
        BusError: A log cannot be read, or has no such trial.
        FieldError: A channel is silent in a log.
    """
    logs = [read_series(path, selectors, trial) for path in paths]
    # A dollar sign in a name is no formula.
    with mpl.rc_context({**STYLE, "text.parse_math": False}):
        figure = Figure(figsize=(9, 1.2 + 2.1 * len(selectors)), layout="constrained")
        grid = figure.subplots(len(selectors), 1, squeeze=False, sharex=True)[:, 0]
        for number, (axes, selector) in enumerate(zip(grid, selectors, strict=True)):
            _draw_field(axes, short_names(paths), [log[number] for log in logs], selector)
        grid[-1].set_xlabel("time [s]")
        if len(paths) == 1:
            figure.suptitle(plain(str(paths[0])), fontsize="medium")
    return figure


def _draw_field(axes: Axes, names: Sequence[str], logs: Sequence[Series], selector: Selector) -> None:
    looks = appearances([found.backend for found in logs])
    # Ever thinner lines, since runs may all but lie on each other.
    widths = np.linspace(1.1 + 0.9 * (len(logs) - 1), 1.1, len(logs))
    for look, width, name, found in zip(looks, widths, names, logs, strict=True):
        several = len(found.labels) > 1
        # The colour is the engine, or the element where there are many; then the line alone tells the engine.
        colors = element_colors(len(found.labels)) if several else [look.color]
        for column, label in enumerate(found.labels):
            element = label.removeprefix(selector.channel + ".") if several else ""
            text = " ".join(part for part in (element, name if len(logs) > 1 else "") if part)
            # A single message is a point, and a line of one point is invisible.
            marker = "." if len(found.time) < 2 else ""
            axes.plot(
                found.time,
                found.values[:, column],
                linestyle=look.line if len(logs) > 1 else "-",
                marker=marker,
                color=colors[column],
                label=text,
                linewidth=width,
                alpha=1.0 if width == widths[-1] else 0.45,
            )
    axes.set_title(selector.text, loc="left")
    unit = logs[0].unit
    axes.set_ylabel(f"[{unit}]" if unit else "")
    count = len(axes.lines)
    if 1 < count <= MANY * len(logs):
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")


def log_name(path: Path) -> str:
    """Return the name of a log without our ending; others, as of a log that lcm-logger split, are part of it."""
    return path.name.removesuffix(LOG_SUFFIX) or path.name


def short_names(paths: Sequence[Path]) -> list[str]:
    """Return the parts of paths in which they differ; the file name where they do not."""
    parts = [(*path.parts[:-1], log_name(path)) for path in paths]
    if len(set(parts)) < len(set(paths)):
        parts = [path.parts for path in paths]
    if len(set(parts)) < 2:
        return [plain(log_name(path)) for path in paths]
    width = min(map(len, parts))
    first = next((i for i in range(width) if len({p[i] for p in parts}) > 1), width)
    last = next((i for i in range(1, width - first + 1) if len({p[-i] for p in parts}) > 1), 1)
    names = [str(Path(*(p[first : len(p) - last + 1] or p[-1:]))) for p in parts]
    distinct = len(set(names)) == len(set(parts))
    return [plain(name if distinct else str(path)) for name, path in zip(names, paths, strict=True)]


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure; the ending of the file says how.

    Raises:
        ResultsError: The file cannot be written, or its ending names no format.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_figure(figure, path, path.suffix[1:])
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
