"""Tables that fit the terminal: text wraps, columns are left out where there is no room, and no number is cut."""

from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import shorten

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.measure import Measurement, measure_renderables
from rich.table import Column, Table
from rich.text import Text

UNBOUNDED = 100_000  # [characters]


@dataclass(frozen=True)
class WholeWords:
    """A text of which a line shows as many words as it has room for, so that no number is cut."""

    text: str
    style: str = ""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        """Yield the words that there is room for."""
        yield Text(shorten(self.text, options.max_width, break_on_hyphens=False, placeholder=" …"), self.style)

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        """Return how narrow and how wide it may be."""
        return Measurement(0, min(len(self.text), options.max_width))


def fit(renderable: RenderableType, console: Console) -> RenderableType:
    """Return what was given, the tables in it as wide as the terminal at most; the last columns are the first to go."""
    if isinstance(renderable, Group):
        return Group(*(fit(each, console) for each in renderable.renderables))
    if isinstance(renderable, Table):
        _fit_table(renderable, console)
    return renderable


def _fit_table(table: Table, console: Console) -> None:
    options = console.options.update(width=UNBOUNDED)

    def needs(column: Column) -> Measurement:
        widths = measure_renderables(console, options, [column.header, *column.cells])
        least = widths.maximum if column.no_wrap else widths.minimum
        return Measurement(least, widths.maximum).clamp(column.min_width)

    found = {id(column): needs(column) for column in table.columns}
    between = Measurement.get(console, options, table).maximum - sum(each.maximum for each in found.values())
    dropped: list[Column] = []

    def room() -> int:
        """Return how many characters are left if every column is as narrow as it can be."""
        return console.width - between - sum(found[id(column)].minimum for column in table.columns)

    while room() < 0 and len(table.columns) > 1:
        dropped.insert(0, table.columns.pop())
    if dropped:
        names = ", ".join(" ".join(str(column.header).split()) for column in dropped)
        told = f"Not shown, the terminal being {console.width} characters wide: {names}."
        table.caption = f"{table.caption} {told}" if table.caption else told
        table.caption_justify = "left"
    wanted = sum(found[id(column)].maximum - found[id(column)].minimum for column in table.columns)
    if wanted > room() >= 0:  # left to itself, Rich would cut a long word before it wraps a long text
        share = room() / wanted
        for column in table.columns:
            least, most = found[id(column)]
            column.width = least + int(share * (most - least))
