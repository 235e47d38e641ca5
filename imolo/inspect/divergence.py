"""How two runs go apart over time: joint angles, hand, ball and pressures."""

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from imolo.campaigns.figures import COLORS, STYLE
from imolo.errors import FieldError
from imolo.inspect.diff import Difference
from imolo.inspect.fields import parse_selector, series
from imolo.inspect.plot import short_names
from imolo.messaging.log import Log

Array = NDArray[np.float64]

# Title, field, factor to the unit shown, unit, whether the length of the difference is drawn in place of its elements.
PANELS = (
    ("joint angles", "TRUTH_ROBOT.joint_angle", float(np.degrees(1.0)), "°", False),
    ("right hand", "TRUTH_ROBOT.effector_position[0]", 1e3, "mm", True),
    ("ball", "TRUTH_BALL.true_ball_position", 1e3, "mm", True),
    ("pressures", "ACTUATOR_STATE.measured", 1e-3, "kPa", False),
)
FLOOR = 1e-6  # smallest difference drawn, in the units shown


def draw_divergence(first: Log, second: Log, parting: Difference | None) -> Figure:
    """Draw what lies between two runs on logarithmic axes, with the moment at which they part.

    Raises:
        FieldError: The runs have no time or none of the channels in common.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9, 8), layout="constrained")
        drawn = 0
        for axes, (title, field, factor, unit, length) in zip(
            figure.subplots(len(PANELS), 1, sharex=True), PANELS, strict=True
        ):
            axes.set_title(title, loc="left")
            axes.set_ylabel(f"difference [{unit}]")
            gap = difference_over_time(first, second, field)
            if gap is None:
                axes.text(0.5, 0.5, "not in both logs", transform=axes.transAxes, ha="center", color="#9A9A9A")
                continue
            drawn += 1
            time, values = gap
            values = np.linalg.norm(values, axis=1, keepdims=True) if length else np.abs(values)
            for column in range(values.shape[1]):
                label = f"[{column}]" if not length else ""
                dashes = "-" if column < len(COLORS) else "--"
                shown = np.where(factor * values[:, column] >= FLOOR, factor * values[:, column], np.nan)
                axes.plot(time, shown, dashes, color=COLORS[column % len(COLORS)], label=label, linewidth=1.0)
            axes.set_xlim(time[0], time[-1])
            axes.set_yscale("log")
            if not length:
                axes.legend(ncols=2, fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))
            if parting is not None:
                axes.axvline(parting.utime * 1e-6, color="#9A9A9A", linewidth=0.8)
        axes.set_xlabel("time [s]")
        if drawn == 0:
            raise FieldError(f"{first.path} and {second.path} have no simulated state and no pressures to compare")
        names = short_names([first.path, second.path])
        where = "" if parting is None else f"\nthey part at {parting}"
        figure.suptitle(f"{names[0]} against {names[1]}{where}", fontsize="medium")
    return figure


def difference_over_time(first: Log, second: Log, field: str) -> tuple[Array, Array] | None:
    """Return time [s], shape (N,), and second minus first at those times, shape (N, K), where both have the field.

    The second run is interpolated at the times of the first one.
    """
    selector = parse_selector(field)
    if not first.messages[selector.channel] or not second.messages[selector.channel]:
        return None
    one, other = series(first, selector), series(second, selector)
    common = (one.time >= other.time[0]) & (one.time <= other.time[-1])
    if not common.any():
        return None
    time = one.time[common]
    moved = np.column_stack([np.interp(time, other.time, column) for column in other.values.T])
    return time, moved - one.values[common]
