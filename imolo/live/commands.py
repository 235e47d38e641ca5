"""The commands of a session; each imports what it needs itself, so that `--help` stays quick."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from imolo.command_line.options import MOST_BALLS, Bus, Config, Method
from imolo.messaging.udpm import LOCAL_URL

if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig

app = typer.Typer()

ConfigBus = Annotated[
    str | None,
    typer.Option("--bus", help="LCM URL.", show_default=f"the config's if it is udpm://, else {LOCAL_URL}"),
]
Clock = Annotated[
    Literal["lockstep", "realtime"],
    typer.Option(help="lockstep: repeats to the byte; realtime: paced by the clock on the wall."),
]
TablePath = Annotated[
    Path | None,
    typer.Option("--table", help="Table of `imolo learn`.", show_default="the newest of the backend under results/"),
]
Count = Annotated[int, typer.Argument(min=1, max=MOST_BALLS, help="Number of balls.")]
WithParent = Annotated[bool, typer.Option("--with-parent", hidden=True, help="End when the parent has ended.")]


@app.command()
def backend(
    config: Config,
    clock: Clock = "realtime",
    out: Annotated[Path, typer.Option(help="Folder of the logs, one per ball.")] = Path("results/live"),
    bus: ConfigBus = None,
    with_parent: WithParent = False,
) -> None:
    """Run the backend of a session, which waits for a planner.

    `imolo throw` asks it for balls.
    """
    from imolo.live.backend_program import run_backend
    from imolo.live.identity import ClockMode
    from imolo.live.program import Console, until_stopped

    with until_stopped(with_parent) as stop:
        chosen = _load(config)
        run_backend(chosen, _url(bus, chosen), ClockMode(clock), out, stop, Console("backend"))


@app.command()
def planner(
    config: Config,
    table: TablePath = None,
    method: Method = "improved",
    bus: ConfigBus = None,
    with_parent: WithParent = False,
) -> None:
    """Run the planner of a session.

    It answers the frames of whichever backend there is.
    """
    from imolo.live.planner_program import run_planner
    from imolo.live.program import Console, until_stopped

    with until_stopped(with_parent) as stop:
        chosen = _load(config)
        run_planner(chosen, _url(bus, chosen), _table(table, chosen, method), method, stop, Console("planner"))


@app.command()
def record(
    out: Annotated[
        str,
        typer.Option(metavar="<path>", help="Log to write, or a folder for it; an older one is never replaced."),
    ] = "results/live/session.lcmlog",
    bus: Bus = LOCAL_URL,
    with_parent: WithParent = False,
) -> None:
    """Record every message of a session to a log.

    lcm-logplayer can play it.
    """
    from imolo.live.program import Console, until_stopped
    from imolo.live.recorder_program import run_recorder

    with until_stopped(with_parent) as stop:
        run_recorder(bus, out, stop, Console("record"))


@app.command()
def throw(count: Count = 1, bus: Bus = LOCAL_URL) -> None:
    """Ask the backend for balls, and tell how each of them ended."""
    from imolo.live.program import Console, until_stopped
    from imolo.live.throw_program import run_throw

    with until_stopped() as stop:
        left = run_throw(bus, count, stop, Console("throw"))
    _end(left)


@app.command()
def up(
    config: Config,
    balls: Annotated[int, typer.Option(min=1, max=MOST_BALLS, help="Number of balls.")] = 5,
    clock: Clock = "realtime",
    table: TablePath = None,
    method: Method = "improved",
    out: Annotated[Path, typer.Option(help="Folder of all logs.")] = Path("results/live"),
    bus: ConfigBus = None,
) -> None:
    """Start backend, planner and recorder, and throw balls.

    Everything is stopped again at the end.
    """
    from imolo.live.identity import ClockMode
    from imolo.live.program import Console, until_stopped
    from imolo.live.session import run_session

    with until_stopped() as stop:
        chosen = _load(config)
        where = _table(table, chosen, method)
        url, mode = _url(bus, chosen), ClockMode(clock)
        left = run_session(config, url, mode, where, method, balls, out, stop, Console("up"))
    _end(left)


def _end(left: int) -> None:
    if left:
        raise typer.Exit(1)


def _load(text: str) -> "ExperimentConfig":
    from imolo.config.loading import named_config

    return named_config(text)


def _url(given: str | None, config: "ExperimentConfig") -> str:
    if given is not None:
        return given
    return LOCAL_URL if config.bus.startswith("memq:") else config.bus


def _table(given: Path | None, config: "ExperimentConfig", method: str) -> Path:
    from imolo.errors import TableFileError

    if given is not None:
        return given
    name = config.backend.name
    tables = Path("results").glob(f"*/tables/{name}_{method}.npz")
    newest = max(tables, key=lambda path: path.stat().st_mtime, default=None)
    if newest is None:
        raise TableFileError(
            f"there is no table of {name!r} for method {method!r} under results/; `imolo learn {name}` makes one, "
            "--table names one that is elsewhere"
        )
    return newest
