"""The command line."""

import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from imolo.config.experiment import BackendConfig, ExperimentConfig, load_config
from imolo.errors import BackendNotFoundError, ImoloError
from imolo.registry import backend_names, backend_status

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
Out = Annotated[Path, typer.Option(help="Results folder.")]
Seed = Annotated[int | None, typer.Option(min=0, help="Replaces the seed of the configs.")]
Balls = Annotated[int | None, typer.Option(min=1, help="Replaces the number of balls of the configs.")]
Jobs = Annotated[int, typer.Option(min=1, help="Number of processes [default: one per core].", show_default=False)]

CORES = os.cpu_count() or 1


@app.command()
def backends() -> None:
    """List the backends that are installed, and what is missing for the others."""
    table = Table(box=None, pad_edge=False)
    for title in ("backend", "state", "about"):
        table.add_column(title)
    for name in backend_names():
        status = backend_status(name)
        if status.plugin is None:
            table.add_row(name, "[red]missing[/red]", status.problem)
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

    Writes logs, tables, resolved configs, figures and summary.json to the results folder.
    """
    from imolo.experiment.comparison import ResultsFolder
    from imolo.experiment.comparison import compare as run_comparison
    from imolo.experiment.figures import draw_all
    from imolo.experiment.summary import render

    chosen = [_override(config, seed, balls) for config in _load_all(configs)]
    folder = ResultsFolder(out)
    try:
        with _Bars() as bars:
            comparison = run_comparison(chosen, folder, jobs, bars.show)
    except KeyboardInterrupt:
        logs = len(list(out.rglob("*.lcmlog")))
        errors.print(f"interrupted; the {logs} logs recorded so far are kept in {out}")
        raise typer.Exit(130) from None
    console.print(render(comparison))
    draw_all(comparison, chosen, folder)
    console.print(f"logs, tables, configs, figures and summary.json are in {out}")


class _Bars:
    """One progress bar for every backend and stage."""

    def __init__(self) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
        )
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> "_Bars":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def show(self, backend: str, stage: str, done: int, total: int) -> None:
        """Show how far a stage is."""
        name = f"{backend}: {stage}"
        if name not in self._tasks:
            self._tasks[name] = self._progress.add_task(name, total=total)
        self._progress.update(self._tasks[name], completed=done)


def _load_all(paths: Sequence[Path] | None) -> list[ExperimentConfig]:
    if paths:
        return [load_config(path) for path in paths]
    ready = [name for name in backend_names() if backend_status(name).plugin is not None]
    if not ready:
        raise BackendNotFoundError("no backend is ready; `imolo backends` says what to install")
    return [ExperimentConfig(backend=BackendConfig(name=name)) for name in ready]


def _override(config: ExperimentConfig, seed: int | None, balls: int | None) -> ExperimentConfig:
    changes: dict[str, object] = {}
    if seed is not None:
        changes["seed"] = seed
    if balls is not None:
        changes["campaign"] = config.campaign.model_copy(update={"balls": balls})
    return config.model_copy(update=changes)


def main() -> None:
    """Run the command line; every error of ours ends in one line."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    try:
        app()
    except ImoloError as error:
        errors.print(f"imolo: {error}", highlight=False, markup=False)
        sys.exit(2)


if __name__ == "__main__":
    main()
