"""`imolo identify`."""

from pathlib import Path
from typing import Annotated

import typer

from imolo.campaigns.command_options import Fresh, Out, Scheduler
from imolo.command_line.options import CORES, Jobs
from imolo.command_line.terminal import ProgressBars, say, show

app = typer.Typer()


@app.command()
def identify(
    study: Annotated[Path, typer.Argument(help="YAML of the study: recordings, parameters, engines.")],
    out: Out = Path("results/identify"),
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Fit settings of engines and robot to recordings.

    The fits are judged on recordings held out. Writes identification.json, a figure, and a part of a config for
    each engine to the results folder.
    """
    import shutil

    from imolo.campaigns.results import ResultsFolder
    from imolo.config.experiment import ParallelConfig
    from imolo.identification import facts_report, report
    from imolo.identification.facts_fit import fit_to_facts
    from imolo.identification.facts_study import FactsStudy
    from imolo.identification.study import identify as fit_to_recordings
    from imolo.identification.study_file import load_study

    chosen = load_study(study)
    folder = ResultsFolder(out)
    folder.prepare()
    evaluations = out / "evaluations"
    if fresh:
        shutil.rmtree(evaluations, ignore_errors=True)
    elif there := len(list(evaluations.glob("*.*"))):
        say(f"{there} evaluations are in {out} already and will not be done again")
    parallel = ParallelConfig() if scheduler is None else ParallelConfig(backend="dask", address=scheduler)
    bars = ProgressBars(lambda: f"the evaluations so far are kept in {out}")
    if isinstance(chosen, FactsStudy):
        with bars:
            facts = fit_to_facts(chosen, study, folder, jobs, parallel, bars.show)
        tables, figure, files = (
            facts_report.render(facts),
            facts_report.figure(facts),
            "best.yaml and ensemble.yaml hold",
        )
    else:
        with bars:
            fits = fit_to_recordings(chosen, study, folder, jobs, parallel, bars.show)
        tables, figure = report.render(fits), report.figure(fits)
        files = "patches/ENGINE.yaml holds"
    show(tables)
    folder.save_drawing("identification", figure)
    folder.save_origin()
    say(f"results are in {out}; {files} what to put into a config")
