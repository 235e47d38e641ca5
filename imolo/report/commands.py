"""`imolo report`; it imports what it needs itself, so that `--help` stays quick."""

from pathlib import Path
from typing import Annotated

import typer

from imolo.command_line.terminal import ProgressBars, complain, say

app = typer.Typer()


@app.command()
def report(
    results: Annotated[Path, typer.Argument(help="Folder that compare, hit or a study wrote.")],
    out: Annotated[
        Path | None, typer.Option(help="Page to write.", show_default="report.html in the results folder")
    ] = None,
) -> None:
    """Write a results folder as one HTML page.

    Numbers, figures, 3-D replay of every trial, provenance. The page needs no network, and links to the logs where
    they lie.
    """
    from imolo.report.page import write_report

    with ProgressBars(lambda: "no page was written") as bars:
        written = write_report(results, out or results / "report.html", bars.show)
    if written.missing:
        complain(f"{len(written.missing)} logs are missing, first {written.missing[0]}; their trials have no replay")
    say(f"the page is {written.path} ({written.size / 1e6:.1f} MB)")
