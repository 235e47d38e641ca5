"""The figures of a comparison, drawn from its logs and tables."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from imolo.campaigns.campaign import hit_tasks, learning_tasks
from imolo.campaigns.comparison import Comparison
from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ExperimentConfig
from imolo.contracts.backend import EventName
from imolo.messaging import channels
from imolo.messaging.log import Log, read_log
from imolo.method.motion import Commands
from imolo.method.table import LookupTable
from imolo.studies.attribution import Attribution
from imolo.trials.recordings import last_plan, marker_track

Array = NDArray[np.float64]

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito, safe for colour-blind
HIT_COLOR, MISS_COLOR, TRAINING_COLOR = "#D62728", "#9A9A9A", "#1F77B4"
PAPER_HIT_RATE = 0.8  # Sec. VII-C
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
        "hit_rates": draw_hit_rates(comparison),
    }
    return [folder.save_figure(f"{name}.png", figure) for name, figure in drawings.items()]


def draw_trajectories(named: dict[str, ExperimentConfig], folder: ResultsFolder, method: str) -> Figure:
    """Draw ball and hand until the ball was hit, by backend, as Fig. 8(b)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 3.1 * len(named)), layout="constrained")
        grid = figure.subplots(len(named), 3, squeeze=False, width_ratios=(1.9, 1.2, 0.9), sharex="col", sharey="row")
        for row, (name, config) in zip(grid, named.items(), strict=True):
            training = LookupTable.load(folder.table(name, method)).training.position
            logs = [read_log(task.log_path) for task in hit_tasks(config, folder.hits(name, method), method, Path())]
            _draw_paths(row, logs, config, training)
            row[0].set_ylabel(f"{name}\nz [m]")
        for axes, title in zip(
            grid[0], ("ball, side view", "right hand, side view", "right hand, from behind"), strict=True
        ):
            axes.set_title(title)
        for axes, label in zip(grid[-1], ("x [m]", "x [m]", "y [m]"), strict=True):
            axes.set_xlabel(label)
        grid[0][2].invert_xaxis()
        _legend(grid[0][0])
        figure.suptitle(f"Ball and hand before the hit, method {method!r} (compare the paper's Fig. 8b)")
    return figure


def _draw_paths(row: Sequence[Axes], logs: Sequence[Log], config: ExperimentConfig, training: Array) -> None:
    row[1].plot(training[:, 0], training[:, 2], ".", ms=2.5, color=TRAINING_COLOR)
    row[2].plot(training[:, 1], training[:, 2], ".", ms=2.5, color=TRAINING_COLOR)
    for log in logs:
        times = {event.event: event.utime * 1e-6 for event in log.messages[channels.TRIAL]}
        plan = last_plan(log)
        hit = times.get(EventName.HIT) if plan is not None else None
        end = hit if hit is not None else times.get(EventName.BALL_LANDED, np.inf)
        color = MISS_COLOR if hit is None else "#333333"
        states = [s for s in log.messages[channels.BALL_STATE] if s.utime * 1e-6 <= end]
        ball = np.array([s.ball_position for s in states]).reshape(-1, 3)
        row[0].plot(ball[:, 0], ball[:, 2], "-", lw=0.7, color=color, alpha=0.8)
        if hit is None or plan is None:
            continue
        row[0].plot(*ball[-1, [0, 2]], "o", ms=4.5, mec=HIT_COLOR, mfc="none")
        time, hand = marker_track(log, config.robot.hand_marker)
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
    """Draw target and measured pressure of every valve in the last training motion on every backend."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 4.6), layout="constrained")
        grid = figure.subplots(2, 4, sharex=True, sharey=True)
        # Ever thinner lines, since the engines' pressures all but lie on each other.
        widths = np.linspace(3.4, 0.9, len(named))
        for color, width, (name, config) in zip(COLORS, widths, named.items(), strict=False):
            log = read_log(learning_tasks(config, folder.learning(name))[-1].log_path)
            commands = Commands.from_message(log.messages[channels.VALVE_COMMAND][-1])
            _draw_valves(grid.ravel(), log, commands, color=color, lw=width, label=name)
        theta = config.training.motions[-1]
        grid[1, 1].legend(fontsize=8)
        for axes in grid[-1]:
            axes.set_xlabel("time since onset [s]")
        for axes in grid[:, 0]:
            axes.set_ylabel("gauge pressure [MPa]")
        figure.suptitle(f"Pressure behind each valve, k = {theta.k:g}, t_w = {theta.t_w:g} s; dashed: target")
    return figure


def _draw_valves(panels: Sequence[Axes], log: Log, commands: Commands, **line: Any) -> None:
    messages = log.messages[channels.VALVE_PRESSURE]
    time = np.array([m.utime for m in messages])
    pressure = np.array([m.pressure for m in messages]) * 1e-6
    since = (time - commands.onset_utime) * 1e-6
    shown = since >= -0.05
    target = np.array([t if (t := commands.target(int(u))) is not None else np.full(8, np.nan) for u in time]) * 1e-6
    for valve, axes in enumerate(panels):
        axes.plot(since[shown], pressure[shown, valve], **line)
        axes.plot(since[shown], target[shown, valve], color="#333333", lw=0.5, ls="--")
        axes.set_title(VALVES[valve], fontsize=8.5)


VALVES = (
    "1: extends right hip",
    "2: extends right knee",
    "3: extends right ankle",
    "4: extends left hip",
    "5: extends left knee",
    "6: extends left ankle",
    "7: raises both arms",
    "8: lowers arms, bends legs",
)  # Fig. 6(a)


def draw_reach(named: dict[str, ExperimentConfig], folder: ResultsFolder, method: str) -> Figure:
    """Draw where the table can bring the hand, coloured by theta."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.6 * len(named) + 1, 6.4), layout="constrained")
        grid = figure.subplots(2, len(named), squeeze=False, sharex="row", sharey="row")
        for column, name in zip(grid.T, named, strict=True):
            table = LookupTable.load(folder.table(name, method))
            position, theta = table.position, table.theta
            side = column[0].scatter(
                position[:, 0], position[:, 2], c=theta[:, 1], s=1.5, cmap="viridis", rasterized=True
            )
            behind = column[1].scatter(
                position[:, 1], position[:, 2], c=theta[:, 0], s=1.5, cmap="coolwarm", rasterized=True
            )
            column[0].set_title(f"{name}: {len(np.unique(position, axis=0)):,} grid points")
            column[0].set_xlabel("x [m]")
            column[1].set_xlabel("y [m]")
        figure.colorbar(side, ax=grid[0].tolist(), label="$t_w$ [s]")
        figure.colorbar(behind, ax=grid[1].tolist(), label="k")
        # From behind, left is left; the panels of a row share their axis.
        grid[1, 0].invert_xaxis()
        for axes in grid[:, 0]:
            axes.set_ylabel("z [m]")
        figure.suptitle(f"Reachable hand region, method {method!r}: t_w moves the hand forward and up, k sideways")
    return figure


def draw_hit_rates(comparison: Comparison) -> Figure:
    """Draw the hit rate of every backend and method with its Wilson 95 % interval."""
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
        axes.axhline(PAPER_HIT_RATE, color="#555555", lw=0.8, ls="--", label="paper's robot, 16/20")
        axes.set_xticks(range(len(comparison.results)), list(comparison.results))
        axes.set_xlim(-0.6, len(comparison.results) - 0.4)
        axes.set_ylim(0, 1.03)
        axes.set_ylabel("hit rate (Wilson 95 %)")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    return figure


def draw_waterfall(answer: Attribution) -> Figure:
    """Draw what each swap explains of the disagreement of two backends, one upon the other, down to the rest."""
    heights = [1e3 * (s.mean or 0.0) for s in (answer.start, *(step.disagreement for step in answer.waterfall))]
    labels = [f"{answer.backends[0]} - {answer.backends[1]}\nas configured"]
    labels += [f"{s.swap.ingredient}\n{s.swap.side}, {s.swap.change}" for s in answer.waterfall]
    labels += ["not explained"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.5, 0.55 * len(labels) + 1.0), layout="constrained")
        axes = figure.subplots()
        rows = range(len(labels))
        axes.barh(rows[0], heights[0], color=MISS_COLOR, height=0.6)
        axes.barh(rows[-1], heights[-1], color=MISS_COLOR, height=0.6)
        axes.text(heights[0], rows[0], f" {heights[0]:.1f}", va="center")
        axes.text(heights[-1], rows[-1], f" {heights[-1]:.1f}", va="center")
        for row, (before, after) in enumerate(pairwise(heights), start=1):
            axes.barh(row, before - after, left=after, color=COLORS[0], height=0.6)
            axes.plot([before, before], [row - 1, row], color="#555555", lw=0.6)
            axes.text(before, row, f" -{before - after:.1f}", va="center")
        axes.plot([heights[-1]] * 2, rows[-2:], color="#555555", lw=0.6)
        axes.set_yticks(rows, labels, fontsize=8)
        axes.invert_yaxis()
        axes.set_xlim(0.0, 1.12 * max(heights))
        axes.set_xlabel(f"distance of the hands, mean over {answer.motions} motions [mm]")
        axes.grid(axis="y", visible=False)
    return figure
