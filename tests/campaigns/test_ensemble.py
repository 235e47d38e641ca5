"""A comparison over an ensemble: every member is laid over the configs, and the ranges are those over the members."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from typer.testing import CliRunner

from imolo.campaigns import ensemble
from imolo.campaigns.comparison import Comparison, Timings
from imolo.campaigns.ensemble import compare_ensemble, render_ensemble, with_member
from imolo.campaigns.results import ResultsFolder
from imolo.command_line.main import app
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import config_for
from imolo.errors import ConfigError
from imolo.trials.metrics import MethodResult, Statistic


def result(hits: int, hand: float) -> MethodResult:
    return MethodResult.model_construct(hits=hits, balls=20, hand_error=Statistic.of([hand, hand + 0.002]))


def played(configs: Sequence[ExperimentConfig], folder: ResultsFolder, jobs: int) -> tuple[Comparison, Timings]:
    """Say that the friction of the contacts decides everything."""
    folder.prepare()
    friction = configs[0].simulation.contact.friction
    one = {config.backend.name: {"paper": result(round(10 * friction), 0.01 * friction)} for config in configs}
    return Comparison.model_construct(results=one), Timings(timing={})


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble, "compare", played)


def member(friction: float) -> dict[str, object]:
    return {"simulation": {"contact": {"friction": friction}}}


def test_ranges_are_lowest_median_and_highest_over_the_members(tmp_path: Path) -> None:
    configs = [config_for("mujoco"), config_for("pybullet")]
    members = [member(0.5), member(1.0), member(0.8)]
    over = compare_ensemble(configs, members, ResultsFolder(tmp_path / "out"), 1, lambda *_: None)
    assert over.hit_rate["pybullet"]["paper"].values == (0.25, 0.5, 0.4)
    assert over.hit_rate["mujoco"]["paper"].written(100.0) == "25 … 40 … 50"
    assert over.hand_error["mujoco"]["paper"].written(1e3) == "6 … 9 … 11"
    assert (tmp_path / "out" / "ensemble.json").is_file()
    assert {path.name for path in (tmp_path / "out").glob("member_*")} == {"member_01", "member_02", "member_03"}
    assert "3 robots" in str(render_ensemble(over).title)


def test_member_changes_what_it_names_and_nothing_else() -> None:
    config = config_for("mujoco", seed=7, simulation={"timestep": 2e-4})
    changed = with_member(config, member(0.5), "member 1")
    assert changed.simulation.contact.friction == 0.5
    again = changed.model_copy(
        update={"simulation": changed.simulation.model_copy(update={"contact": config.simulation.contact})}
    )
    assert again == config


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("members: []", "members"),
        ("robots: [{}]", "unknown key 'robots' (known: members)"),
        ("members: [{simulation: {contact: {frictoin: 0.5}}}]", "member 1: unknown key"),
        ("members: [{simulation: {contact: {friction: -1}}}]", "friction"),
    ],
)
def test_wrong_ensemble_is_one_line(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "ensemble.yaml"
    path.write_text(content + "\n", encoding="utf-8")
    config = tmp_path / "mujoco.yaml"
    config.write_text("backend: {name: mujoco}\n", encoding="utf-8")
    command = ["compare", str(config), "--ensemble", str(path), "--out", str(tmp_path / "out")]
    error = CliRunner().invoke(app, command).exception
    assert isinstance(error, ConfigError)
    assert said in str(error)
    assert "\n" not in str(error)


def test_compare_takes_an_ensemble(tmp_path: Path) -> None:
    path = tmp_path / "ensemble.yaml"
    path.write_text("members:\n  - {simulation: {contact: {friction: 0.5}}}\n  - {}\n", encoding="utf-8")
    config = tmp_path / "mujoco.yaml"
    config.write_text("backend: {name: mujoco}\n", encoding="utf-8")
    out = tmp_path / "out"
    ran = CliRunner().invoke(app, ["compare", str(config), "--ensemble", str(path), "--out", str(out)])
    assert ran.exit_code == 0, ran.output
    assert "Over 2 robots" in ran.output
    assert (out / "ensemble.json").is_file()
