"""The command line."""

import logging
import os
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from imolo.errors import ConfigError, ImoloError, did_you_mean
from imolo.inspect import commands as inspect_commands
from imolo.live import commands as live_commands
from imolo.terminal import ProgressBars, complain, console, say

# The commands import what they need themselves: scikit-learn, numba and matplotlib take seconds, `--help` must not.
if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig
    from imolo.experiment.results import ResultsFolder

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Jump-and-hit motions of a pneumatic humanoid from a lookup table of learned dynamics (IMoLo), "
    "compared across physics engines over LCM.",
)
app.add_typer(live_commands.app)
app.add_typer(inspect_commands.app)
for _installed in entry_points(group="imolo.commands"):
    app.add_typer(_installed.load())

ConfigPaths = Annotated[
    list[Path] | None,
    typer.Argument(help="One YAML per backend, alike but for the backend [default: every backend that is ready]."),
]
ConfigPath = Annotated[Path, typer.Argument(help="YAML of the backend and everything around it, see configs/.")]
Out = Annotated[Path, typer.Option(help="Results folder.")]
Seed = Annotated[int | None, typer.Option(min=0, help="Replaces the seed of the configs.")]
Balls = Annotated[int | None, typer.Option(min=1, help="Replaces the number of balls of the configs.")]
Jobs = Annotated[int, typer.Option(min=1, help="Number of processes [default: one per core].", show_default=False)]
Fresh = Annotated[bool, typer.Option("--fresh", help="Delete the trials in the results folder and run all anew.")]
Scheduler = Annotated[
    str | None, typer.Option(help="Run the trials on the workers of this Dask scheduler, such as tcp://127.0.0.1:8786.")
]

CORES = os.cpu_count() or 1


@app.command()
def backends() -> None:
    """List the backends that are installed, and what is missing for the others."""
    from imolo.registry import backend_names, backend_status

    table = Table(box=None, pad_edge=False)
    for title in ("backend", "state", "about"):
        table.add_column(title)
    for name in backend_names():
        status = backend_status(name)
        if status.plugin is None:
            table.add_row(name, "[red]missing[/red]", escape(status.problem))
        else:
            table.add_row(name, "[green]ready[/green]", status.plugin.summary)
    console.print(table)


@app.command()
def check(
    engines: Annotated[
        list[str] | None,
        typer.Argument(
            help="Backends by name, or YAMLs whose backend section gives name and options [default: every one that is "
            "ready].",
        ),
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="A scene or a group of scenes; may be given several times.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the numbers to this file.")] = None,
    page: Annotated[
        Path | None, typer.Option(help="Write them as a page, with its JSON beside it; engines not checked stay in it.")
    ] = None,
    jobs: Jobs = CORES,
) -> None:
    """Put engines through scenes whose truth is known, and report what they measure.

    A scene that crashes or hangs fails; the others go on. Exit code 1 if anything fails.
    """
    from imolo.conformance import page as pages
    from imolo.conformance.check import Verdict
    from imolo.conformance.record import record, save_records
    from imolo.conformance.report import render_report
    from imolo.conformance.runner import run_suites
    from imolo.conformance.suite import check_names, suites

    chosen = suites(engines or ())
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
    console.print(render_report(records))
    if json is not None:
        save_records(json, records)
        console.print(f"numbers are in {json}")
    if page is not None:
        pages.write_page(page, records)
        console.print(f"the page is {page}")
    if any(one.count(Verdict.FAIL) for one in records):
        raise typer.Exit(1)


@app.command()
def compare(
    configs: ConfigPaths = None,
    out: Out = Path("results/compare"),
    seed: Seed = None,
    balls: Balls = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Learn the motions, throw balls and hit them on every backend, then compare.

    Writes logs, tables, resolved configs, figures, summary.json and timing.json to the results folder.
    """
    from imolo.experiment import comparison, figures, summary

    chosen = [_override(config, seed, balls, scheduler) for config in _load_all(configs)]
    folder = _results(out, fresh)
    with ProgressBars(_kept_in(out)) as bars:
        result, timings = comparison.compare(chosen, folder, jobs, bars.show)
    console.print(summary.render_comparison(result, timings.timing))
    figures.draw_all(result, chosen, folder)
    console.print(f"logs, tables, configs, figures, summary.json and timing.json are in {out}")


@app.command()
def learn(
    config: ConfigPath,
    motions: Annotated[
        int | None, typer.Option(min=1, help="Learn so many motions, spread evenly, in place of those of the config.")
    ] = None,
    out: Out = Path("results/learn"),
    seed: Seed = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Learn balls and motions on one backend and build the table of each method."""
    from imolo.config.experiment import load_config
    from imolo.experiment import comparison
    from imolo.experiment.learning import spread_motions

    chosen = _override(load_config(config), seed, None, scheduler)
    if motions is not None:
        training = chosen.training.model_copy(update={"motions": spread_motions(chosen, motions)})
        chosen = chosen.model_copy(update={"training": training})
    folder = _results(out, fresh)
    with ProgressBars(_kept_in(out)) as bars:
        comparison.learn([chosen], folder, jobs, bars.show)
    for method in chosen.methods:
        console.print(f"table of method {method!r}: {folder.table(chosen.backend.name, method)}")


@app.command()
def hit(
    config: ConfigPath,
    table: Annotated[Path, typer.Argument(help="Table that `imolo learn` or `imolo compare` wrote, on any backend.")],
    method: Annotated[str, typer.Option(help="Method of the config whose planner is used.")] = "improved",
    out: Out = Path("results/hit"),
    seed: Seed = None,
    balls: Balls = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Throw balls on one backend and hit them with a table, perhaps learned on another backend."""
    from imolo.config.experiment import load_config
    from imolo.experiment import comparison, summary
    from imolo.method.table import LookupTable

    chosen = _override(load_config(config), seed, balls, scheduler)
    if method not in chosen.methods:
        raise ConfigError(
            f"unknown method {method!r}{did_you_mean(method, chosen.methods)}; known: {', '.join(chosen.methods)}"
        )
    LookupTable.load(table, chosen.robot.name)
    folder = _results(out, fresh)
    folder.prepare()
    name = chosen.backend.name
    with ProgressBars(_kept_in(out)) as bars:
        results, timing = comparison.hit({name: chosen}, {(name, method): table}, folder, jobs, bars.show)
    folder.save_config(chosen)
    folder.save_json("summary.json", results[name][method])
    console.print(summary.render_results(results, timing))
    console.print(summary.render_causes(results))
    console.print(f"logs, config and summary.json are in {out}")


@app.command()
def ball(
    config: Annotated[
        Path | None, typer.Argument(help="YAML of a backend whose thrower is to throw, unless --data is given.")
    ] = None,
    data: Annotated[Path | None, typer.Option(help="CSV of recorded flights: flight,time_s,x_m,y_m,z_m.")] = None,
    models: Annotated[str, typer.Option(help="Ball models to rate, with commas.")] = "linear,drag,spin",
    horizons: Annotated[
        str | None, typer.Option(help="Lead times [s], with commas [default: recorded .1 to .4, simulated .25 to .75].")
    ] = None,
    throws: Annotated[int, typer.Option(min=4, help="Number of simulated throws.")] = 24,
    out: Out = Path("results/ball"),
    seed: Seed = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Rate ball models on recorded or simulated flights by leave-one-out: error against lead time, and calibration.

    Writes ball.json and ball.png to the results folder.
    """
    from imolo.config.experiment import load_config
    from imolo.experiment import ball_report, ball_study

    if (config is None) == (data is None):
        raise ConfigError("give either the config of a backend or --data FILE")
    study = ball_study.Study(
        models=ball_study.parse_models(models),
        horizons=ball_study.parse_horizons(horizons, recorded=data is not None),
    )
    folder = _results(out, fresh)
    folder.prepare()
    with ProgressBars(_kept_in(out)) as bars:
        if data is not None:
            result = study.rate_recorded(data, jobs, bars.show)
        elif config is not None:
            chosen = _override(load_config(config), seed, None, scheduler)
            result = study.rate_simulated(chosen, throws, folder, jobs, bars.show)
    console.print(ball_report.render_evaluation(result))
    folder.save_json("ball.json", result)
    ball_report.draw_evaluation(result, out / "ball.png")
    console.print(f"ball.json and ball.png are in {out}")


@app.command()
def interpolation(
    configs: ConfigPaths = None,
    repetitions: Annotated[int, typer.Option(min=2, help="For each number of trials; the paper's are 100.")] = 100,
    trials: Annotated[str, typer.Option(help="Numbers of training trials, with commas.")] = "8,16,24",
    pool: Annotated[int, typer.Option(min=2, help="Random motions that queries and trials are drawn from.")] = 200,
    out: Out = Path("results/interpolation"),
    seed: Seed = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Test whether nonlinear interpolation brings the hand nearer to where it should be (Sec. VI, Fig. 7).

    Takes some minutes for each backend; --repetitions 20 --pool 60 gives a quick look. Writes logs, interpolation.json
    and interpolation.png to the results folder.
    """
    from imolo.experiment import interpolation_report, interpolation_study

    numbers = interpolation_report.parse_trials(trials)
    chosen = [_override(config, seed, None, scheduler) for config in _load_all(configs)]
    folder = _results(out, fresh)
    with ProgressBars(_kept_in(out)) as bars:
        result = interpolation_study.study(chosen, numbers, repetitions, pool, folder, jobs, bars.show)
    console.print(interpolation_report.render_study(result))
    folder.save_figure("interpolation.png", interpolation_report.draw_study(result))
    console.print(f"logs, configs, interpolation.json and figures/interpolation.png are in {out}")


@app.command()
def transfer(
    configs: ConfigPaths = None,
    motions: Annotated[int, typer.Option(min=4, help="Of a dense table.")] = 200,
    out: Out = Path("results/transfer"),
    seed: Seed = None,
    balls: Balls = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Throw balls on every backend for tables learned on every other, as they are and corrected by a few trials.

    Takes some minutes for each pair of backends. Writes logs, tables, transfer.json and a heat map.
    """
    from imolo.experiment import transfer as study
    from imolo.experiment import transfer_report

    chosen = [_override(config, seed, balls, scheduler) for config in _load_all(configs)]
    folder = _results(out, fresh)
    with ProgressBars(_kept_in(out)) as bars:
        result = study.transfer(chosen, motions, folder, jobs, bars.show)
    console.print(transfer_report.render_transfer(result))
    folder.save_figure("transfer.png", transfer_report.draw_transfer(result))
    console.print(f"logs, tables, configs, transfer.json and figures/transfer.png are in {out}")


@app.command()
def trials(
    configs: ConfigPaths = None,
    numbers: Annotated[str, typer.Option(help="Numbers of trials, with commas.")] = "5,10,15,20,30",
    motions: Annotated[int, typer.Option(min=4, help="Of a prior.")] = 200,
    candidates: Annotated[int, typer.Option(min=1, help="Motions that an active choice may pick from.")] = 60,
    tests: Annotated[int, typer.Option(min=1, help="Motions that the models are tested on.")] = 60,
    out: Out = Path("results/trials"),
    seed: Seed = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Say how many trials a backend needs: hand error of models with and without a prior from another backend.

    Writes logs, trials.json and trials.png to the results folder.
    """
    from imolo.experiment import interpolation_report, sample_efficiency_report
    from imolo.experiment import sample_efficiency as study

    counts = interpolation_report.parse_trials(numbers)
    chosen = [_override(config, seed, None, scheduler) for config in _load_all(configs)]
    folder = _results(out, fresh)
    sizes = study.Sizes(dense=motions, candidates=candidates, tests=tests)
    with ProgressBars(_kept_in(out)) as bars:
        result = study.study(chosen, counts, sizes, folder, jobs, bars.show)
    console.print(sample_efficiency_report.render_study(result))
    folder.save_figure("trials.png", sample_efficiency_report.draw_study(result))
    console.print(f"logs, configs, trials.json and figures/trials.png are in {out}")


@app.command()
def attribute(
    first: Annotated[str, typer.Argument(help="A backend by name, or a YAML that configures it.")],
    second: Annotated[str, typer.Argument(help="The other one.")],
    motions: Annotated[
        int | None, typer.Option(min=1, help="Only the first motions of Table III [default: all].", show_default=False)
    ] = None,
    out: Out = Path("results/attribute"),
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Say why two backends bring the hand to different places under the same commands.

    Swaps one ingredient at a time: time step, sole, friction cone, stiffness of contacts and joint limits, and whatever
    else the backends declare. Writes logs, attribution.json and a waterfall.
    """
    from imolo.experiment import figures, summary
    from imolo.experiment.attribution import attribute as attribute_disagreement

    configs = (
        _override(_named_or_file(first, motions), None, None, scheduler),
        _override(_named_or_file(second, motions), None, None, scheduler),
    )
    folder = _results(out, fresh)
    with ProgressBars(_kept_in(out)) as bars:
        answer = attribute_disagreement(configs, folder, jobs, bars.show)
    console.print(summary.render_attribution(answer))
    path = folder.save_figure("waterfall.png", figures.draw_waterfall(answer))
    console.print(f"numbers are in {out / 'attribution.json'}, the waterfall is {path}")


@app.command()
def report(
    results: Annotated[Path, typer.Argument(help="Folder that compare, hit, ball or attribute wrote.")],
    out: Annotated[
        Path | None, typer.Option(help="Page to write.", show_default="report.html in the results folder")
    ] = None,
) -> None:
    """Write a results folder as one HTML page: numbers, figures, 3-D replay of every trial, provenance.

    The page needs no network, and links to the logs where they lie.
    """
    from imolo.report.page import write_report

    with ProgressBars(lambda: "no page was written") as bars:
        written = write_report(results, out or results / "report.html", bars.show)
    if written.missing:
        complain(f"{len(written.missing)} logs are missing, first {written.missing[0]}; their trials have no replay")
    say(f"the page is {written.path} ({written.size / 1e6:.1f} MB)")


def _kept_in(out: Path) -> Callable[[], str]:
    return lambda: f"the {len(list(out.rglob('*.lcmlog')))} logs recorded so far are kept in {out}"


def _load_all(paths: Sequence[Path] | None) -> "list[ExperimentConfig]":
    from imolo.config.experiment import BackendConfig, ExperimentConfig, load_config
    from imolo.registry import ready_simulations

    if paths:
        return [load_config(path) for path in paths]
    return [ExperimentConfig(backend=BackendConfig(name=name)) for name in ready_simulations()]


def _named_or_file(text: str, motions: int | None) -> "ExperimentConfig":
    from imolo.config.experiment import BackendConfig, ExperimentConfig, load_config

    if text.endswith((".yaml", ".yml")):
        config = load_config(Path(text))
    else:
        config = ExperimentConfig(backend=BackendConfig(name=text))
        config.backend_options()
    if motions is None:
        return config
    training = config.training.model_copy(update={"motions": config.training.motions[:motions]})
    return config.model_copy(update={"training": training})


def _override(
    config: "ExperimentConfig", seed: int | None, balls: int | None, scheduler: str | None
) -> "ExperimentConfig":
    from imolo.config.experiment import ParallelConfig

    changes: dict[str, object] = {}
    if seed is not None:
        changes["seed"] = seed
    campaign: dict[str, object] = {}
    if balls is not None:
        campaign["balls"] = balls
    if scheduler is not None:
        campaign["parallel"] = ParallelConfig(backend="dask", address=scheduler)
    if campaign:
        changes["campaign"] = config.campaign.model_copy(update=campaign)
    return config.model_copy(update=changes)


def _results(out: Path, fresh: bool) -> "ResultsFolder":
    from imolo.experiment.results import ResultsFolder

    folder = ResultsFolder(out)
    if fresh:
        folder.discard_trials()
    elif there := folder.trials():
        console.print(f"{there} trials are in {out} already and will not be run again")
    return folder


def main() -> None:
    """Run the command line; every error of ours ends in one line."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    try:
        app()
    except ImoloError as error:
        complain(str(error))
        sys.exit(2)


if __name__ == "__main__":
    main()
