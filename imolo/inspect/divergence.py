"""How two runs go apart over time: joint angles, hand, ball and pressures."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imolo.campaigns.appearance import FAINT, INK, STYLE, element_colors, shown_unit
from imolo.command_line.terminal import plain
from imolo.errors import FieldError
from imolo.inspect.diff import Difference
from imolo.inspect.fields import parse_selector
from imolo.inspect.plot import short_names
from imolo.inspect.series import Array, Series, read_series, samples


class Panel(NamedTuple):
    """One of the axes, or one for each unit of its elements where it is not the length of the difference."""

    title: str
    field: str
    length: bool
    titles: Mapping[str, str] = {}  # of elements with this unit


PANELS = (
    Panel("joints", "TRUTH_ROBOT.joint_angle", False, {"rad": "joint angles", "m": "ways of joints"}),
    Panel("hand", "TRUTH_ROBOT.effector_position", True),
    Panel("ball", "TRUTH_BALL.true_ball_position", True),
    Panel("actuators", "ACTUATOR_STATE.measured", False, {"Pa": "pressures"}),
)
PLANNED = "PLAN.effector"
HAND = 1  # of the panels
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
    selectors = [parse_selector(field) for field in (*(panel.field for panel in PANELS), PLANNED)]
    runs = [
        read_series(path, selectors, trial, only_one=True, required=False, thin=samples, quiet=True)
        for path, trial in zip((first, second), trials, strict=True)
    ]
    *gaps, _ = [difference_over_time(one, other) for one, other in zip(*runs, strict=True)]
    hand, gaps[HAND] = _that_hits(gaps[HAND], runs[0][-1])
    if all(gap is None for gap in gaps):
        raise FieldError(f"{first} and {second} have no simulated state and no pressures to compare")
    with mpl.rc_context(STYLE):
        panels = [pair for panel, gap in zip(PANELS, gaps, strict=True) for pair in _by_unit(panel, gap)]
        figure = Figure(figsize=(9, 2 * len(panels)), layout="constrained")
        for axes, (panel, gap) in zip(figure.subplots(len(panels), 1, sharex=True), panels, strict=True):
            _draw_gap(axes, panel, gap)
            axes.set_title(hand if panel is PANELS[HAND] else panel.title, loc="left")
            if gap is not None and parting is not None:
                axes.axvline(parting.utime * 1e-6, color=FAINT, linewidth=0.8)
        axes.set_xlabel("time [s]")
        names = short_names([first, second])
        where = "they are identical" if parting is None else f"they part at {parting}"
        figure.suptitle(plain(f"{names[1]} less {names[0]}") + f"\n{plain(where)}", fontsize="medium", parse_math=False)
    return figure


def _that_hits(gap: Series | None, planned: Series) -> tuple[str, Series | None]:
    """Return the name of the effector that was to hit, the first where none was, and how its positions differ."""
    if gap is None:
        return PANELS[HAND].title, None
    names = [label.removeprefix(PANELS[HAND].field)[1:].split("]")[0] for label in gap.labels]
    known = list(dict.fromkeys(names))
    chosen = planned.values[planned.values >= 0.0][-1:].astype(int).tolist()
    name = known[chosen[0]] if chosen and chosen[0] < len(known) else known[0]
    own = [column for column, other in enumerate(names) if other == name]
    shown = name.replace("_", " ") if not name.isdigit() else f"effector {name}"
    return shown, _columns(gap, own)


def _columns(gap: Series, chosen: Sequence[int]) -> Series:
    labels, units = ([found[column] for column in chosen] for found in (gap.labels, gap.units))
    return Series(gap.time, gap.values[:, chosen], tuple(labels), tuple(units))


def _by_unit(panel: Panel, gap: Series | None) -> Iterator[tuple[Panel, Series | None]]:
    if gap is None or panel.length:
        yield panel, gap
        return
    for unit in dict.fromkeys(gap.units):
        own = [column for column, other in enumerate(gap.units) if other == unit]
        yield panel._replace(title=panel.titles.get(unit, panel.title)), _columns(gap, own)


def _draw_gap(axes: Axes, panel: Panel, gap: Series | None) -> None:
    if gap is None:
        axes.text(0.5, 0.5, "not in both logs", transform=axes.transAxes, ha="center", color=FAINT)
        return
    unit, factor = shown_unit(gap.unit)
    axes.set_ylabel(f"difference [{unit}]" if unit else "difference")
    values = factor * (np.linalg.norm(gap.values, axis=1, keepdims=True) if panel.length else gap.values)
    least = logarithmic_from(np.abs(values))
    if least is not None:
        values = np.abs(values)
        axes.set_yscale("log")
    colors = [INK] if panel.length else element_colors(values.shape[1])
    for column, color in enumerate(colors):
        axes.plot(
            gap.time,
            values[:, column] if least is None else np.where(values[:, column] >= FLOOR, values[:, column], np.nan),
            "-" if column % 2 == 0 else "--",
            color=color,
            label="" if panel.length else _spoken(gap.labels[column].removeprefix(panel.field)),
            linewidth=1.0,
        )
    if least is not None:
        axes.set_ylim(bottom=least)
    if gap.time[-1] > gap.time[0]:
        axes.set_xlim(gap.time[0], gap.time[-1])
    if not panel.length:
        axes.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))


def _spoken(index: str) -> str:
    return index.strip("[]").replace("_", " ")


def logarithmic_from(sizes: Array) -> float | None:
    """Return where a logarithmic axis begins that shows how a difference grows; None where a linear one says more.

    A logarithm says nothing of zeros, little within a decade, and nothing of a difference that comes and goes: the
    largest so far has to grow after the first tenth of the time in which there is one, and to be there in the last.

    Args:
        sizes: Of the differences, in the units shown, shape (N, K).
    """
    size = np.nan_to_num(sizes).max(axis=1, initial=0.0)
    begun = int(np.argmax(size >= FLOOR))
    tenth = (len(size) - begun) // 10
    early, late = float(size[: begun + tenth + 1].max()), float(size[-tenth - 1 :].max())
    if early < FLOOR or late <= 10.0 * early or 3.0 * late < size.max():
        return None
    return max(FLOOR, 0.03 * early)


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
    units = dict(zip(first.labels, first.units, strict=False))
    return Series(time, np.column_stack(gaps), labels, tuple(units.get(label, "") for label in labels))
