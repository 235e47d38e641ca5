"""The commands of the studies; each imports what it needs itself, so that `--help` stays quick."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imolo.campaigns.command_options import (
    Balls,
    Configs,
    Fresh,
    Out,
    Scheduler,
    Seed,
    kept_in,
    load_configs,
    open_results,
    override,
)
from imolo.command_line.options import CORES, Config, Jobs
from imolo.command_line.terminal import ProgressBars, say, show
from imolo.errors import ConfigError

if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig

app = typer.Typer()


@app.command()
def ball(
    config: Annotated[
        str | None, typer.Argument(metavar="CONFIG", help="Whose thrower is to throw, unless --data is given.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="CSV of recorded flights: flight,time_s,x_m,y_m,z_m, or as Motive exports it.")
    ] = None,
    units: Annotated[str | None, typer.Option(metavar="m|cm|mm", help="Unit of positions in --data.")] = None,
    time: Annotated[str | None, typer.Option(metavar="s|ms|us|ns", help="Unit of times in --data.")] = None,
    up: Annotated[
        str | None, typer.Option(metavar="z|-z|y|-y|x|-x", help="Axis of --data that points upwards.")
    ] = None,
    separator: Annotated[str | None, typer.Option(metavar=", ; tab |", help="Of columns in --data.")] = None,
    decimal: Annotated[str | None, typer.Option(metavar=". ,", help="Mark of decimals in --data.")] = None,
    models: Annotated[str, typer.Option(metavar="linear,drag,spin", help="Ball models to rate.")] = "linear,drag,spin",
    horizons: Annotated[
        str | None,
        typer.Option(metavar="S,S,...", help="Lead times [s].", show_default="recorded .1 to .4, simulated .25 to .75"),
    ] = None,
    balls: Annotated[int, typer.Option(min=4, help="Number of simulated balls.")] = 24,
    out: Out = Path("results/ball"),
    seed: Seed = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Rate ball models on recorded or simulated flights.

    By leave-one-out: error against lead time, and calibration. Writes ball.json and ball.png to the results folder.
    """
    from imolo.ball.csv_format import CsvFormat
    from imolo.config.loading import named_config
    from imolo.studies import ball_report, ball_study

    if (config is None) == (data is None):
        raise ConfigError("give either the config of a backend or --data FILE")
    form = CsvFormat(units, time, up, separator, decimal)
    study = ball_study.Study(
        models=ball_study.parse_models(models),
        horizons=ball_study.parse_horizons(horizons, recorded=data is not None),
    )
    folder = open_results(out, fresh)
    with ProgressBars(kept_in(out)) as bars:
        if data is not None:
            result = study.rate_recorded(data, form, jobs, bars.show)
        elif config is not None:
            chosen = override(named_config(config), seed=seed, scheduler=scheduler)
            result = study.rate_simulated(chosen, balls, folder, jobs, bars.show)
    show(ball_report.render_evaluation(result))
    folder.save_json("ball.json", result)
    folder.save_drawing("ball", ball_report.draw_evaluation(result), within=".")
    folder.save_origin()
    say(f"ball.json and ball.png are in {out}")


@app.command()
def interpolation(
    configs: Configs = None,
    repetitions: Annotated[int, typer.Option(min=2, help="For each number of trials; the paper's are 100.")] = 100,
    numbers: Annotated[str, typer.Option(metavar="N,N,...", help="Numbers of trials.")] = "8,16,24",
    pool: Annotated[int, typer.Option(min=2, help="Random motions that queries and trials are drawn from.")] = 200,
    out: Out = Path("results/interpolation"),
    seed: Seed = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Test whether nonlinear interpolation helps the hand.

    Whether it is nearer to where it should be, as in Sec. VI and Fig. 7. Takes some minutes for each backend;
    --repetitions 20 --pool 60 gives a quick look. Writes logs, interpolation.json and interpolation.png to the
    results folder.
    """
    from imolo.studies import interpolation_report, interpolation_study

    counts = interpolation_report.parse_trials(numbers)
    chosen = [override(config, seed=seed, scheduler=scheduler) for config in load_configs(configs)]
    folder = open_results(out, fresh)
    with ProgressBars(kept_in(out)) as bars:
        result = interpolation_study.study(chosen, counts, repetitions, pool, folder, jobs, bars.show)
    show(interpolation_report.render_study(result))
    folder.save_drawing("interpolation", interpolation_report.draw_study(result))
    folder.save_origin()
    say(f"logs, configs, interpolation.json and figures/interpolation.png are in {out}")


@app.command()
def transfer(
    configs: Configs = None,
    motions: Annotated[int, typer.Option(min=4, help="Of a dense table.")] = 320,
    out: Out = Path("results/transfer"),
    seed: Seed = None,
    balls: Balls = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Hit balls on every backend with tables of every other.

    The tables are as they are, and corrected by a few trials. Takes some minutes for each pair of backends. Writes
    logs, tables, transfer.json and a heat map.
    """
    from imolo.studies import transfer as study
    from imolo.studies import transfer_report

    chosen = [override(config, seed=seed, balls=balls, scheduler=scheduler) for config in load_configs(configs)]
    folder = open_results(out, fresh)
    with ProgressBars(kept_in(out)) as bars:
        result = study.transfer(chosen, motions, folder, jobs, bars.show)
    show(transfer_report.render_transfer(result))
    folder.save_drawing("transfer", transfer_report.draw_transfer(result))
    folder.save_origin()
    say(f"logs, tables, configs, transfer.json and figures/transfer.png are in {out}")


@app.command()
def trials(
    configs: Configs = None,
    numbers: Annotated[str, typer.Option(metavar="N,N,...", help="Numbers of trials.")] = "5,10,15,20,30",
    motions: Annotated[int, typer.Option(min=4, help="Of a prior.")] = 320,
    candidates: Annotated[int, typer.Option(min=1, help="Motions that an active choice may pick from.")] = 60,
    tests: Annotated[int, typer.Option(min=1, help="Motions that the models are tested on.")] = 60,
    out: Out = Path("results/trials"),
    seed: Seed = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Say how many trials a backend needs.

    Compares the hand error of models with and without a prior from another backend. Writes logs, trials.json and
    trials.png to the results folder.
    """
    from imolo.studies import interpolation_report, sample_efficiency_report
    from imolo.studies import sample_efficiency as study

    counts = interpolation_report.parse_trials(numbers)
    chosen = [override(config, seed=seed, scheduler=scheduler) for config in load_configs(configs)]
    folder = open_results(out, fresh)
    sizes = study.Sizes(dense=motions, candidates=candidates, tests=tests)
    with ProgressBars(kept_in(out)) as bars:
        result = study.study(chosen, counts, sizes, folder, jobs, bars.show)
    show(sample_efficiency_report.render_study(result))
    folder.save_drawing("trials", sample_efficiency_report.draw_study(result))
    folder.save_origin()
    say(f"logs, configs, trials.json and figures/trials.png are in {out}")


@app.command()
def attribute(
    first: Config,
    second: Config,
    motions: Annotated[
        int | None,
        typer.Option(min=1, help="Only the first motions of the training.", show_default="all"),
    ] = None,
    out: Out = Path("results/attribute"),
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Say why two backends bring the hand to different places.

    Under the same commands, swaps one ingredient at a time: time step, friction cone, stiffness of contacts and
    joint limits, and whatever else the backends declare. Writes logs, attribution.json and a waterfall.
    """
    from imolo.studies import attribution_report
    from imolo.studies.attribution import attribute as attribute_disagreement

    configs = (
        override(_with_motions(first, motions), scheduler=scheduler),
        override(_with_motions(second, motions), scheduler=scheduler),
    )
    folder = open_results(out, fresh)
    with ProgressBars(kept_in(out)) as bars:
        answer = attribute_disagreement(configs, folder, jobs, bars.show)
    show(attribution_report.render_attribution(answer))
    path = folder.save_drawing("waterfall", attribution_report.draw_waterfall(answer))
    folder.save_origin()
    say(f"numbers are in {out / 'attribution.json'}, the waterfall is {path}")


def _with_motions(text: str, motions: int | None) -> "ExperimentConfig":
    from imolo.config.loading import named_config

    config = named_config(text)
    if motions is None:
        return config
    training = config.training.model_copy(update={"motions": config.training.motions[:motions]})
    return config.model_copy(update={"training": training})
