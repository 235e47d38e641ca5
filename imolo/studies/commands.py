"""The commands of the studies; each imports what it needs itself, so that `--help` stays quick."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imolo.campaigns.command_options import (
    Balls,
    ConfigPaths,
    Fresh,
    Out,
    Scheduler,
    Seed,
    kept_in,
    load_configs,
    open_results,
    override,
)
from imolo.command_line.options import CORES, Jobs
from imolo.command_line.terminal import ProgressBars, console, say
from imolo.errors import ConfigError

if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig

app = typer.Typer()


@app.command()
def ball(
    config: Annotated[
        Path | None, typer.Argument(help="YAML of a backend whose thrower is to throw, unless --data is given.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="CSV of recorded flights: flight,time_s,x_m,y_m,z_m, or as Motive exports it.")
    ] = None,
    units: Annotated[str | None, typer.Option(help="Of positions in --data: m, cm, mm.")] = None,
    time: Annotated[str | None, typer.Option(help="Unit of times in --data: s, ms, us, ns.")] = None,
    up: Annotated[str | None, typer.Option(help="Axis of --data that points upwards: z, -z, y, -y, x, -x.")] = None,
    separator: Annotated[str | None, typer.Option(help="Of columns in --data: , ; tab |")] = None,
    decimal: Annotated[str | None, typer.Option(help="Mark of decimals in --data: . ,")] = None,
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
    from imolo.ball.csv_format import CsvFormat
    from imolo.config.loading import load_config
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
            chosen = override(load_config(config), seed=seed, scheduler=scheduler)
            result = study.rate_simulated(chosen, throws, folder, jobs, bars.show)
    console.print(ball_report.render_evaluation(result))
    folder.save_json("ball.json", result)
    folder.save_drawing("ball", ball_report.draw_evaluation(result), within=".")
    folder.save_origin()
    say(f"ball.json and ball.png are in {out}")


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
    from imolo.studies import interpolation_report, interpolation_study

    numbers = interpolation_report.parse_trials(trials)
    chosen = [override(config, seed=seed, scheduler=scheduler) for config in load_configs(configs)]
    folder = open_results(out, fresh)
    with ProgressBars(kept_in(out)) as bars:
        result = interpolation_study.study(chosen, numbers, repetitions, pool, folder, jobs, bars.show)
    console.print(interpolation_report.render_study(result))
    folder.save_drawing("interpolation", interpolation_report.draw_study(result))
    folder.save_origin()
    say(f"logs, configs, interpolation.json and figures/interpolation.png are in {out}")


@app.command()
def transfer(
    configs: ConfigPaths = None,
    motions: Annotated[int, typer.Option(min=4, help="Of a dense table.")] = 320,
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
    from imolo.studies import transfer as study
    from imolo.studies import transfer_report

    chosen = [override(config, seed=seed, balls=balls, scheduler=scheduler) for config in load_configs(configs)]
    folder = open_results(out, fresh)
    with ProgressBars(kept_in(out)) as bars:
        result = study.transfer(chosen, motions, folder, jobs, bars.show)
    console.print(transfer_report.render_transfer(result))
    folder.save_drawing("transfer", transfer_report.draw_transfer(result))
    folder.save_origin()
    say(f"logs, tables, configs, transfer.json and figures/transfer.png are in {out}")


@app.command()
def trials(
    configs: ConfigPaths = None,
    numbers: Annotated[str, typer.Option(help="Numbers of trials, with commas.")] = "5,10,15,20,30",
    motions: Annotated[int, typer.Option(min=4, help="Of a prior.")] = 320,
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
    from imolo.studies import interpolation_report, sample_efficiency_report
    from imolo.studies import sample_efficiency as study

    counts = interpolation_report.parse_trials(numbers)
    chosen = [override(config, seed=seed, scheduler=scheduler) for config in load_configs(configs)]
    folder = open_results(out, fresh)
    sizes = study.Sizes(dense=motions, candidates=candidates, tests=tests)
    with ProgressBars(kept_in(out)) as bars:
        result = study.study(chosen, counts, sizes, folder, jobs, bars.show)
    console.print(sample_efficiency_report.render_study(result))
    folder.save_drawing("trials", sample_efficiency_report.draw_study(result))
    folder.save_origin()
    say(f"logs, configs, trials.json and figures/trials.png are in {out}")


@app.command()
def attribute(
    first: Annotated[str, typer.Argument(help="A backend by name, or a YAML that configures it.")],
    second: Annotated[str, typer.Argument(help="The other one.")],
    motions: Annotated[
        int | None,
        typer.Option(min=1, help="Only the first motions of the training [default: all].", show_default=False),
    ] = None,
    out: Out = Path("results/attribute"),
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Say why two backends bring the hand to different places under the same commands.

    Swaps one ingredient at a time: time step, friction cone, stiffness of contacts and joint limits, and whatever
    else the backends declare. Writes logs, attribution.json and a waterfall.
    """
    from imolo.studies import attribution_report
    from imolo.studies.attribution import attribute as attribute_disagreement

    configs = (
        override(_named_or_file(first, motions), scheduler=scheduler),
        override(_named_or_file(second, motions), scheduler=scheduler),
    )
    folder = open_results(out, fresh)
    with ProgressBars(kept_in(out)) as bars:
        answer = attribute_disagreement(configs, folder, jobs, bars.show)
    console.print(attribution_report.render_attribution(answer))
    path = folder.save_drawing("waterfall", attribution_report.draw_waterfall(answer))
    folder.save_origin()
    say(f"numbers are in {out / 'attribution.json'}, the waterfall is {path}")


def _named_or_file(text: str, motions: int | None) -> "ExperimentConfig":
    from imolo.config.loading import config_for, load_config

    config = load_config(Path(text)) if text.endswith((".yaml", ".yml")) else config_for(text)
    if motions is None:
        return config
    training = config.training.model_copy(update={"motions": config.training.motions[:motions]})
    return config.model_copy(update={"training": training})
