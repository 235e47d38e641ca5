"""The command line: the commands of every folder under one name, and those that tell of plug-ins."""

import logging
import sys
import warnings
from importlib.metadata import entry_points, version
from io import TextIOWrapper
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from imolo.campaigns import commands as campaign_commands
from imolo.command_line.options import Config
from imolo.command_line.terminal import INTERRUPTED, PlainFormatter, complain, show
from imolo.conformance import commands as conformance_commands
from imolo.errors import ImoloError
from imolo.identification import commands as identification_commands
from imolo.inspect import commands as inspect_commands
from imolo.live import commands as live_commands
from imolo.machine.caches import provide_caches
from imolo.report import commands as report_commands
from imolo.scaffold import commands as scaffold_commands
from imolo.studies import commands as study_commands

if TYPE_CHECKING:
    from rich.table import Table

    from imolo.contracts.registry import Registry

START = "Start"


class CommandGroups(TyperGroup):
    """Lists its commands under the headings that they were given, one line each."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list; a line ends with the first sentence of the help, whatever its length."""
        width = max(map(len, self.commands))
        groups: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            summary = (name.ljust(width), command.get_short_help_str(formatter.width))
            groups.setdefault(getattr(command, "rich_help_panel", None) or START, []).append(summary)
        for title, summaries in groups.items():
            with formatter.section(title):
                formatter.write_dl(summaries)


app = typer.Typer(
    cls=CommandGroups,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Robots that hit or catch a flying ball by a lookup table of learned dynamics (IMoLo), compared across "
    "physics engines over LCM.",
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"imolo {version('imolo')}")
        raise typer.Exit


@app.callback()
def _options(
    _: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Show the version and exit.")
    ] = False,
) -> None: ...


@app.command()
def backends() -> None:
    """List the backends, and how to get those that are missing."""
    from imolo.contracts.registry import BACKENDS

    show(_plugins(BACKENDS))


@app.command()
def robots() -> None:
    """List the robots, tasks and planners that are installed."""
    from imolo.contracts.registry import PLANNERS, ROBOTS, TASKS

    for registry in (ROBOTS, TASKS, PLANNERS):
        show(_plugins(registry))


@app.command()
def config(
    name: Config,
    robot: Annotated[str | None, typer.Option(help="Robot, where a backend is named.")] = None,
) -> None:
    """Write every setting on a backend as YAML with comments.

    imolo config mujoco > my.yaml is what to begin with; of a YAML of yours, what it leaves out is there with its
    default.
    """
    from imolo.config.commented import commented
    from imolo.config.loading import is_config_file, named_config
    from imolo.errors import ConfigError

    if robot and is_config_file(name):
        raise ConfigError(f"{name} says which robot it is for; --robot goes with the name of a backend")
    typer.echo(commented(named_config(name, **({"robot": {"name": robot}} if robot else {}))), nl=False)


# In the order of `--help`, which must be quick: a command imports what it needs when it is called, since scikit-learn,
# numba and matplotlib take seconds.
for _group, _commands in (
    (START, scaffold_commands.app),
    (START, conformance_commands.app),
    ("Compare", campaign_commands.app),
    ("Study", study_commands.app),
    ("Study", identification_commands.app),
    ("Live", live_commands.app),
    ("Look", report_commands.app),
    ("Look", inspect_commands.app),
    *((_installed.name.capitalize(), _installed.load()) for _installed in entry_points(group="imolo.commands")),
):
    for _command in (*_commands.registered_commands, *_commands.registered_groups):
        _command.rich_help_panel = _group
    app.add_typer(_commands)


def _plugins(registry: "Registry[Any]") -> "Table":
    from rich.markup import escape
    from rich.table import Table

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
    handler = logging.StreamHandler()
    handler.setFormatter(PlainFormatter("%(levelname)s: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    # joblib replaces a process that has grown; its tasks are run all the same.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
    if not provide_caches():
        complain("neither the home folder nor a temporary one can be written; set HOME or TMPDIR to one that can")
        sys.exit(2)
    try:
        app()
    except ImoloError as error:
        complain(str(error))
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
