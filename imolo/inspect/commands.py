"""The commands that look at a bus or a log; each imports what it needs itself, so that `--help` stays quick."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from imolo.command_line.options import Bus, Method
from imolo.command_line.terminal import console, plain, say, show
from imolo.errors import ConfigError
from imolo.messaging.udpm import LOCAL_URL

if TYPE_CHECKING:
    from imolo.inspect.diff import RunComparison

app = typer.Typer()

DIFFERENT = 1  # exit code where two runs are not the same, as of diff

OneLog = Annotated[Path, typer.Argument(metavar="LOG", help="A .lcmlog.")]
MaybeLog = Annotated[Path | None, typer.Argument(metavar="LOG", help="A .lcmlog to look at in place of a bus.")]
OneTrial = Annotated[
    int | None, typer.Option("--trial", min=0, help="One trial of the log, from 0.", show_default="all, in turn")
]


@app.command()
def spy(
    log: MaybeLog = None,
    bus: Bus = LOCAL_URL,
    speed: Annotated[float, typer.Option(help="How fast the log is played.")] = 1.0,
) -> None:
    """Open lcm-spy with our types decoded; needs Java."""
    from imolo.inspect.spy import open_spy

    open_spy(bus, log, speed)


@app.command()
def top(
    log: MaybeLog = None,
    bus: Bus = LOCAL_URL,
    seconds: Annotated[float | None, typer.Option(help="End after this long.", show_default="Ctrl-C")] = None,
    trial: OneTrial = None,
) -> None:
    """Show the channels: rates, jitter, losses, last values."""
    from imolo.inspect.top import log_table, watch

    if log is not None:
        show(log_table(log, console.width, trial))
        return
    watch(bus, console, seconds)


@app.command()
def replay(
    log: OneLog,
    table: Annotated[Path, typer.Option(help="Table the trial was planned with.")],
    method: Method = "improved",
    config: Annotated[
        str | None,
        typer.Option(metavar="CONFIG", help="Config the trial ran with.", show_default="the backend's and robot's own"),
    ] = None,
) -> None:
    """Feed a log to the planner; compare what it says to the log.

    The exit code is 0 where every message is the same to the byte, and 1 where not.
    """
    from imolo.inspect.replay import replay as run

    result = run(log, table, method, config)
    total = sum(channel.counts[0] for channel in result.channels)
    _print_channels(result, "recorded", "replayed")
    if result.first is not None:
        say(f"the planner parts from the log: {result.first}")
        raise typer.Exit(DIFFERENT)
    say(f"the planner says the same: {total} messages, byte by byte")


@app.command()
def diff(
    first: OneLog,
    second: OneLog,
    out: Annotated[Path | None, typer.Option(help="Draw how they go apart to this file.")] = None,
    trial: Annotated[
        list[int] | None, typer.Option(min=0, help="Trial of both logs, from 0; twice for one of each.")
    ] = None,
) -> None:
    """Say where two runs part: first message, field and time.

    Then channel by channel. The exit code is 0 where they are the same, and 1 where not.
    """
    from imolo.inspect.diff import compare_logs

    trials = (trial[0], trial[-1]) if trial else (None, None)
    result = compare_logs(first, second, trials)
    _print_channels(result, "first", "second")
    if result.first is not None:
        say(f"they part at {result.first}")
    elif not result.same_recording:
        say("the messages are the same, but not their order or the times at which they were recorded")
    else:
        say("the runs are the same: they are identical, byte by byte")
    if out is not None:
        from imolo.inspect.divergence import draw_divergence
        from imolo.inspect.plot import save_figure

        save_figure(draw_divergence(first, second, result.first, trials), out)
        say(f"the figure is {out}")
    if result.first is not None or not result.same_recording:
        raise typer.Exit(DIFFERENT)


@app.command()
def export(
    log: OneLog,
    to: Annotated[Literal["mcap", "csv", "parquet"], typer.Option(help="mcap is for Foxglove.")] = "mcap",
    out: Annotated[
        Path | None, typer.Option(help="File (mcap) or folder (csv, parquet).", show_default="beside the log")
    ] = None,
    trial: OneTrial = None,
) -> None:
    """Turn a log into MCAP for Foxglove, or CSV or Parquet tables.

    There is a table for each channel.
    """
    from imolo.inspect.export import ExportFormat
    from imolo.inspect.export import export as write

    for path in write(log, ExportFormat(to), out, trial):
        say(str(path))
    if to == "mcap":
        from imolo.inspect.mcap_export import LAYOUT

        say(f"layout for Foxglove: {LAYOUT}")


@app.command()
def plot(
    log: OneLog,
    fields: Annotated[list[str], typer.Argument(metavar="FIELD", help="Such as MOCAP.frame_number or PLAN.theta[1].")],
    others: Annotated[list[Path] | None, typer.Option("--log", help="A log to draw over it; any number.")] = None,
    out: Annotated[Path | None, typer.Option(help="File to write.", show_default="a window")] = None,
    trial: OneTrial = None,
) -> None:
    """Plot fields of a log over time.

    CHANNEL.field, with [index] or [from:to] for arrays.
    """
    from imolo.inspect.fields import parse_selector
    from imolo.inspect.plot import draw_fields, save_figure, show_figure

    selectors = [parse_selector(field) for field in fields]
    figure = draw_fields([log, *(others or [])], selectors, trial)
    if out is None:
        show_figure(figure)
    else:
        save_figure(figure, out)
        say(f"the figure is {out}")


@app.command()
def view(
    logs: Annotated[
        list[Path] | None, typer.Argument(metavar="LOG", help="Logs to show over each other, such as of engines.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write one file that plays offline, and end.")] = None,
    bus: Bus = LOCAL_URL,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page, on this machine only.")] = 8080,
    speed: Annotated[float, typer.Option(min=0.01, help="How fast logs are played.")] = 0.25,
    robot: Annotated[
        str | None, typer.Option(help="Robot of a running session.", show_default="the default one")
    ] = None,
    trial: OneTrial = None,
) -> None:
    """Show sessions, recorded or running, in 3-D in the browser."""
    from contextlib import ExitStack

    from imolo.machine.extras import import_extra

    import_extra("viser", "view")
    import_extra("yourdfpy", "view")
    from imolo.contracts.registry import default_robot
    from imolo.inspect.plot import short_names
    from imolo.view import viewer
    from imolo.view.sessions import recorded_sessions

    def tell(address: str) -> None:
        say(f"open {address} (Ctrl-C ends)")

    if html is not None and not logs:
        raise ConfigError("--html needs logs to write; a running session can only be watched")
    if not logs:
        viewer.serve_live(bus, port, robot or default_robot(), tell)
        return
    with ExitStack() as stack:
        sessions = recorded_sessions(logs, short_names(logs), trial)
        for session in sessions:
            stack.callback(session.close)
        if html is None:
            viewer.serve(sessions, port, speed, tell)
        else:
            viewer.write_html(sessions, html, speed)
            say(f"the view is {html}")


def _print_channels(result: "RunComparison", first: str, second: str) -> None:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, padding=0)
    table.add_column("channel", no_wrap=True)
    for column in (first, second, "same", "parts at s"):
        table.add_column(column, justify="right")
    table.add_column("largest difference")
    for channel in result.channels:
        parting = "-" if channel.first is None else f"{channel.first.utime * 1e-6:.6f}"
        largest = f"{channel.largest_field} {channel.largest:.4g}" if channel.largest_field else "-"
        counts = [str(count) for count in (*channel.counts, channel.equal)]
        table.add_row(escape(plain(channel.channel)), *counts, parting, escape(largest))
    show(table)
