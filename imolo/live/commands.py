"""The commands of a session; each imports what it needs itself, so that `--help` stays quick."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imolo.command_line.options import ConfigPath, Method
from imolo.messaging.udpm import LOCAL_URL

if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig
    from imolo.live.identity import ClockMode

app = typer.Typer()

BusUrl = Annotated[
    str | None, typer.Option("--bus", help=f"LCM URL [default: the config's if udpm://, else {LOCAL_URL}].")
]
PlainBusUrl = Annotated[str, typer.Option("--bus", help="LCM URL.")]
Clock = Annotated[str, typer.Option(help="lockstep: repeats to the byte; realtime: paced by the clock on the wall.")]
TablePath = Annotated[
    Path | None, typer.Option("--table", help="Table of `imolo learn` [default: that of `make demo`].")
]
Count = Annotated[int, typer.Argument(min=1, help="Number of balls.")]
WithParent = Annotated[bool, typer.Option("--with-parent", hidden=True, help="End when the parent has ended.")]


@app.command()
def backend(
    config: ConfigPath,
    clock: Clock = "realtime",
    out: Annotated[Path, typer.Option(help="Folder of the logs, one per ball.")] = Path("results/live"),
    bus: BusUrl = None,
    with_parent: WithParent = False,
) -> None:
    """Run the backend of a session: it waits for a planner, and for `imolo throw`."""
    from imolo.live.backend_program import run_backend
    from imolo.live.program import Console, until_stopped

    with until_stopped(with_parent) as stop:
        chosen = _load(config)
        run_backend(chosen, _url(bus, chosen), _clock(clock), out, stop, Console("backend"))


@app.command()
def planner(
    config: ConfigPath,
    table: TablePath = None,
    method: Method = "improved",
    bus: BusUrl = None,
    with_parent: WithParent = False,
) -> None:
    """Run the planner of a session: it answers the frames of whichever backend there is."""
    from imolo.live.planner_program import run_planner
    from imolo.live.program import Console, until_stopped

    with until_stopped(with_parent) as stop:
        chosen = _load(config)
        run_planner(chosen, _url(bus, chosen), _table(table, chosen, method), method, stop, Console("planner"))


@app.command()
def record(
    out: Annotated[Path, typer.Option(help="Log to write, or a folder for it; an older one is never replaced.")] = Path(
        "results/live/session.lcmlog"
    ),
    bus: PlainBusUrl = LOCAL_URL,
    with_parent: WithParent = False,
) -> None:
    """Record every message of a session to a log that lcm-logplayer can play."""
    from imolo.live.program import Console, until_stopped
    from imolo.live.recorder_program import run_recorder

    with until_stopped(with_parent) as stop:
        run_recorder(bus, out, stop, Console("record"))


@app.command()
def throw(count: Count = 1, bus: PlainBusUrl = LOCAL_URL) -> None:
    """Ask the backend for balls, and tell how each of them ended."""
    from imolo.live.program import Console, until_stopped
    from imolo.live.throw_program import run_throw

    with until_stopped() as stop:
        left = run_throw(bus, count, stop, Console("throw"))
    _end(left)


@app.command()
def up(
    config: ConfigPath,
    throws: Annotated[int, typer.Option(min=1, help="Number of balls.")] = 5,
    clock: Clock = "realtime",
    table: TablePath = None,
    method: Method = "improved",
    out: Annotated[Path, typer.Option(help="Folder of all logs.")] = Path("results/live"),
    bus: BusUrl = None,
) -> None:
    """Start backend, planner and recorder, throw balls, and stop everything."""
    from imolo.live.program import Console, until_stopped
    from imolo.live.session import run_session

    with until_stopped() as stop:
        chosen = _load(config)
        where = _table(table, chosen, method)
        url, mode = _url(bus, chosen), _clock(clock)
        left = run_session(config, url, mode, where, method, throws, out, stop, Console("up"))
    _end(left)


def _end(left: int) -> None:
    if left:
        raise typer.Exit(1)


def _load(path: Path) -> "ExperimentConfig":
    from imolo.config.loading import load_config

    return load_config(path)


def _url(given: str | None, config: "ExperimentConfig") -> str:
    if given is not None:
        return given
    return LOCAL_URL if config.bus.startswith("memq:") else config.bus


def _clock(name: str) -> "ClockMode":
    from imolo.errors import ConfigError, did_you_mean
    from imolo.live.identity import ClockMode

    if name not in list(ClockMode):
        raise ConfigError(f"unknown clock {name!r}{did_you_mean(name, ClockMode)}; known: {', '.join(ClockMode)}")
    return ClockMode(name)


def _table(given: Path | None, config: "ExperimentConfig", method: str) -> Path:
    from imolo.errors import TableFileError

    if given is not None:
        return given
    path = Path(f"results/demo/tables/{config.backend.name}_{method}.npz")
    if not path.is_file():
        raise TableFileError(f"there is no table {path}; `imolo learn` makes one, --table names it")
    return path
