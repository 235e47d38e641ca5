"""The options of the commands that run trials, and what they do."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imolo.command_line.options import LARGEST_SEED, MOST_BALLS
from imolo.command_line.terminal import say

# Imported by what needs it, so that `--help` stays quick.
if TYPE_CHECKING:
    from imolo.campaigns.results import ResultsFolder
    from imolo.config.experiment import ExperimentConfig

Configs = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="CONFIG",
        help="Backends by name, or YAMLs that are alike but for the backend.",
        show_default="every backend that is ready",
    ),
]
Out = Annotated[Path, typer.Option(help="Results folder.")]
Seed = Annotated[int | None, typer.Option(min=0, max=LARGEST_SEED, help="Replaces the seed of the configs.")]
Balls = Annotated[int | None, typer.Option(min=1, max=MOST_BALLS, help="Replaces the number of balls of the configs.")]
Fresh = Annotated[bool, typer.Option("--fresh", help="Delete the trials in the results folder and run all anew.")]
Scheduler = Annotated[
    str | None, typer.Option(help="Run the trials on the workers of this Dask scheduler, such as tcp://127.0.0.1:8786.")
]


def load_configs(configs: Sequence[str] | None) -> "list[ExperimentConfig]":
    """Read the configs that are named; where none is, return that of every simulated backend that is ready.

    Raises:
        ConfigError: A config cannot be used.
        BackendNotFoundError: A backend is unknown or not installed, or none is ready.
    """
    from imolo.config.loading import config_for, named_config
    from imolo.contracts.registry import ready_simulations

    if configs:
        return [named_config(config) for config in configs]
    return [config_for(name) for name in ready_simulations()]


def override(
    config: "ExperimentConfig", *, seed: int | None = None, balls: int | None = None, scheduler: str | None = None
) -> "ExperimentConfig":
    """Return the config with what the options replace; None leaves it as it is."""
    from imolo.config.experiment import ParallelConfig

    changes: dict[str, object] = {}
    if seed is not None:
        changes["seed"] = seed
    campaign: dict[str, object] = {}
    if balls is not None:
        campaign["balls"] = balls
    if scheduler is not None:
        campaign["parallel"] = ParallelConfig(backend="dask", address=scheduler)
    if campaign:
        changes["campaign"] = config.campaign.model_copy(update=campaign)
    return config.model_copy(update=changes)


def open_results(out: Path, fresh: bool) -> "ResultsFolder":
    """Return the results folder, and say how many trials are in it already unless they are deleted for `fresh` ones.

    Raises:
        ResultsError: The folder cannot be written, or another program is at work in it.
    """
    from imolo.campaigns.results import ResultsFolder

    folder = ResultsFolder(out)
    folder.prepare()
    if fresh:
        folder.discard_trials()
    elif there := folder.trials():
        say(f"{there} trials are in {out} already and will not be run again")
    return folder


def kept_in(out: Path) -> Callable[[], str]:
    """Return what says how many logs an interrupted command leaves in its results folder, for `ProgressBars`."""
    return lambda: f"the {len(list(out.rglob('*.lcmlog')))} logs recorded so far are kept in {out}"
