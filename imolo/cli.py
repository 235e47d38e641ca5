"""The command line."""

import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from imolo.errors import BackendNotFoundError, ConfigError, ImoloError, did_you_mean
from imolo.live import commands

# The commands import what they need themselves: scikit-learn, numba and matplotlib take seconds, `--help` must not.
if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Jump-and-hit motions of a pneumatic humanoid from a lookup table of learned dynamics (IMoLo), "
    "compared across physics engines over LCM.",
)
console = Console()
errors = Console(stderr=True)

ConfigPaths = Annotated[
    list[Path] | None,
    typer.Argument(help="One YAML per backend, alike but for the backend [default: every backend that is ready]."),
]
ConfigPath = Annotated[Path, typer.Argument(help="YAML of the backend and everything around it, see configs/.")]
Out = Annotated[Path, typer.Option(help="Results folder.")]
Seed = Annotated[int | None, typer.Option(min=0, help="Replaces the seed of the configs.")]
Balls = Annotated[int | None, typer.Option(min=1, help="Replaces the number of balls of the configs.")]
Jobs = Annotated[int, typer.Option(min=1, help="Number of processes [default: one per core].", show_default=False)]

CORES = os.cpu_count() or 1


@app.command()
def backends() -> None:
    """List the backends that are installed, and what is missing for the others."""
    from imolo.registry import backend_names, backend_status

    table = Table(box=None, pad_edge=False)
    for title in ("backend", "state", "about"):
        table.add_column(title)
    for name in backend_names():
        status = backend_status(name)
        if status.plugin is None:
            table.add_row(name, "[red]missing[/red]", escape(status.problem))
        else:
            table.add_row(name, "[green]ready[/green]", status.plugin.summary)
    console.print(table)


@app.command()
def compare(
    configs: ConfigPaths = None,
    out: Out = Path("results/compare"),
    seed: Seed = None,
    balls: Balls = None,
    jobs: Jobs = CORES,
) -> None:
    """Learn the motions, throw balls and hit them on every backend, then compare.

    Writes logs, tables, resolved configs, figures, summary.json and timing.json to the results folder.
    """
    from imolo.experiment import comparison, figures, summary
    from imolo.experiment.results import ResultsFolder

    chosen = [_override(config, seed, balls) for config in _load_all(configs)]
    folder = ResultsFolder(out)
    with _Bars(out) as bars:
        result, timings = comparison.compare(chosen, folder, jobs, bars.show)
    console.print(summary.render_comparison(result, timings.timing))
    figures.draw_all(result, chosen, folder)
    console.print(f"logs, tables, configs, figures, summary.json and timing.json are in {out}")


@app.command()
def learn(config: ConfigPath, out: Out = Path("results/learn"), seed: Seed = None, jobs: Jobs = CORES) -> None:
    """Learn balls and motions on one backend and build the table of each method."""
    from imolo.config.experiment import load_config
    from imolo.experiment import comparison
    from imolo.experiment.results import ResultsFolder

    chosen = _override(load_config(config), seed, None)
    folder = ResultsFolder(out)
    with _Bars(out) as bars:
        comparison.learn([chosen], folder, jobs, bars.show)
    for method in chosen.methods:
        console.print(f"table of method {method!r}: {folder.table(chosen.backend.name, method)}")


@app.command()
def hit(
    config: ConfigPath,
    table: Annotated[Path, typer.Argument(help="Table that `imolo learn` or `imolo compare` wrote, on any backend.")],
    method: Annotated[str, typer.Option(help="Method of the config whose planner is used.")] = "improved",
    out: Out = Path("results/hit"),
    seed: Seed = None,
    balls: Balls = None,
    jobs: Jobs = CORES,
) -> None:
    """Throw balls on one backend and hit them with a table, perhaps learned on another backend."""
    from imolo.config.experiment import load_config
    from imolo.experiment import comparison, summary
    from imolo.experiment.results import ResultsFolder
    from imolo.method.table import LookupTable

    chosen = _override(load_config(config), seed, balls)
    if method not in chosen.methods:
        raise ConfigError(
            f"unknown method {method!r}{did_you_mean(method, chosen.methods)}; known: {', '.join(chosen.methods)}"
        )
    LookupTable.load(table, chosen.robot.name)
    folder = ResultsFolder(out)
    folder.prepare()
    folder.save_config(chosen)
    name = chosen.backend.name
    with _Bars(out) as bars:
        results, timing = comparison.hit({name: chosen}, {(name, method): table}, folder, jobs, bars.show)
    folder.save_json("summary.json", results[name][method])
    console.print(summary.render_results(results, timing))
    console.print(f"logs, config and summary.json are in {out}")


commands.add_to(app)


class _Bars:
    """Progress bars, one for each thing under way; Ctrl-C ends in one line that says what is kept."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
        )
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> "_Bars":
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._progress.stop()
        if kind is KeyboardInterrupt:
            logs = len(list(self._out.rglob("*.lcmlog")))
            _complain(f"interrupted; the {logs} logs recorded so far are kept in {self._out}")
            raise typer.Exit(130)

    def show(self, what: str, done: int, total: int) -> None:
        """Show how far something is."""
        if what not in self._tasks:
            self._tasks[what] = self._progress.add_task(what, total=total)
        self._progress.update(self._tasks[what], completed=done)


def _load_all(paths: Sequence[Path] | None) -> "list[ExperimentConfig]":
    from imolo.config.experiment import BackendConfig, ExperimentConfig, load_config
    from imolo.registry import backend_names, backend_status

    if paths:
        return [load_config(path) for path in paths]
    ready = [name for name in backend_names() if backend_status(name).plugin is not None]
    if not ready:
        raise BackendNotFoundError("no backend is ready; `imolo backends` says what to install")
    return [ExperimentConfig(backend=BackendConfig(name=name)) for name in ready]


def _override(config: "ExperimentConfig", seed: int | None, balls: int | None) -> "ExperimentConfig":
    changes: dict[str, object] = {}
    if seed is not None:
        changes["seed"] = seed
    if balls is not None:
        changes["campaign"] = config.campaign.model_copy(update={"balls": balls})
    return config.model_copy(update=changes)


def _complain(message: str) -> None:
    errors.print(f"imolo: {message}", highlight=False, markup=False, soft_wrap=True)


def main() -> None:
    """Run the command line; every error of ours ends in one line."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    try:
        app()
    except ImoloError as error:
        _complain(str(error))
        sys.exit(2)


if __name__ == "__main__":
    main()
