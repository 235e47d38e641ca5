"""The figures of a comparison, drawn from its logs and tables."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from imolo.campaigns.campaign import hit_tasks, learning_tasks
from imolo.campaigns.comparison import Comparison
from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of, task_plugin
from imolo.contracts.actuators import Channel
from imolo.contracts.registry import ROBOTS
from imolo.contracts.trial import EventName
from imolo.messaging import channels
from imolo.messaging.log import Log, read_log
from imolo.method.commands import Commands
from imolo.method.table import LookupTable
from imolo.trials.recordings import SHOWN, last_plan, marker_track

Array = NDArray[np.float64]

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito, safe for colour-blind
HIT_COLOR, MISS_COLOR, TRAINING_COLOR = "#D62728", "#9A9A9A", "#1F77B4"
STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "figure.dpi": 150,
}


def draw_all(comparison: Comparison, configs: Sequence[ExperimentConfig], folder: ResultsFolder) -> list[Path]:
    """Draw every figure of a comparison, for its last method where it shows one, and return the files."""
    method = list(configs[0].methods)[-1]
    named = {config.backend.name: config for config in configs}
    drawings = {
        "trajectories": draw_trajectories(named, folder, method),
        "pressures": draw_pressures(named, folder),
        "reach": draw_reach(named, folder, method),
        "hit_rates": draw_hit_rates(comparison, configs[0]),
    }
    return [folder.save_figure(f"{name}.png", figure) for name, figure in drawings.items()]


def draw_trajectories(named: dict[str, ExperimentConfig], folder: ResultsFolder, method: str) -> Figure:
    """Draw ball and hand until the ball was hit, by backend, as Fig. 8(b)."""
    hand = body_of(next(iter(named.values())).robot).effectors[0].name.replace("_", " ")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 3.1 * len(named)), layout="constrained")
        grid = figure.subplots(len(named), 3, squeeze=False, width_ratios=(1.9, 1.2, 0.9), sharex="col", sharey="row")
        for row, (name, config) in zip(grid, named.items(), strict=True):
            training = _table(config, folder, method).training.position
            tasks = hit_tasks(config, folder.hits(name, method), method, Path())
            logs = [read_log(task.log_path, (*SHOWN, channels.BALL_STATE)) for task in tasks]
            _draw_paths(row, logs, config, training)
            row[0].set_ylabel(f"{name}\nz [m]")
        for axes, title in zip(grid[0], ("ball, side view", f"{hand}, side view", f"{hand}, from behind"), strict=True):
            axes.set_title(title)
        for axes, label in zip(grid[-1], ("x [m]", "x [m]", "y [m]"), strict=True):
            axes.set_xlabel(label)
        grid[0][2].invert_xaxis()
        _legend(grid[0][0])
        figure.suptitle(f"Ball and {hand} before they met, method {method!r} (compare the paper's Fig. 8b)")
    return figure


def _draw_paths(row: Sequence[Axes], logs: Sequence[Log], config: ExperimentConfig, training: Array) -> None:
    row[1].plot(training[:, 0], training[:, 2], ".", ms=2.5, color=TRAINING_COLOR)
    row[2].plot(training[:, 1], training[:, 2], ".", ms=2.5, color=TRAINING_COLOR)
    for log in logs:
        times = {event.event: event.utime * 1e-6 for event in log.messages[channels.TRIAL]}
        plan = last_plan(log)
        hit = times.get(EventName.TOUCH) if plan is not None else None
        end = hit if hit is not None else times.get(EventName.BALL_LANDED, np.inf)
        color = MISS_COLOR if hit is None else "#333333"
        states = [s for s in log.messages[channels.BALL_STATE] if s.utime * 1e-6 <= end]
        ball = np.array([s.ball_position for s in states]).reshape(-1, 3)
        row[0].plot(ball[:, 0], ball[:, 2], "-", lw=0.7, color=color, alpha=0.8)
        if hit is None or plan is None:
            continue
        row[0].plot(*ball[-1, [0, 2]], "o", ms=4.5, mec=HIT_COLOR, mfc="none")
        time, hand = marker_track(log, body_of(config.robot).learning_marker)
        moving = (time >= plan.plan_onset_utime * 1e-6) & (time <= hit)
        hand = hand[moving]
        for axes, pair in ((row[1], [0, 2]), (row[2], [1, 2])):
            axes.plot(*hand[:, pair].T, "-", lw=0.7, color=color, alpha=0.8)
            axes.plot(*hand[-1, pair], "o", ms=4.5, mec=HIT_COLOR, mfc="none")


def _legend(axes: Axes) -> None:
    axes.plot([], [], "-", color="#333333", lw=0.9, label="hit")
    axes.plot([], [], "-", color=MISS_COLOR, lw=0.9, label="missed")
    axes.plot([], [], "o", ms=4.5, mec=HIT_COLOR, mfc="none", ls="none", label="at the hit")
    axes.plot([], [], ".", color=TRAINING_COLOR, label="training")
    axes.legend(loc="lower right", ncols=2, fontsize=8)


def draw_pressures(named: dict[str, ExperimentConfig], folder: ResultsFolder) -> Figure:
    """Draw target and measurement of every actuator channel in the last training motion on every backend."""
    first = next(iter(named.values()))
    valves = first.simulation.actuators.channels
    scale, unit = (1e-6, "gauge pressure [MPa]") if valves[0].unit == "Pa" else (1.0, f"[{valves[0].unit}]")
    columns = min(4, len(valves))
    rows = -(-len(valves) // columns)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(2.75 * columns, 2.3 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes in grid.ravel()[len(valves) :]:
            axes.set_axis_off()
        # Ever thinner lines, since the engines' pressures all but lie on each other.
        widths = np.linspace(3.4, 0.9, len(named))
        for color, width, (name, config) in zip(COLORS, widths, named.items(), strict=False):
            log = read_log(learning_tasks(config, folder.learning(name))[-1].log_path)
            commands = Commands.from_message(log.messages[channels.ACTUATOR_COMMAND][-1], valves)
            _draw_channels(grid.ravel().tolist(), valves, scale, log, commands, color=color, lw=width, label=name)
        theta = first.training.motions[-1]
        grid[-1, min(1, columns - 1)].legend(fontsize=8)
        for axes in grid[-1]:
            axes.set_xlabel("time since onset [s]")
        for axes in grid[:, 0]:
            axes.set_ylabel(unit)
        figure.suptitle(f"What the actuators measured, {first.motion.label(theta)}; dashed: target")
    return figure


def _draw_channels(
    panels: Sequence[Axes], names: Sequence[Channel], scale: float, log: Log, commands: Commands, **line: Any
) -> None:
    messages = log.messages[channels.ACTUATOR_STATE]
    time = np.array([m.utime for m in messages])
    pressure = np.array([m.measured for m in messages]) * scale
    since = (time - commands.onset_utime) * 1e-6
    shown = since >= -0.05
    nothing = np.full(len(names), np.nan)
    target = np.array([nothing if (t := commands.target(int(u))) is None else t for u in time]) * scale
    for valve, (name, axes) in enumerate(zip(names, panels, strict=False)):
        axes.plot(since[shown], pressure[shown, valve], **line)
        axes.plot(since[shown], target[shown, valve], color="#333333", lw=0.5, ls="--")
        axes.set_title(name.name, fontsize=8.5)


def _table(config: ExperimentConfig, folder: ResultsFolder, method: str) -> LookupTable:
    return LookupTable.load(folder.table(config.backend.name, method), motion=type(config.motion))


def draw_reach(named: dict[str, ExperimentConfig], folder: ResultsFolder, method: str) -> Figure:
    """Draw where the table can bring the effector, coloured by the last and the first parameter."""
    config = next(iter(named.values()))
    parameters = config.motion.parameters
    hand = body_of(config.robot).effectors[0].name.replace("_", " ")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.6 * len(named) + 1, 6.4), layout="constrained")
        grid = figure.subplots(2, len(named), squeeze=False, sharex="row", sharey="row")
        for column, name in zip(grid.T, named, strict=True):
            table = _table(named[name], folder, method)
            side = _scatter_seen(column[0], table, (0, 2), table.theta[:, -1], "viridis")
            behind = _scatter_seen(column[1], table, (1, 2), table.theta[:, 0], "coolwarm")
            column[0].set_title(f"{name}: {table.num_grid_points:,} grid points")
            column[0].set_xlabel("x [m]")
            column[1].set_xlabel("y [m]")
        first, *_, last = (*parameters, *parameters)
        figure.colorbar(side, ax=grid[0].tolist(), label=f"{last.name} [{last.unit}]" if last.unit else last.name)
        figure.colorbar(behind, ax=grid[1].tolist(), label=f"{first.name} [{first.unit}]" if first.unit else first.name)
        # From behind, left is left; the panels of a row share their axis.
        grid[1, 0].invert_xaxis()
        for axes in grid[:, 0]:
            axes.set_ylabel("z [m]")
        figure.suptitle(f"Where the {hand} can be, method {method!r}, by the parameters of the motion")
    return figure


def _scatter_seen(axes: Axes, table: LookupTable, plane: tuple[int, int], color: Array, cmap: str) -> PathCollection:
    """Draw of the tuples that lie behind each other the last one alone, which covers the others."""
    places = np.rint(table.position[::-1, plane] / table.grid.spacing).astype(np.int64)
    first, second = (places - places.min(axis=0)).T
    _, seen = np.unique(first * (second.max() + 1) + second, return_index=True)
    last = np.sort(len(color) - 1 - seen)
    x, y = table.position[last][:, plane].T
    return axes.scatter(x, y, c=color[last], vmin=color.min(), vmax=color.max(), s=1.5, cmap=cmap, rasterized=True)


def draw_hit_rates(comparison: Comparison, config: ExperimentConfig) -> Figure:
    """Draw the success rate of every backend and method with its Wilson 95 % interval."""
    word = task_plugin(config).success
    with mpl.rc_context(STYLE):
        methods = list(next(iter(comparison.results.values())))
        figure = Figure(figsize=(1.4 * len(comparison.results) + 3.0, 2.8), layout="constrained")
        axes = figure.subplots()
        for number, method in enumerate(methods):
            at = np.arange(len(comparison.results)) + (number - 0.5 * (len(methods) - 1)) * 0.22
            results = [by_method[method] for by_method in comparison.results.values()]
            rate = np.array([r.hits / r.balls for r in results])
            interval = np.array([r.interval for r in results])
            error = np.abs(interval.T - rate)
            axes.errorbar(at, rate, error, fmt="o", capsize=3, color=COLORS[number % len(COLORS)], label=method)
        for one in ROBOTS.load(config.robot.name).published:
            label = f"the robot itself, {one.successes}"
            axes.axhline(one.rate, color="#555555", lw=0.8, ls="--", label=label)
        axes.set_xticks(range(len(comparison.results)), list(comparison.results))
        axes.set_xlim(-0.6, len(comparison.results) - 0.4)
        axes.set_ylim(0, 1.03)
        axes.set_ylabel(f"{word} rate (Wilson 95 %)")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    return figure
