"""How two runs go apart over time: joint angles, hand, ball and pressures."""

from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imolo.campaigns.figures import COLORS, STYLE
from imolo.command_line.terminal import plain
from imolo.errors import FieldError
from imolo.inspect.diff import Difference
from imolo.inspect.fields import parse_selector
from imolo.inspect.plot import short_names
from imolo.inspect.series import Series, read_series, samples


class Panel(NamedTuple):
    """One of the axes; `length` says whether the length of the difference is drawn in place of its elements."""

    title: str
    field: str
    factor: float  # to the unit shown
    unit: str
    length: bool


PANELS = (
    Panel("joint angles", "TRUTH_ROBOT.joint_angle", float(np.degrees(1.0)), "°", False),
    Panel("right hand", "TRUTH_ROBOT.effector_position[0]", 1e3, "mm", True),
    Panel("ball", "TRUTH_BALL.true_ball_position", 1e3, "mm", True),
    Panel("pressures", "ACTUATOR_STATE.measured", 1e-3, "kPa", False),
)
FAINT = "#9A9A9A"
FLOOR = 1e-6  # smallest difference drawn, in the units shown


def draw_divergence(
    first: Path, second: Path, parting: Difference | None, trials: tuple[int | None, int | None] = (None, None)
) -> Figure:
    """Draw what lies between two runs that were compared before, with the moment at which they part.

    Args:
        first: Path of a log.
        second: Path of the other one.
        parting: Their first difference; None where they are identical.
        trials: Which trial of each, from 0; None where a log holds one alone.

    Raises:
        BusError: A log cannot be read, or has no such trial.
        FieldError: The runs have no time or none of the channels in common.
    """
    selectors = [parse_selector(panel.field) for panel in PANELS]
    runs = [
        read_series(path, selectors, trial, only_one=True, required=False, thin=samples, quiet=True)
        for path, trial in zip((first, second), trials, strict=True)
    ]
    gaps = [difference_over_time(one, other) for one, other in zip(*runs, strict=True)]
    if all(gap is None for gap in gaps):
        raise FieldError(f"{first} and {second} have no simulated state and no pressures to compare")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9, 8), layout="constrained")
        for axes, panel, gap in zip(figure.subplots(len(PANELS), 1, sharex=True), PANELS, gaps, strict=True):
            _draw_gap(axes, panel, gap)
            if gap is not None and parting is not None:
                axes.axvline(parting.utime * 1e-6, color=FAINT, linewidth=0.8)
        axes.set_xlabel("time [s]")
        names = short_names([first, second])
        where = "they are identical" if parting is None else f"they part at {parting}"
        figure.suptitle(
            plain(f"{names[0]} against {names[1]}") + f"\n{plain(where)}", fontsize="medium", parse_math=False
        )
    return figure


def _draw_gap(axes: Axes, panel: Panel, gap: Series | None) -> None:
    axes.set_title(panel.title, loc="left")
    axes.set_ylabel(f"difference [{panel.unit}]")
    if gap is None:
        axes.text(0.5, 0.5, "not in both logs", transform=axes.transAxes, ha="center", color=FAINT)
        return
    values = panel.factor * (np.linalg.norm(gap.values, axis=1, keepdims=True) if panel.length else np.abs(gap.values))
    shown = values[np.isfinite(values) & (values >= FLOOR)]
    # A logarithm says nothing of zeros, and little within a decade.
    logarithmic = len(shown) > 0 and shown.max() > 10.0 * shown.min()
    for column in range(values.shape[1]):
        axes.plot(
            gap.time,
            np.where(values[:, column] >= FLOOR, values[:, column], np.nan) if logarithmic else values[:, column],
            "-" if column < len(COLORS) else "--",
            color=COLORS[column % len(COLORS)],
            label="" if panel.length else gap.labels[column].removeprefix(panel.field),
            linewidth=1.0,
        )
    if gap.time[-1] > gap.time[0]:
        axes.set_xlim(gap.time[0], gap.time[-1])
    axes.set_yscale("log" if logarithmic else "linear")
    if not panel.length:
        axes.legend(ncols=2, fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))


def difference_over_time(first: Series, second: Series) -> Series | None:
    """Return second minus first over the time and in the elements that both have; None where there is none.

    The second run is interpolated at the times of the first one.
    """
    labels = tuple(label for label in first.labels if label in second.labels)
    if not labels or not len(first.time) or not len(second.time):
        return None
    common = (first.time >= second.time[0]) & (first.time <= second.time[-1])
    if not common.any():
        return None
    time = first.time[common]
    gaps = [
        np.interp(time, second.time, second.values[:, second.labels.index(label)])
        - first.values[common, first.labels.index(label)]
        for label in labels
    ]
    return Series(time, np.column_stack(gaps), labels)
