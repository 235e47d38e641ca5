"""The command line: the commands of every folder under one name, and `imolo backends`."""

import logging
import sys
import warnings
from importlib.metadata import entry_points
from io import TextIOWrapper
from typing import TYPE_CHECKING, Any

import typer
from rich.markup import escape
from rich.table import Table

from imolo.campaigns import commands as campaign_commands
from imolo.command_line.terminal import INTERRUPTED, complain, console
from imolo.conformance import commands as conformance_commands
from imolo.errors import ImoloError
from imolo.identification import commands as identification_commands
from imolo.inspect import commands as inspect_commands
from imolo.live import commands as live_commands
from imolo.report import commands as report_commands
from imolo.scaffold import commands as scaffold_commands
from imolo.studies import commands as study_commands

if TYPE_CHECKING:
    from imolo.contracts.registry import Registry

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Robots that hit or catch a flying ball by a lookup table of learned dynamics (IMoLo), compared across "
    "physics engines over LCM.",
)
# In the order of `--help`, which must be quick: a command imports what it needs when it is called, since scikit-learn,
# numba and matplotlib take seconds.
for _commands in (
    conformance_commands,
    campaign_commands,
    study_commands,
    identification_commands,
    report_commands,
    live_commands,
    inspect_commands,
    scaffold_commands,
):
    app.add_typer(_commands.app)
for _installed in entry_points(group="imolo.commands"):
    app.add_typer(_installed.load())


@app.command()
def backends() -> None:
    """List the backends that are installed, and what is missing for the others."""
    from imolo.contracts.registry import BACKENDS

    console.print(_plugins(BACKENDS))


@app.command()
def robots() -> None:
    """List the robots, tasks and planners that are installed."""
    from imolo.contracts.registry import PLANNERS, ROBOTS, TASKS

    for registry in (ROBOTS, TASKS, PLANNERS):
        console.print(_plugins(registry))


def _plugins(registry: "Registry[Any]") -> Table:
    table = Table(box=None, pad_edge=False)
    for title in (registry.kind, "state", "about"):
        table.add_column(title)
    for name in registry.names():
        summary, problem = registry.about(name)
        state = "[red]missing[/red]" if problem else "[green]ready[/green]"
        table.add_row(name, state, escape(problem or summary))
    return table


def main() -> None:
    """Run the command line; every error of ours ends in one line."""
    for stream in (sys.stdout, sys.stderr):
        # What a terminal's alphabet does not have is written as its number.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    # joblib replaces a process that has grown; its tasks are run all the same.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
    try:
        app()
    except ImoloError as error:
        complain(str(error))
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
