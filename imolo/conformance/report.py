"""The outcomes in the terminal."""

import math
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from imolo.command_line.tables import WholeWords
from imolo.conformance.check import Outcome, Verdict
from imolo.conformance.record import Record, worst

STYLE: Any = {"box": box.SIMPLE_HEAD, "title_justify": "left", "caption_justify": "left", "padding": 0}
COLOURS = {Verdict.PASS: "green", Verdict.UNSUPPORTED: "yellow", Verdict.WARNING: "magenta", Verdict.FAIL: "bold red"}
WORDS = {verdict: verdict.value for verdict in Verdict} | {Verdict.FAIL: "FAIL"}


def number(value: float, tolerance: float) -> str:
    """Return a number with the digits that its tolerance makes matter, two to six of them."""
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    digits = 6
    if tolerance > 0.0:
        digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(tolerance)) + 2
    return short(value, min(max(digits, 2), 6))


def short(value: float, digits: int = 2) -> str:
    """Return a number with that many digits and no idle ones in its exponent."""
    mantissa, e, exponent = f"{value:.{digits}g}".partition("e")
    return f"{mantissa}e{int(exponent)}" if e else mantissa


def render_report(records: Sequence[Record]) -> RenderableType:
    """Return a table per backend, the matrix where there are several, then what is not as it should be."""
    parts: list[RenderableType] = [render_engine(record) for record in records]
    if len(records) > 1:
        parts.append(render_matrix(records))
    for verdict, title in (
        (Verdict.UNSUPPORTED, "Declared unsupported"),
        (Verdict.WARNING, "Warnings"),
        (Verdict.FAIL, "Failed"),
    ):
        details = list(_details(records, verdict))
        if details:
            parts += [Text(title, style="bold"), *details, Text()]
    parts += [_summary(record) for record in records]
    return Group(*parts)


def render_engine(record: Record) -> Table:
    """Return what was measured in one backend."""
    about = [f"{package} {version}" for package, version in record.versions.items()]
    about += [f"{key}: {value}" for key, value in record.options.items()]
    table = Table(title=escape(record.label + (f" ({', '.join(about)})" if about else "")), **STYLE)
    table.add_column("scene", no_wrap=True)
    table.add_column("quantity", ratio=1)
    for title in ("truth", "measured", "tolerance"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for group, in_group in groupby(record.outcomes, key=lambda outcome: outcome.group):
        table.add_row(f"[bold]{escape(group)}[/bold]")
        for check, in_check in groupby(in_group, key=lambda outcome: outcome.check):
            for index, outcome in enumerate(in_check):
                table.add_row(escape(f"  {check}") if index == 0 else "", *_cells(outcome))
        table.add_section()
    return table


def render_matrix(records: Sequence[Record]) -> Table:
    """Return the worst verdict of every scene in every backend."""
    table = Table(title="Scenes and engines", **STYLE)
    table.add_column("scene", no_wrap=True)
    for record in records:
        table.add_column(escape(record.label), min_width=11)
    by_scene = [_by_scene(record) for record in records]
    scenes = dict.fromkeys(scene for one in by_scene for scene in one)
    for group, in_group in groupby(scenes, key=lambda scene: scene[0]):
        table.add_row(f"[bold]{escape(group)}[/bold]")
        for scene in in_group:
            cells = [one.get(scene) for one in by_scene]
            table.add_row(f"  {escape(scene[1])}", *(_verdict(worst(found)) if found else "-" for found in cells))
        table.add_section()
    return table


def _by_scene(record: Record) -> dict[tuple[str, str], list[Outcome]]:
    found: dict[tuple[str, str], list[Outcome]] = {}
    for outcome in record.outcomes:
        found.setdefault((outcome.group, outcome.check), []).append(outcome)
    return found


def _cells(outcome: Outcome) -> tuple[RenderableType, ...]:
    measured = outcome.measurement
    if measured is None:
        return (
            WholeWords(outcome.remark, COLOURS[outcome.verdict]),
            "",
            "",
            "",
            "",
            _verdict(outcome.verdict),
        )
    return (
        escape(measured.quantity),
        number(measured.truth, measured.tolerance),
        number(measured.measured, measured.tolerance),
        short(measured.tolerance),
        f" {escape(measured.unit)} ",
        _verdict(outcome.verdict),
    )


def _verdict(verdict: Verdict) -> Text:
    return Text(WORDS[verdict], style=COLOURS[verdict])


def _details(records: Sequence[Record], verdict: Verdict) -> Iterable[RenderableType]:
    for record in records:
        chosen = [outcome for outcome in record.outcomes if outcome.verdict is verdict]
        for check, in_check in groupby(chosen, key=lambda outcome: outcome.check):
            yield Text(f"  {record.label} {check}", style=COLOURS[verdict])
            for outcome in in_check:
                yield Padding(Text(explain(outcome)), (0, 0, 0, 4))


def explain(outcome: Outcome) -> str:
    """Return what came of a check in one line."""
    measured = outcome.measurement
    if measured is None:
        return outcome.remark
    unit = f" {measured.unit}" if measured.unit else ""
    text = f"{measured.quantity}: {number(measured.measured, measured.tolerance)}{unit} instead of "
    text += f"{number(measured.truth, measured.tolerance)} ± {short(measured.tolerance)}{unit}"
    if outcome.verdict is Verdict.FAIL:
        off = abs(measured.measured - measured.truth)
        ratio = f"{short(off / measured.tolerance)} × " if measured.tolerance > 0.0 and not measured.within else ""
        text += f" ({ratio}the tolerance: {measured.basis})"
    return text + (f"; {outcome.remark}" if outcome.remark else "")


def _summary(record: Record) -> Text:
    text = Text(f"{record.label}: ", style="bold")
    scenes = len(_by_scene(record))
    text.append(f"{scenes} scene{'s' * (scenes != 1)}, {len(record.outcomes)} quantities: ", style="not bold")
    for verdict in Verdict:
        count = record.count(verdict)
        if verdict is not Verdict.PASS:
            text.append(", ", style="not bold")
        text.append(f"{count} {WORDS[verdict]}", style=f"not bold {COLOURS[verdict]}" if count else "dim")
    return text
