"""The transfer matrix: its report on made-up cells, and a small run of the whole on engines."""

from pathlib import Path

import pytest
from played_trials import config

from imolo.campaigns.results import ResultsFolder
from imolo.errors import ConfigError
from imolo.method.table import LookupTable
from imolo.report.sections import transfer_tables
from imolo.studies.transfer import ANOTHER_DAY, Cell, Transfer, transfer
from imolo.studies.transfer_report import ALONE, cell_text, draw_transfer, players, rows
from imolo.trials.metrics import Statistic, wilson_interval


def cell(learned_in: str | None, played_in: str, *, corrected: bool, hits: int) -> Cell:
    return Cell(
        learned_in=learned_in,
        played_in=played_in,
        corrected=corrected,
        hits=hits,
        balls=20,
        interval=wilson_interval(hits, 20),
        hand_error=Statistic.of([0.010, 0.014]),
    )


MADE_UP = Transfer(
    seed=1,
    motions=200,
    trials=15,
    versions={},
    configs={},
    cells=(
        cell("alpha", "alpha", corrected=False, hits=20),
        cell("beta", "alpha", corrected=False, hits=10),
        cell("alpha", "beta", corrected=False, hits=12),
        cell("beta", "beta", corrected=False, hits=19),
        cell(None, "alpha", corrected=True, hits=15),
        cell(None, "beta", corrected=True, hits=14),
        cell("beta", "alpha", corrected=True, hits=18),
        cell("alpha", "beta", corrected=True, hits=17),
    ),
)


def test_cell_tells_hits_interval_and_hand_error() -> None:
    assert cell_text(MADE_UP.cell("beta", "alpha", corrected=False)) == "10/20 (30-70 %), 12±3 mm"
    assert cell_text(MADE_UP.cell("alpha", "alpha", corrected=True)) == "-"


def test_matrix_has_a_row_for_every_table_and_a_column_for_every_player() -> None:
    assert players(MADE_UP) == ["alpha", "beta"]
    assert rows(MADE_UP, corrected=False) == ["alpha", "beta"]
    assert rows(MADE_UP, corrected=True) == [None, "alpha", "beta"]


def test_report_shows_both_matrices(tmp_path: Path) -> None:
    path = tmp_path / "transfer.json"
    path.write_text(MADE_UP.model_dump_json())
    as_it_is, corrected = transfer_tables(path)["grids"]
    assert as_it_is.columns == ("learned in", "balls in alpha", "balls in beta")
    assert [row[0] for row in as_it_is.rows] == ["alpha", "beta"]
    assert [row[0] for row in corrected.rows] == [ALONE, "alpha", "beta"]
    assert corrected.rows[2][1].startswith("18/20")


def test_heat_maps_hold_the_numbers() -> None:
    figure = draw_transfer(MADE_UP)
    texts = [[text.get_text() for text in axes.texts] for axes in figure.axes[:4]]
    # Panels: hit rate as it is and corrected, hand error likewise.
    assert texts[0] == ["100", "60", "50", "95"]
    assert texts[1] == ["75", "70", "85", "90"]
    assert texts[2] == ["12"] * 4


def test_backend_named_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="twice: mujoco, mujoco"):
        transfer([config("mujoco"), config("mujoco")], 8, ResultsFolder(tmp_path), jobs=1)


@pytest.mark.slow
def test_transfer_between_two_engines(tmp_path: Path) -> None:
    configs = [config(name) for name in ("mujoco", "pybullet")]
    configs = [c.model_copy(update={"campaign": c.campaign.model_copy(update={"balls": 2})}) for c in configs]
    result = transfer(configs, 30, ResultsFolder(tmp_path), jobs=2)
    assert Transfer.model_validate_json((tmp_path / "transfer.json").read_text()) == result
    assert len(result.cells) == 8
    assert all(cell.balls == 2 for cell in result.cells)
    corrected = LookupTable.load(tmp_path / "tables" / "mujoco_pybullet_corrected.npz")
    assert corrected.origin["prior"]["backend"] == "pybullet"
    assert corrected.origin["prior"]["seed"] == configs[0].seed + ANOTHER_DAY
