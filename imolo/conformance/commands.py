"""`imolo check`; it imports what it needs itself, so that `--help` stays quick."""

from pathlib import Path
from typing import Annotated

import typer

from imolo.command_line.options import CORES, Jobs
from imolo.command_line.terminal import ProgressBars, say, show

app = typer.Typer()


@app.command()
def check(
    engines: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="CONFIG",
            help="Backends by name, or YAMLs whose backend section gives name and options.",
            show_default="every backend that is ready",
        ),
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="A scene or a group of scenes; may be given several times.")
    ] = None,
    robot: Annotated[
        str | None, typer.Option(help="Check this robot in the backends, in place of the backends themselves.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the numbers to this file.")] = None,
    page: Annotated[
        Path | None, typer.Option(help="Write them as a page, with its JSON beside it; engines not checked stay in it.")
    ] = None,
    jobs: Jobs = CORES,
) -> None:
    """Put engines or a robot through scenes whose truth is known.

    Reports what they measure. A scene that crashes or hangs fails; the others go on. Exit code 1 if anything
    fails, not for warnings.
    """
    from imolo.conformance import page as pages
    from imolo.conformance.check import Verdict
    from imolo.conformance.record import record, save_records
    from imolo.conformance.report import render_report
    from imolo.conformance.robot_suite import robot_suites
    from imolo.conformance.runner import run_suites
    from imolo.conformance.suite import check_names, suites

    chosen = suites(engines or ())
    if robot is not None:
        chosen = robot_suites(robot, [suite.backend for suite in chosen])
    check_names(only or (), chosen)
    if page is not None:
        pages.refuse_partial(chosen, only or ())
    done = {suite.label: 0 for suite in chosen}
    total = {suite.label: len(suite.select(only or ())) for suite in chosen}
    with ProgressBars(lambda: f"{sum(done.values())} of {sum(total.values())} scenes were done") as bars:

        def count(label: str) -> None:
            done[label] += 1
            bars.show(label, done[label], total[label])

        outcomes = run_suites(chosen, only or (), jobs, lambda suite, _: count(suite.label))
    records = [record(suite, outcomes[suite.label]) for suite in chosen]
    show(render_report(records))
    if json is not None:
        save_records(json, records)
        say(f"numbers are in {json}")
    if page is not None:
        pages.write_page(page, records)
        say(f"the page is {page}")
    if any(one.count(Verdict.FAIL) for one in records):
        raise typer.Exit(1)
