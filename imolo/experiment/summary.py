"""The comparison as tables in the terminal, beside the paper's own numbers."""

from rich.console import Group, RenderableType
from rich.table import Table

from imolo.experiment.comparison import Comparison
from imolo.experiment.metrics import HORIZONS, Statistic

PAPER = (
    "Liberobot",
    "paper",
    "16/20",
    "58-92 %",
    "12.9 ± 9.4",
    "46.1 ± 34.2",
    "155.9 ± 32.0",
    "338.2 ± 35.7",
    "-",
    "-",
)


def render(comparison: Comparison) -> RenderableType:
    """Return the tables of a comparison."""
    return Group(_results(comparison), _disagreement(comparison))


def _results(comparison: Comparison) -> Table:
    table = Table(title=f"Jump and hit, seed {comparison.seed}", title_justify="left")
    table.add_column("backend")
    table.add_column("method")
    table.add_column("hits", justify="right")
    table.add_column("95 %", justify="right")
    table.add_column("hand [mm]", justify="right")
    for horizon in HORIZONS:
        table.add_column(f"ball {horizon:.2f} s [mm]", justify="right")
    table.add_column("decision p50 / p99 [ms]", justify="right")
    table.add_column("× real time", justify="right")
    for backend, methods in comparison.results.items():
        for method, result in methods.items():
            timing = comparison.timing[backend][method]
            low, high = result.interval
            table.add_row(
                backend,
                method,
                f"{result.hits}/{result.balls}",
                f"{100 * low:.0f}-{100 * high:.0f} %",
                millimetres(result.hand_error),
                *(millimetres(result.prediction_error[f"{horizon:.2f}"]) for horizon in HORIZONS),
                f"{1e3 * timing.decision_median:.2f} / {1e3 * timing.decision_p99:.2f}",
                f"{timing.real_time_factor:.2f}",
            )
        table.add_section()
    table.add_row(*PAPER, style="italic")
    return table


def _disagreement(comparison: Comparison) -> Table:
    table = Table(title="Hands of two backends under the same command, t_w + 0.17 s", title_justify="left")
    table.add_column("backends")
    table.add_column("mean ± sd [mm]", justify="right")
    table.add_column("motions", justify="right")
    for pair, statistic in comparison.disagreement.items():
        table.add_row(pair, millimetres(statistic), str(statistic.count))
    return table


def millimetres(statistic: Statistic) -> str:
    """Return mean and standard deviation in millimetres, or a dash where there is nothing."""
    if statistic.mean is None:
        return "-"
    spread = "" if statistic.sd is None else f" ± {1e3 * statistic.sd:.1f}"
    return f"{1e3 * statistic.mean:.1f}{spread}"
