"""Further results that may lie in the folder; a new kind of them is one more line of `SECTIONS`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imolo.ball.evaluation import PROTOCOLS, Evaluation
from imolo.identification import facts_report
from imolo.identification import report as identification_report
from imolo.identification.facts_study import FactsResult
from imolo.identification.report import (
    CHECK_COLUMNS,
    DATA_COLUMNS,
    PARAMETER_COLUMNS,
    check_rows,
    data_rows,
    fit_columns,
    fit_rows,
    pair_columns,
    pair_rows,
    parameter_rows,
    problems,
)
from imolo.identification.study import Identification
from imolo.report.folder import parse, read_text
from imolo.studies import sample_efficiency_report as efficiency_report
from imolo.studies import transfer_report
from imolo.studies.attribution import Attribution
from imolo.studies.interpolation_report import (
    BARS_COLUMNS,
    BARS_NOTE,
    BARS_TITLE,
    MODELS_COLUMNS,
    MODELS_TITLE,
    bar_rows,
    findings,
    model_rows,
)
from imolo.studies.interpolation_study import InterpolationStudy
from imolo.studies.sample_efficiency import SampleEfficiency
from imolo.studies.transfer import Transfer

Context = Mapping[str, Any]


@dataclass(frozen=True)
class Section:
    """A kind of results.

    Attributes:
        file: Name in the results folder; the section appears where it is there.
        title: Heading.
        prepare: Turns the file into what the template shows; raises ResultsError where it is damaged.
        template: In the folder of templates.
        figures: Beside the file, shown where they are there.
    """

    file: str
    title: str
    prepare: Callable[[Path], Context]
    template: str = "table.html"
    figures: tuple[str, ...] = ()

    @property
    def anchor(self) -> str:
        """Where links in the page go."""
        return Path(self.file).stem


@dataclass(frozen=True)
class Grid:
    """A table: its caption, titles of the columns, and rows of cells."""

    caption: str
    columns: tuple[str, ...]
    rows: Sequence[Sequence[Any]]


def ball_tables(path: Path) -> Context:
    """Return a table for each protocol of a rating of ball models."""
    evaluation = parse(Evaluation, read_text(path), path)
    columns = ("model", "lead s", "mean mm", "sd", "p95", "NEES/3", "inside", "n")
    grids = []
    for protocol in PROTOCOLS:
        rows = [
            (
                rating.model,
                f"{rating.horizon:g}",
                *(f"{1e3 * value:.1f}" for value in (rating.mean, rating.sd, rating.quantiles[4])),
                f"{rating.nees:.2f}",
                f"{100 * rating.inside:.0f} %",
                rating.count,
            )
            for rating in evaluation.ratings
            if rating.protocol == protocol
        ]
        grids.append(
            Grid(f"Error at the {protocol}" if protocol == "last point" else "Error at every sample", columns, rows)
        )
    note = (
        f"{len(evaluation.flights)} flights of {evaluation.source}, leave-one-out. NEES over its dimension is 1 for a "
        "right covariance, and 95 % lie inside the 95 % ellipsoid."
    )
    if evaluation.left_out:
        note += f" {len(evaluation.left_out)} flights were left out, see {path.name}."
    return {"note": note, "grids": grids}


def attribution_tables(path: Path) -> Context:
    """Return what each swap does alone, and what they explain one upon the other."""
    answer = parse(Attribution, read_text(path), path)
    alone = [
        (
            result.swap.ingredient,
            result.swap.side,
            result.swap.change,
            _tenths(result.disagreement.mean),
            _tenths(result.moved),
        )
        for result in answer.alone
    ]
    before = answer.start.mean or 0.0
    kept = []
    for result in answer.waterfall:
        after = result.disagreement.mean or 0.0
        kept.append(
            (result.swap.ingredient, result.swap.side, result.swap.change, _tenths(after), _tenths(before - after))
        )
        before = after
    kept.append(("not explained", "", "", _tenths(before), ""))
    columns = ("ingredient", "side", "change", "hands mm")
    return {
        "note": f"{' and '.join(answer.backends)}: under the same {answer.motions} motions their hands are "
        f"{_tenths(answer.start.mean)} mm apart. One thing was swapped at a time.",
        "grids": [
            Grid("One upon the other, the most helpful first", (*columns, "explains mm"), kept),
            Grid("Each swap alone", (*columns, "moves the hand mm"), alone),
        ],
    }


def interpolation_tables(path: Path) -> Context:
    """Return the bars and tests of Fig. 7, how far each model is off, and what that says beside the paper."""
    study = parse(InterpolationStudy, read_text(path), path)
    said = " ".join(f"{name}: {text}" for name, text in findings(study))
    return {
        "note": f"{study.repetitions} repetitions, {study.pool} random motions. {said}",
        "grids": [
            Grid(f"{BARS_TITLE}: {BARS_NOTE}", BARS_COLUMNS, bar_rows(study)),
            Grid(MODELS_TITLE, MODELS_COLUMNS, model_rows(study)),
        ],
    }


def transfer_tables(path: Path) -> Context:
    """Return the transfer matrix without and with the correction."""
    result = parse(Transfer, read_text(path), path)
    names = transfer_report.players(result)
    grids = [
        Grid(
            transfer_report.title(result, corrected=corrected),
            ("learned in", *(f"balls in {name}" for name in names)),
            [
                (
                    row or transfer_report.ALONE,
                    *(transfer_report.cell_text(result.cell(row, name, corrected)) for name in names),
                )
                for row in transfer_report.rows(result, corrected=corrected)
            ],
        )
        for corrected in (False, True)
    ]
    return {"note": "Hits with Wilson 95 % interval, and hand to selected grid point, mean ± sd.", "grids": grids}


def trials_tables(path: Path) -> Context:
    """Return the hand error of every model against the number of trials."""
    study = parse(SampleEfficiency, read_text(path), path)
    numbers = efficiency_report.numbers(study)
    grids = []
    for setting in efficiency_report.SETTINGS:
        rows = []
        for backend in efficiency_report.backends(study):
            for model in efficiency_report.models(study, backend):
                found = {point.trials: point for point in study.curve(backend, setting, model)}
                cells = (efficiency_report.point_text(found.get(number)) for number in numbers)
                rows.append((backend, model, *cells))
            rows.append((backend, "floor", _tenths(study.floor(backend, setting)), *("" for _ in numbers[1:])))
        grids.append(Grid(setting, ("backend", "model", *map(str, numbers)), rows))
    note = (
        f"Hand error on {study.sizes.tests} other motions [mm] against the number of trials, in brackets squared error "
        "over predicted variance (1 is honest). 0: the prior as it is."
    )
    return {"note": note, "grids": grids}


def _tenths(length: float | None) -> str:
    return "–" if length is None else f"{1e3 * length:.1f}"


def identification_tables(path: Path) -> Context:
    """Return what was found in the data, what was fitted, and how it does on recordings held out."""
    result = parse(Identification, read_text(path), path)
    grids = [
        Grid(identification_report.FITS_TITLE, fit_columns(result), fit_rows(result)),
        Grid(identification_report.PARAMETERS_TITLE, PARAMETER_COLUMNS, parameter_rows(result)),
        Grid(identification_report.CHECK_TITLE, CHECK_COLUMNS, check_rows(result)),
        Grid("The recordings", DATA_COLUMNS, data_rows(result)),
    ]
    if result.differences:
        grids.insert(1, Grid(identification_report.PAIRS_TITLE, pair_columns(result), pair_rows(result)))
    note = " ".join([identification_report.FITS_NOTE, *problems(result)])
    return {"study": result.title, "note": note, "grids": grids}


def facts_tables(path: Path) -> Context:
    """Return how a robot meets published facts, and what they leave open."""
    result = parse(FactsResult, read_text(path), path)
    grids = [
        Grid("Facts", facts_report.FACT_COLUMNS, facts_report.fact_rows(result)),
        Grid(facts_report.SETTINGS_TITLE, facts_report.SETTING_COLUMNS, facts_report.setting_rows(result)),
    ]
    note = f"{facts_report.FACTS_NOTE}. {facts_report.summary(result)}"
    return {"study": result.title, "note": note, "grids": grids}


SECTIONS = (
    Section("ball.json", "Ball models", ball_tables, figures=("ball.png",)),
    Section("attribution.json", "Why the engines differ", attribution_tables, figures=("figures/waterfall.png",)),
    Section(
        "interpolation.json",
        "Between the training motions",
        interpolation_tables,
        figures=("figures/interpolation.png",),
    ),
    Section("transfer.json", "From one engine to another", transfer_tables, figures=("figures/transfer.png",)),
    Section(
        "identification.json",
        "Fitted to recordings",
        identification_tables,
        figures=("figures/identification.png",),
    ),
    Section("facts.json", "Held against published facts", facts_tables, figures=("figures/identification.png",)),
    Section("trials.json", "How many trials it takes", trials_tables, figures=("figures/trials.png",)),
)
