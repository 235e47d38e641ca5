"""The channels as a table in the terminal, of a log or live."""

import time
from pathlib import Path

from rich import box
from rich.console import Console, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from imolo.command_line.tables import WholeWords, fit
from imolo.command_line.terminal import plain
from imolo.inspect.statistics import BusStatistics, ChannelStatistics
from imolo.inspect.trials import TrialEvents
from imolo.messaging.bus import Bus
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log_file import LogReader

REFRESH = 0.25  # [s] between two pictures of a live table
STALE = 1.0  # [s] of silence after which a channel is shown dim
WIDE = 110  # [characters] from which on there is room for the type of a channel
CHANNEL_WIDTH = 24  # [characters] of names of channels, of which others have any length


def log_table(path: Path, width: int, trial: int | None = None) -> Table:
    """Return the channels of a log, for a terminal of this width [characters].

    Args:
        path: Of the log.
        width: Of the terminal [characters].
        trial: Which trial, from 0; None for the whole log.

    Raises:
        BusError: It is missing or no log, or has no such trial.
    """
    statistics = BusStatistics()
    begin: int | None = None
    end = trials = 0
    with LogReader(path, CHANNELS) as reader:
        events = TrialEvents(reader, trial)
        for event in events:
            end = event.utime + reader.shift
            begin = end if begin is None else begin
            if events.count > trials:
                trials = events.count
                statistics.begin_trial()
            statistics.add(event.channel, event.data, end * 1e-6)
    several = f", {trials} trials" if trial is None and trials > 1 else ""
    span = end - begin if begin is not None else 0
    table = _empty_table(f"{path}, {span * 1e-6:.3f} s{several}", "to end", width)
    for channel in statistics.channels:
        _add_row(table, channel, channel.mean_rate, end * 1e-6 - channel.last_time, width)
    return table


def live_table(statistics: BusStatistics, url: str, now: float, width: int) -> Table:
    """Return the channels as they are now [s], silent channels of ours included."""
    table = _empty_table(url, "age", width)
    heard = {channel.channel: channel for channel in statistics.channels}
    for name in CHANNELS:
        if name not in heard:
            kind = [CHANNELS[name].message_type.__name__] if width >= WIDE else []
            table.add_row(name, *kind, "0", "-", "-", "-", "-", "", style="dim")
    for channel in heard.values():
        age = now - channel.last_time
        _add_row(table, channel, channel.rate(now), age, width, style="dim" if age > STALE else "")
    return table


def watch(url: str, console: Console, seconds: float | None = None) -> None:
    """Show the channels of a bus until Ctrl-C, or for some time [s].

    Raises:
        BusError: The bus cannot be opened.
    """
    bus = Bus(url)
    statistics = BusStatistics()
    clock = time.monotonic
    bus.subscribe_raw(lambda channel, data: statistics.add(channel, data, clock()))
    end = None if seconds is None else clock() + seconds

    def picture() -> RenderableType:
        return fit(live_table(statistics, url, clock(), console.width), console)

    with Live(picture(), console=console, auto_refresh=False) as live:
        while end is None or clock() < end:
            due = clock() + REFRESH
            while (left := due - clock()) > 0.0:
                bus.wait(left)
            live.update(picture(), refresh=True)


def _empty_table(title: str, age: str, width: int) -> Table:
    table = Table(title=escape(plain(title)), title_justify="left", box=box.SIMPLE_HEAD, padding=0, expand=True)
    table.add_column("channel", no_wrap=True)
    if width >= WIDE:
        table.add_column("type", no_wrap=True)
    for column in ("count", "rate\nHz", f"{age}\ns", "jitter\nms", "missing"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("last values", ratio=1)
    return table


def _add_row(table: Table, channel: ChannelStatistics, rate: float, age: float, width: int, style: str = "") -> None:
    known = CHANNELS.get(channel.channel)
    name = plain(channel.channel)
    kind = "?" if known is None else known.message_type.__name__
    broken = f"({channel.undecoded} not decoded) " if channel.undecoded else ""
    missing = "-" if channel.missing is None else str(channel.missing)
    table.add_row(
        escape(name if len(name) <= CHANNEL_WIDTH else f"{name[: CHANNEL_WIDTH - 1]}…"),
        *([kind] if width >= WIDE else []),
        str(channel.count),
        f"{rate:.1f}",
        f"{age:.3f}",
        f"{1e3 * channel.jitter:.2f}",
        f"[red]{missing}[/red]" if channel.missing else missing,
        WholeWords(plain(broken + channel.last_values())),
        style=style,
    )
