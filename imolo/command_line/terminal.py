"""How commands speak to the user: lines, complaints, progress bars."""

from collections.abc import Callable

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

INTERRUPTED = 130  # exit code after Ctrl-C, as of a shell

console = Console()
errors = Console(stderr=True)


def plain(text: str) -> str:
    """Return text from elsewhere with its control characters made visible, so that a terminal does not obey them."""
    return "".join(character if character.isprintable() else ascii(character)[1:-1] for character in text)


def say(text: str) -> None:
    """Print a line as it is, unbroken however narrow the terminal."""
    console.print(plain(text), highlight=False, markup=False, soft_wrap=True)


def complain(text: str) -> None:
    """Print one line about what is wrong to the standard error stream."""
    errors.print(f"imolo: {plain(text)}", highlight=False, markup=False, soft_wrap=True)


class ProgressBars:
    """Progress bars, one for each thing under way; Ctrl-C ends in one line that says how far things were."""

    def __init__(self, state: Callable[[], str]) -> None:
        """Show bars while the context is open.

        Args:
            state: Says how far things are, for the line after Ctrl-C.
        """
        self._state = state
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
        )
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> "ProgressBars":
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._progress.stop()
        if kind is KeyboardInterrupt:
            complain(f"interrupted; {self._state()}")
            raise typer.Exit(INTERRUPTED)

    def show(self, what: str, done: int, total: int) -> None:
        """Show how far something is."""
        if what not in self._tasks:
            self._tasks[what] = self._progress.add_task(what, total=total)
        self._progress.update(self._tasks[what], completed=done, total=total)
