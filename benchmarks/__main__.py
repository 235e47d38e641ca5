"""Measure everything that has a target, print one table and write a JSON file, or compare with another revision."""

import argparse
import json
import platform
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks import against, campaign, hardware, live, loop, planner, table
from benchmarks.learned import learn
from benchmarks.measurement import Measurement
from imolo.campaigns.results import installed_versions
from imolo.contracts.registry import BACKENDS

BEGIN, END = "<!-- bench -->", "<!-- /bench -->"
VERDICT_STYLE = {"ok": "green", "slow": "red", "": ""}


def measure(console: Console) -> Iterator[Measurement]:
    """Run all benchmarks, one after the other."""
    for engine in loop.TARGETS:
        if problem := BACKENDS.status(engine).problem:
            console.print(f"no loop of {engine}: {problem}")
            continue
        with console.status(f"loop, {engine}"):
            yield from loop.run(engine)
    with console.status("valve board"):
        yield from hardware.run()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with console.status("cameras that stop"):
            yield from hardware.run_cameras(folder)
        with console.status("campaign"):
            yield from campaign.run(folder / "campaign")
        with console.status("learning"):
            learned = learn(folder)
        for method in learned.config.methods:
            with console.status(f"table and planner, {method}"):
                measurements, built = table.run(learned, method)
                yield from measurements
                yield from planner.run(learned, method, built, folder)
        with console.status("emulated robot"):
            yield from hardware.run_campaign(folder, folder / f"{method}.npz", method)
        obstacle = live.obstacle()
        if obstacle:
            console.print(f"the session over the network is not measured: {obstacle}")
            return
        with console.status("session over the network"):
            yield from live.run(folder, folder / f"{method}.npz", method)


def render(measurements: list[Measurement]) -> Table:
    """Lay the measurements out."""
    shown = Table("subject", "quantity")
    for column in ("value", "target"):
        shown.add_column(column, justify="right")
    shown.add_column("verdict")
    for one in measurements:
        target = "" if one.target is None else f"≤ {one.target:g} {one.unit}"
        value = f"{one.value:.4g} {one.unit}"
        shown.add_row(one.subject, one.quantity, value, target, one.verdict, style=VERDICT_STYLE[one.verdict])
    return shown


def write_page(page: Path, measurements: list[Measurement]) -> None:
    """Replace the table between the marks of a Markdown page by the one that `render` shows.

    Raises:
        SystemExit: The page has no marks.
    """
    before, begin, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise SystemExit(f"{page} has no {BEGIN} followed by {END}")
    columns = render(measurements).columns
    rows = [[one.header for one in columns], ["---"] * len(columns)]
    rows += zip(*(one.cells for one in columns), strict=True)
    lines = "".join(f"| {' | '.join(map(str, row))} |\n" for row in rows)
    page.write_text(f"{before}{begin}\n{lines}{end}{after}", encoding="utf-8")


def main() -> None:
    """Run as `python -m benchmarks`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--json", type=Path, default=Path(__file__).with_name("results.json"), help="file to write")
    parser.add_argument("--page", type=Path, help=f"page whose table between {BEGIN} and {END} is written anew")
    parser.add_argument("--against", metavar="REV", help="print ratios to this revision instead, measured in turns")
    parser.add_argument("--only", nargs="+", choices=against.SUBJECTS, default=against.USUAL, help="with --against")
    parser.add_argument("--rounds", type=int, default=3, help="with --against: how often each is measured")
    parser.add_argument("--log", type=Path, help="what top, plot, diff and export read, with --against")
    given = parser.parse_args()
    path: Path = given.json
    console = Console()
    if given.against:
        against.compare(given.against, given.only, given.rounds, console, given.log)
        return
    began = time.perf_counter()
    measurements = list(measure(console))
    console.print(render(measurements))
    content = {
        "machine": platform.processor() or platform.machine(),
        "versions": installed_versions(),
        "measurements": [{**asdict(one), "verdict": one.verdict} for one in measurements],
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if given.page:
        write_page(given.page, measurements)
    console.print(f"written to {path}, after {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
