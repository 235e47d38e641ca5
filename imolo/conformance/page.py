"""The capability page: what every engine measures, as Markdown, with the numbers as JSON beside it."""

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from pathlib import Path

from imolo.conformance.check import Outcome, Verdict
from imolo.conformance.record import Cell, Record, load_records, save_records, write_text
from imolo.conformance.report import WORDS, number, short
from imolo.conformance.suite import Suite
from imolo.errors import ConfigError

SHARE = 0.1  # of the tolerance by which a number may move and still tell the same
DIGITS = 1e-3  # relative: the page shows few more digits than three
COEFFICIENTS = ("mu got", "e got")  # how quantities begin that are pulled out into a table of their own

INTRODUCTION = """\
# What the engines can do

Every engine is put through the same scenes, each with a truth in closed form. This page is written by

```
imolo check {engines} --page {path}
```

and `tests/backends/test_engines_page.py` fails when a verdict or a number no longer holds. A number is within its
tolerance of the truth; a **bold** one is not, which the engine declares as a [limitation](#limitations). The truth of a
number with a bias that the integrator is known to have includes the bias. What `imolo check` prints of a failure says
where its tolerance is from.
"""


def refuse_partial(suites: Iterable[Suite], only: Sequence[str]) -> None:
    """Raise a ConfigError where the page would not tell of all scenes under the default options."""
    if only:
        raise ConfigError("--page tells of all scenes; leave --only out")
    for suite in suites:
        if not suite.is_default or suite.label != suite.backend:
            raise ConfigError(f"--page tells of default options; give {suite.backend!r} by its name")


def counterpart(page: Path) -> Path:
    """Return where the numbers of a page are."""
    return page.with_suffix(".json")


def write_page(page: Path, records: Sequence[Record]) -> None:
    """Write a page and its numbers; engines of an older page that were not checked now stay in it.

    Raises:
        ResultsError: A file cannot be read or written.
    """
    numbers = counterpart(page)
    merged = {record.label: record for record in (load_records(numbers) if numbers.exists() else [])}
    merged.update({record.label: record for record in records})
    kept = [merged[label] for label in sorted(merged)]
    save_records(numbers, kept)
    write_text(page, render_page(kept, page))


def render_page(records: Sequence[Record], page: Path) -> str:
    """Return the page as Markdown."""
    parts = [
        INTRODUCTION.format(engines=" ".join(record.label for record in records), path=page.as_posix()),
        *_engines(records),
        *_matrix(records),
        *_contact(records),
        *_limitations(records),
    ]
    return "\n".join(parts)


def differences(recorded: Record, now: Record) -> list[str]:
    """Return what of a page no longer holds, one line per number.

    A number holds while its verdict is the same and it has not moved by more than a thousandth of itself, since the
    page shows hardly more digits, or by a tenth of its tolerance, below which it tells nobody anything: what is left of
    exact laws is rounding, and differs between processors.

    Args:
        recorded: What the page says.
        now: What was measured now.
    """
    before, after = recorded.cells, now.cells
    found = []
    for name in dict.fromkeys([*before, *after]):
        where = f"{now.label}, {name[0]}" + (f", {name[1]}" if name[1] else "")
        if name not in after:
            found.append(f"{where}: on the page, but no longer measured")
        elif name not in before:
            found.append(f"{where}: measured ({_brief(after[name])}), but not on the page")
        elif not _same(before[name], after[name]):
            found.append(f"{where}: the page says {_brief(before[name])}, measured is {_brief(after[name])}")
    return found


def _same(before: Outcome, after: Outcome) -> bool:
    one, other = before.measurement, after.measurement
    if before.verdict is not after.verdict or before.remark != after.remark:
        return False
    if one is None or other is None:
        return one is other
    slack = max(SHARE * min(one.tolerance, other.tolerance), DIGITS * abs(one.measured))
    return (
        abs(one.measured - other.measured) <= slack
        and abs(one.truth - other.truth) <= slack
        and abs(one.tolerance - other.tolerance) <= DIGITS * one.tolerance
    )


def _brief(outcome: Outcome) -> str:
    measured = outcome.measurement
    if measured is None:
        return f"{outcome.verdict.value} ({outcome.remark})"
    numbers = f"{short(measured.measured, 6)} of {short(measured.truth, 6)} ± {short(measured.tolerance)}"
    remark = f" ({outcome.remark})" if outcome.remark else ""
    return f"{outcome.verdict.value}, {numbers} {measured.unit}".rstrip() + remark


def _engines(records: Sequence[Record]) -> Iterable[str]:
    yield _head(
        ["engine", "packages", "scenes", "quantities", "within tolerance", "declared unsupported"], numeric_from=2
    )
    for record in records:
        packages = ", ".join(f"{package} {version}" for package, version in record.versions.items())
        counts = [len({outcome.check for outcome in record.outcomes}), len(record.outcomes)]
        counts += [record.count(verdict) for verdict in (Verdict.PASS, Verdict.UNSUPPORTED)]
        yield _row([record.label, packages, *map(str, counts)])
    yield ""


def _matrix(records: Sequence[Record]) -> Iterable[str]:
    tables = [record.cells for record in records]
    known = {name: outcome for table in reversed(tables) for name, outcome in table.items()}
    order = sorted(known, key=_order(tables))
    for group, in_group in groupby(order, key=lambda name: known[name].group):
        yield f"## {group.capitalize()}\n"
        yield _head(["scene", "quantity", "truth", "±", *(record.label for record in records)], numeric_from=2)
        for check, in_check in groupby(in_group, key=lambda name: name[0]):
            for index, name in enumerate(in_check):
                scene = f"`{check}`: {_escape(known[name].title)}" if index == 0 else ""
                yield _row([scene, *_quantity(name, tables), *(_number(table.get(name)) for table in tables)])
        yield ""


def _order(tables: Sequence[dict[Cell, Outcome]]) -> Callable[[Cell], tuple[int, int, int]]:
    groups: dict[str, int] = {}
    checks: dict[str, int] = {}
    cells: dict[Cell, int] = {}
    group_of: dict[str, str] = {}
    for table in tables:
        for name, outcome in table.items():
            groups.setdefault(outcome.group, len(groups))
            checks.setdefault(name[0], len(checks))
            cells.setdefault(name, len(cells))
            group_of.setdefault(name[0], outcome.group)
    return lambda name: (groups[group_of[name[0]]], checks[name[0]], cells[name])


def _quantity(name: Cell, tables: Sequence[dict[Cell, Outcome]]) -> tuple[str, str, str]:
    measured = [m for table in tables if name in table and (m := table[name].measurement)]
    if not measured:
        return "", "", ""
    unit = f" [{measured[0].unit}]" if measured[0].unit else ""
    truths = dict.fromkeys(number(one.truth, one.tolerance) for one in measured)
    tolerances = dict.fromkeys(short(one.tolerance) for one in measured)
    return f"{_escape(name[1])}{unit}", " / ".join(truths), " / ".join(tolerances)


def _number(outcome: Outcome | None) -> str:
    if outcome is None:
        return "-"
    measured = outcome.measurement
    text = number(measured.measured, measured.tolerance) if measured else ""
    word = "" if outcome.verdict in (Verdict.PASS, Verdict.UNSUPPORTED) else WORDS[outcome.verdict]
    return text if outcome.verdict is Verdict.PASS else f"**{f'{word} {text}'.strip()}**"


def _contact(records: Sequence[Record]) -> Iterable[str]:
    """Yield the coefficients that were measured, beside the ones that were asked for."""
    tables = [record.cells for record in records]
    rows = []
    for name in sorted({name for table in tables for name in table}, key=_order(tables)):
        found = [table.get(name) for table in tables]
        first = next(outcome for outcome in found if outcome)
        if first.measurement and name[1].startswith(COEFFICIENTS):
            asked = short(first.measurement.truth, 4)
            rows.append(_row([f"`{name[0]}`", _escape(name[1]), asked, *(_number(outcome) for outcome in found)]))
    if rows:
        yield "## Contact asked for, contact got\n"
        yield _head(["scene", "coefficient", "asked", *(record.label for record in records)], numeric_from=2)
        yield from rows
        yield ""


def _limitations(records: Sequence[Record]) -> Iterable[str]:
    yield "## Limitations\n"
    rows = []
    for record in records:
        unsupported = [o for o in record.outcomes if o.verdict is Verdict.UNSUPPORTED]
        # One cause after the other.
        causes = list(dict.fromkeys(outcome.remark for outcome in unsupported))
        unsupported.sort(key=lambda outcome: causes.index(outcome.remark))
        for cause, with_cause in groupby(unsupported, key=lambda outcome: outcome.remark):
            for index, outcome in enumerate(with_cause):
                why = _escape(cause) if index == 0 else ""
                rows.append(_row([record.label, why, f"`{outcome.check}`", *_asked_and_got(outcome)]))
    if not rows:
        yield "None is declared.\n"
        return
    yield _head(["engine", "why", "scene", "quantity", "truth", "measured"], numeric_from=6)
    yield from rows
    yield ""


def _asked_and_got(outcome: Outcome) -> tuple[str, str, str]:
    measured = outcome.measurement
    if measured is None:
        return "", "", ""
    unit = f" {measured.unit}" if measured.unit else ""
    truth = f"{number(measured.truth, measured.tolerance)} ± {short(measured.tolerance)}{unit}"
    return _escape(measured.quantity), truth, f"{number(measured.measured, measured.tolerance)}{unit}"


def _head(titles: Sequence[str], numeric_from: int) -> str:
    rule = ["---" if index < numeric_from else "---:" for index in range(len(titles))]
    return f"{_row(titles)}\n|{'|'.join(rule)}|"


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _escape(text: str) -> str:
    return text.replace("|", "\\|")
