"""The commands that learn, hit and compare; each imports what it needs itself, so that `--help` stays quick."""

from pathlib import Path
from typing import Annotated

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
from imolo.command_line.options import CORES, Config, Jobs, Method
from imolo.command_line.terminal import ProgressBars, say, show
from imolo.errors import ConfigError, did_you_mean

app = typer.Typer()


@app.command()
def compare(
    configs: Configs = None,
    ensemble: Annotated[
        Path | None, typer.Option(help="Do it with every robot of this file; `imolo identify` writes one.")
    ] = None,
    out: Out = Path("results/compare"),
    seed: Seed = None,
    balls: Balls = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Learn motions, throw balls, hit them; compare the backends.

    Writes logs, tables, resolved configs, figures, summary.json and timing.json to the results folder.
    """
    from imolo.campaigns import comparison, figures, summary

    chosen = [override(config, seed=seed, balls=balls, scheduler=scheduler) for config in load_configs(configs)]
    if ensemble is not None:
        from imolo.campaigns.ensemble import compare_ensemble, read_ensemble, render_ensemble
        from imolo.campaigns.results import ResultsFolder

        members = read_ensemble(ensemble)
        with ProgressBars(kept_in(out)) as bars:
            over = compare_ensemble(chosen, members, ResultsFolder(out), jobs, bars.show, fresh)
        show(render_ensemble(over))
        say(f"ensemble.json and a folder for each of the {len(members)} members are in {out}")
        return
    folder = open_results(out, fresh)
    with ProgressBars(kept_in(out)) as bars:
        result, timings = comparison.compare(chosen, folder, jobs, bars.show)
    show(summary.render_comparison(result, timings.timing, chosen[0]))
    figures.draw_all(result, chosen, folder)
    folder.save_origin()
    say(f"logs, tables, configs, figures, summary.json and timing.json are in {out}")


@app.command()
def learn(
    config: Config,
    motions: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Learn so many motions, spread evenly, in place of those of the config; simulated ones without logs.",
        ),
    ] = None,
    out: Out = Path("results/learn"),
    seed: Seed = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Learn balls and motions on one backend, and build its tables.

    There is one table for each method of the config.
    """
    from imolo.campaigns import comparison
    from imolo.config.loading import named_config
    from imolo.trials.learning import spread_motions

    chosen = override(named_config(config), seed=seed, scheduler=scheduler)
    if motions is not None:
        training = chosen.training.model_copy(update={"motions": spread_motions(chosen, motions)})
        chosen = chosen.model_copy(update={"training": training})
    folder = open_results(out, fresh)
    with ProgressBars(kept_in(out)) as bars:
        comparison.learn([chosen], folder, jobs, bars.show, dense=motions is not None)
    for method in chosen.methods:
        say(f"table of method {method!r}: {folder.table(chosen.backend.name, method)}")


@app.command()
def hit(
    config: Config,
    table: Annotated[Path, typer.Argument(help="Table that `imolo learn` or `imolo compare` wrote, on any backend.")],
    method: Method = "improved",
    out: Out = Path("results/hit"),
    seed: Seed = None,
    balls: Balls = None,
    jobs: Jobs = CORES,
    scheduler: Scheduler = None,
    fresh: Fresh = False,
) -> None:
    """Throw balls on one backend and hit them with a table.

    The table may have been learned on another backend.
    """
    from imolo.campaigns import comparison, summary
    from imolo.config.loading import named_config
    from imolo.method.table import LookupTable

    chosen = override(named_config(config), seed=seed, balls=balls, scheduler=scheduler)
    if method not in chosen.methods:
        raise ConfigError(
            f"unknown method {method!r}{did_you_mean(method, chosen.methods)}; known: {', '.join(chosen.methods)}"
        )
    LookupTable.load(table, chosen.robot.name, type(chosen.motion))
    folder = open_results(out, fresh)
    name = chosen.backend.name
    with ProgressBars(kept_in(out)) as bars:
        results, timing = comparison.hit({name: chosen}, {(name, method): table}, folder, jobs, bars.show)
    folder.save_config(chosen)
    folder.save_json("summary.json", comparison.summarise({name: chosen}, results, disagreement={}))
    folder.save_origin()
    show(summary.render_results(results, timing, chosen))
    show(summary.render_causes(results))
    say(f"logs, config and summary.json are in {out}")
