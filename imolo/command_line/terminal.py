"""How commands speak to the user: lines, tables, complaints, progress."""

import logging
import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

import typer
from rich.console import Console

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.progress import TaskID

INTERRUPTED = 130  # exit code after Ctrl-C, as of a shell
PERIOD = 10.0  # [s] between two lines on progress where there is no terminal

console = Console()
errors = Console(stderr=True)


def plain(text: str) -> str:
    """Return text from elsewhere with its control characters made visible, so that a terminal does not obey them."""
    return "".join(character if character.isprintable() else ascii(character)[1:-1] for character in text)


class PlainFormatter(logging.Formatter):
    """Writes warnings, which may quote files and messages of others, as `plain` does."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        return plain(super().format(record))


def say(text: str) -> None:
    """Print a line as it is, unbroken however narrow the terminal."""
    console.print(plain(text), highlight=False, markup=False, soft_wrap=True)


def show(renderable: "RenderableType") -> None:
    """Print tables; columns for which the terminal is too narrow are left out, and named."""
    from imolo.command_line.tables import fit

    console.print(fit(renderable, console))


def complain(text: str) -> None:
    """Print one line about what is wrong to the standard error stream."""
    errors.print(f"imolo: {plain(text)}", highlight=False, markup=False, soft_wrap=True)


class ProgressBars:
    """Bars, one for each thing under way; where the output is no terminal, a line now and then and one at the end.

    Ctrl-C ends in one line that says how far things were.
    """

    def __init__(self, state: Callable[[], str]) -> None:
        """Show bars while the context is open.

        Args:
            state: Says how far things are, for the line after Ctrl-C.
        """
        self._state = state
        self._counts: dict[str, tuple[int, int]] = {}
        self._end = threading.Event()
        self._open = ExitStack()
        self._show: Callable[[str, int, int], None] = lambda *_: None

    def __enter__(self) -> "ProgressBars":
        if console.is_terminal:
            self._show = _bars(self._open)
        else:
            lines = threading.Thread(target=self._tell, daemon=True)
            lines.start()
            self._open.callback(lines.join)
            self._open.callback(self._end.set)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._open.close()
        if kind is KeyboardInterrupt:
            complain(f"interrupted; {self._state()}")
            raise typer.Exit(INTERRUPTED)

    def show(self, what: str, done: int, total: int) -> None:
        """Show how far something is."""
        self._counts[what] = done, total
        self._show(what, done, total)

    def _tell(self) -> None:
        ended = False
        while not ended:
            ended = self._end.wait(PERIOD)
            counts = [f"{what} {done}/{total}" for what, (done, total) in list(self._counts.items())]
            say(", ".join(counts) or "at work")


def _bars(stack: ExitStack) -> Callable[[str, int, int], None]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    bars = stack.enter_context(Progress(*columns, console=console))
    tasks: dict[str, TaskID] = {}

    def show(what: str, done: int, total: int) -> None:
        if what not in tasks:
            tasks[what] = bars.add_task(what, total=total)
        bars.update(tasks[what], completed=done, total=total)

    return show
