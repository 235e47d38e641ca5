"""The figures of a comparison, drawn from its logs and tables."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from imolo.campaigns.appearance import (
    FAINT,
    FILLS,
    INK,
    PAPER,
    SOFT,
    STYLE,
    Appearance,
    Fill,
    engine_appearance,
    shown_unit,
)
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
from imolo.trials.metrics import MethodResult
from imolo.trials.recordings import SHOWN, last_plan, marker_track

Array = NDArray[np.float64]

HIT_COLOR, MISS_COLOR = INK, FAINT


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
    return [folder.save_drawing(name, figure) for name, figure in drawings.items()]


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
            _draw_paths(row, logs, config, training, engine_appearance(name).color)
            row[0].set_ylabel(f"{name}\nz [m]")
        for axes, title in zip(grid[0], ("ball, side view", f"{hand}, side view", f"{hand}, from behind"), strict=True):
            axes.set_title(title)
        for axes, label in zip(grid[-1], ("x [m]", "x [m]", "y [m]"), strict=True):
            axes.set_xlabel(label)
        grid[0][2].invert_xaxis()
        _legend(grid[0][0])
        figure.suptitle(f"Ball and {hand} before they met, method {method!r} (compare the paper's Fig. 8b)")
    return figure


def _draw_paths(
    row: Sequence[Axes], logs: Sequence[Log], config: ExperimentConfig, training: Array, engine_color: str
) -> None:
    for axes, pair in ((row[1], [0, 2]), (row[2], [1, 2])):
        axes.plot(*training[:, pair].T, ".", ms=2.0, color=FAINT)
    for log in logs:
        times = {event.event: event.utime * 1e-6 for event in log.messages[channels.TRIAL]}
        plan = last_plan(log)
        hit = times.get(EventName.TOUCH) if plan is not None else None
        end = hit if hit is not None else times.get(EventName.BALL_LANDED, np.inf)
        color, line, width = (MISS_COLOR, (0, (4, 2)), 0.8) if hit is None else (engine_color, "-", 1.0)
        states = [s for s in log.messages[channels.BALL_STATE] if s.utime * 1e-6 <= end]
        ball = np.array([s.ball_position for s in states]).reshape(-1, 3)
        row[0].plot(ball[:, 0], ball[:, 2], ls=line, lw=width, color=color)
        if hit is None or plan is None:
            continue
        row[0].plot(*ball[-1, [0, 2]], "o", ms=4.0, mec=HIT_COLOR, mew=0.9, mfc=PAPER)
        time, hand = marker_track(log, body_of(config.robot).learning_marker)
        moving = (time >= plan.plan_onset_utime * 1e-6) & (time <= hit)
        hand = hand[moving]
        for axes, pair in ((row[1], [0, 2]), (row[2], [1, 2])):
            axes.plot(*hand[:, pair].T, ls=line, lw=width, color=color)
            axes.plot(*hand[-1, pair], "o", ms=4.0, mec=HIT_COLOR, mew=0.9, mfc=PAPER)


def _legend(axes: Axes) -> None:
    axes.plot([], [], "-", color=SOFT, lw=1.0, label="hit, in the engine's colour")
    axes.plot([], [], color=MISS_COLOR, lw=0.8, ls=(0, (4, 2)), label="missed")
    axes.plot([], [], "o", ms=4.0, mec=HIT_COLOR, mew=0.9, mfc=PAPER, ls="none", label="at the hit")
    axes.plot([], [], ".", color=FAINT, ls="none", label="training")
    axes.legend(loc="lower right", ncols=2)


def draw_pressures(named: dict[str, ExperimentConfig], folder: ResultsFolder) -> Figure:
    """Draw every actuator channel in the last training motion: what was measured and, below, how the engines differ."""
    (reference, first), *others = named.items()
    valves = first.simulation.actuators.channels
    columns = min(4, len(valves))
    rows = -(-len(valves) // columns)
    heights = (1.0, 0.8) if others else (1.0,)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(2.75 * columns, (2.9 if others else 2.0) * rows), layout="constrained")
        grid = figure.subplots(rows * len(heights), columns, sharex=True, squeeze=False, height_ratios=heights * rows)
        measured, gaps = grid[:: len(heights)].ravel().tolist(), grid[1::2].ravel().tolist()
        for axes in (*measured[len(valves) :], *gaps[len(valves) :]):
            axes.set_axis_off()
        units = [shown_unit(channel.unit)[0] for channel in valves]
        theirs = {name: _measured(config, folder) for name, config in named.items()}
        _draw_measured(measured, valves, reference, *theirs[reference])
        for name, _ in others:
            _draw_gaps(gaps, valves, name, theirs[reference], theirs[name])
        for unit in set(units):
            _share_limits([axes for axes, own in zip(measured, units, strict=False) if own == unit])
            _share_limits([axes for axes, own in zip(gaps, units, strict=False) if own == unit])
        for axes in grid[-1]:
            axes.set_xlabel("time since onset [s]")
        for number, unit in enumerate(units):
            if number % columns == 0 or unit != units[number - 1]:
                measured[number].set_ylabel(f"{reference} [{unit}]")
                if others:
                    gaps[number].set_ylabel(f"others less\n{reference} [{unit}]")
        lines = [
            line for axes in (measured[0], *gaps[:1]) for line in axes.lines if not line.get_label().startswith("_")
        ]
        figure.legend(handles=lines, loc="outside lower center", ncols=len(lines))
        figure.suptitle(f"What the actuators measured, {first.motion.label(first.training.motions[-1])}")
    return figure


def _measured(config: ExperimentConfig, folder: ResultsFolder) -> tuple[Array, Array, Array]:
    """Return time since the onset [s], shape (N,), and what was measured and asked for, shape (N, channels)."""
    valves = config.simulation.actuators.channels
    scale = np.array([shown_unit(channel.unit)[1] for channel in valves])
    log = read_log(learning_tasks(config, folder.learning(config.backend.name))[-1].log_path)
    commands = Commands.from_message(log.messages[channels.ACTUATOR_COMMAND][-1], valves)
    messages = log.messages[channels.ACTUATOR_STATE]
    time = np.array([message.utime for message in messages])
    nothing = np.full(len(valves), np.nan)
    target = np.array([nothing if (t := commands.target(int(u))) is None else t for u in time]) * scale
    since = (time - commands.onset_utime) * 1e-6
    shown = since >= -0.05
    return since[shown], np.array([message.measured for message in messages])[shown] * scale, target[shown]


def _draw_measured(
    panels: Sequence[Axes], valves: Sequence[Channel], name: str, time: Array, measured: Array, target: Array
) -> None:
    for valve, (channel, axes) in enumerate(zip(valves, panels, strict=False)):
        axes.plot(time, measured[:, valve], color=engine_appearance(name).color, lw=1.4, label=name)
        axes.plot(time, target[:, valve], color=INK, lw=0.7, ls=(0, (4, 2)), label="target")
        axes.set_title(channel.name, fontsize=8.5)


def _draw_gaps(
    panels: Sequence[Axes],
    valves: Sequence[Channel],
    name: str,
    reference: tuple[Array, Array, Array],
    other: tuple[Array, Array, Array],
) -> None:
    time = reference[0][(reference[0] >= other[0][0]) & (reference[0] <= other[0][-1])]
    look = engine_appearance(name)
    for valve, axes in zip(range(len(valves)), panels, strict=False):
        values = [np.interp(time, since, measured[:, valve]) for since, measured, _ in (reference, other)]
        axes.plot(time, values[1] - values[0], color=look.color, ls=look.line, lw=0.9, label=name)


def _share_limits(panels: Sequence[Axes]) -> None:
    limits = [axes.get_ylim() for axes in panels]
    for axes in panels:
        axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))


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
            behind = _scatter_seen(column[1], table, (1, 2), table.theta[:, 0], "cividis")
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
        figure = Figure(figsize=(1.4 * len(comparison.results) + 3.2, 2.8), layout="constrained")
        axes = figure.subplots()
        for number, method in enumerate(methods):
            fill = FILLS[number % len(FILLS)] if number < len(methods) - 1 else "full"
            shift = (number - 0.5 * (len(methods) - 1)) * 0.22
            for place, (name, by_method) in enumerate(comparison.results.items()):
                _draw_rate(axes, place + shift, by_method[method], engine_appearance(name), fill)
            axes.plot([], [], "o", color=SOFT, fillstyle=fill, ls="none", label=method)
        for one in ROBOTS.load(config.robot.name).published:
            label = f"the robot itself, {one.successes}"
            axes.axhline(one.rate, color=SOFT, lw=0.8, ls="--", label=label)
        axes.set_xticks(range(len(comparison.results)), list(comparison.results))
        axes.set_xlim(-0.6, len(comparison.results) - 0.4)
        axes.set_ylim(0, 1.03)
        axes.set_ylabel(f"{word} rate (Wilson 95 %)")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _draw_rate(axes: Axes, place: float, result: MethodResult, look: Appearance, fill: Fill) -> None:
    rate = result.hits / result.balls
    low, high = result.interval
    error = ([max(rate - low, 0.0)], [max(high - rate, 0.0)])
    axes.errorbar(place, rate, error, fmt=look.marker, ms=6.5, capsize=3, color=look.color, fillstyle=fill)
