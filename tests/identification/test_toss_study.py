"""Whole studies of tosses, from the file to what is written, in engines whose hidden friction is known."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import Run, interrupt, is_one_line_about
from made_up_tosses import MU, STUDY, cube_config, rows, thrown, write

from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ParallelConfig
from imolo.config.loading import make_config
from imolo.errors import ConfigError, IdentificationError, TrainingDataError
from imolo.identification import report
from imolo.identification.study import Identification, identify
from imolo.identification.study_file import load_study
from imolo.report.page import write_report

FRICTION = "simulation.contact.friction"
SHIPPED = Path(__file__).parents[2] / "configs" / "studies" / "cube_tosses.yaml"


@pytest.fixture(scope="module")
def tosses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tosses")
    return write(folder / "tosses.csv", rows(thrown(cube_config("mujoco"), number=18)))


@pytest.fixture
def study(tmp_path: Path, tosses: Path) -> Callable[..., Path]:
    def make(text: str = STUDY, **changes: object) -> Path:
        (tmp_path / "tosses.csv").write_bytes(tosses.read_bytes())
        path = tmp_path / "study.yaml"
        path.write_text(yaml.safe_dump({**yaml.safe_load(text), **changes}), encoding="utf-8")
        return path

    return make


def run_study(path: Path, out: str = "out", parallel: ParallelConfig | None = None) -> Identification:
    folder = ResultsFolder(path.parent / out)
    return identify(load_study(path), path, folder, 1, parallel or ParallelConfig())


@pytest.fixture(scope="module")
def fitted(tosses: Path) -> tuple[Path, Identification]:
    path = tosses.parent / "study.yaml"
    path.write_text(STUDY, encoding="utf-8")
    return path, run_study(path)


def test_a_hidden_friction_is_recovered_within_its_interval(fitted: tuple[Path, Identification]) -> None:
    found = fitted[1].engines["mujoco"]
    assert found.taken == "simplest"
    (parameter,) = found.best.parameters
    assert parameter.low < MU < parameter.high
    assert parameter.value == pytest.approx(MU, rel=0.05)
    assert parameter.flags == ()
    default, simplest = found.candidates
    assert default.loss is not None
    assert simplest.loss is not None
    assert simplest.loss.high < 0.2 * default.loss.mean


def test_what_can_be_identified_and_what_it_cost_is_saved(fitted: tuple[Path, Identification]) -> None:
    path, result = fitted
    saved = json.loads((path.parent / "out" / "identification.json").read_text())
    (checked,) = saved["engines"]["mujoco"]["checked"]
    assert checked["fitted"]
    assert checked["effect"] > 0.001
    default, simplest = result.engines["mujoco"].candidates
    assert default.evaluations == 1
    # At least the start, some steps of Brent's method, and three for the slopes.
    assert simplest.evaluations > 6
    assert 0.0 < simplest.seconds < 60.0


def test_a_study_that_is_run_again_plays_nothing_and_writes_the_same(
    fitted: tuple[Path, Identification], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, _ = fitted
    before = (path.parent / "out" / "identification.json").read_bytes()
    monkeypatch.setattr("imolo.identification.free_body.simulate", lambda *_: pytest.fail("it was played again"))
    run_study(path)
    assert (path.parent / "out" / "identification.json").read_bytes() == before


def test_the_patch_is_a_config(fitted: tuple[Path, Identification]) -> None:
    path, result = fitted
    config = make_config(yaml.safe_load((path.parent / "out" / "patches" / "mujoco.yaml").read_text()))
    (parameter,) = result.engines["mujoco"].best.parameters
    assert config.backend.name == "mujoco"
    assert config.simulation.contact.friction == parameter.value


def test_the_page_shows_every_table(fitted: tuple[Path, Identification]) -> None:
    path, result = fitted
    written = write_report(path.parent / "out", path.parent / "page.html")
    page = written.path.read_text(encoding="utf-8")
    for text in ("Fitted to recordings", report.FITS_TITLE, report.CHECK_TITLE, FRICTION, "simplest *"):
        assert text in page
    assert result.title in page


def test_tables_and_figure_show_every_fit(fitted: tuple[Path, Identification]) -> None:
    result = fitted[1]
    assert [row[1] for row in report.fit_rows(result)] == ["default", "simplest *"]
    assert report.check_rows(result)[0][1] == FRICTION
    assert len(report.figure(result).axes) == 2


def test_recordings_of_another_file_are_only_judged(study: Callable[..., Path]) -> None:
    path = study(held_out_data="others.csv", training=100)
    others = rows(thrown(cube_config(), number=6, seed=9))
    for row in others:
        row["toss"] = f"other {row['toss']}"
    write(path.parent / "others.csv", others)
    result = run_study(path)
    assert len(result.training) == 18
    assert result.held_out == tuple(f"other {index}" for index in range(6))


def test_one_toss_in_both_files_is_refused(study: Callable[..., Path]) -> None:
    with pytest.raises(TrainingDataError, match="toss '0' is in data and in held_out_data"):
        run_study(study(held_out_data="tosses.csv"))


@pytest.mark.slow
def test_one_engine_may_be_there_under_several_labels(study: Callable[..., Path]) -> None:
    pyramid = {"name": "mujoco", "label": "pyramid", "cone": "pyramidal"}
    result = run_study(study(engines=["mujoco", pyramid], evaluations=8))
    assert list(result.engines) == ["mujoco", "pyramid"]
    assert result.engines["pyramid"].patch["backend"] == {"name": "mujoco", "cone": "pyramidal"}
    # The tosses were made with a cone.
    (difference,) = result.differences
    position = difference.sizes["position"]
    assert position is not None
    assert position.low > 0.0


def test_parameters_that_do_nothing_stay_as_they_are(
    study: Callable[..., Path], caplog: pytest.LogCaptureFixture
) -> None:
    ball = {"range": [0.0, 1.0]}
    friction = {"range": [0.05, 1.5], "scale": "log"}
    path = study(parameters={FRICTION: friction, "simulation.contact.restitution": ball}, evaluations=8)
    result = run_study(path)
    assert [one.fitted for one in result.engines["mujoco"].checked] == [True, False]
    assert [one.name for one in result.engines["mujoco"].candidates] == ["default", "simplest"]
    assert "mujoco: simulation.contact.restitution does nothing where it starts and stays at 0.3" in caplog.text


def test_an_engine_that_cannot_play_does_not_stop_the_others(study: Callable[..., Path]) -> None:
    result = run_study(study(engines=[{"name": "hardware", "label": "hand"}, "mujoco"], evaluations=8))
    assert list(result.engines) == ["mujoco"]
    assert "is no physics engine" in result.failed["hand"]
    assert any("is no physics engine" in line for line in report.problems(result))


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"kind": "free_bdy"}, ConfigError, "did you mean 'free_body'"),
        ({"engines": ["mujoco", "mujoco"]}, ConfigError, "two engines are called 'mujoco'"),
        ({"engines": [{"name": "mujoco", "cone": "round"}]}, ConfigError, "cone"),
        ({"parameters": {"simulation.contact.frictio": {"range": [0, 1]}}}, ConfigError, "did you mean 'friction'"),
        ({"parameters": {"backend.impratioo": {"range": [1, 2]}}}, ConfigError, "did you mean 'impratio'"),
        ({"parameters": {"simulation.contact.restitution": {}}}, ConfigError, "has no range"),
        ({"parameters": {FRICTION: {"range": [0.05, 0.5]}}}, ConfigError, "starts at 0.8, outside its range"),
        ({"simplest": ["simulation.gravity"]}, ConfigError, "simplest names 'simulation.gravity'"),
        ({"training": 16}, IdentificationError, "make 16 to fit and 2 to judge"),
        ({"data": "none.csv"}, TrainingDataError, "cannot read the recordings"),
    ],
)
def test_a_study_that_cannot_be_run_says_why_before_anything_is_played(
    study: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    changes: dict[str, object],
    error: type[Exception],
    message: str,
) -> None:
    monkeypatch.setattr("imolo.identification.free_body.simulate", lambda *_: pytest.fail("it was played"))
    with pytest.raises(error) as raised:
        run_study(study(**changes))
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_the_shipped_study_can_be_read_and_its_data_show_their_scale() -> None:
    experiment = load_study(SHIPPED).experiment(SHIPPED.parent)
    findings = {one.what: one for one in experiment.findings}
    assert findings["length scale"].value == pytest.approx(1.022, abs=0.003)
    assert findings["height at rest"].value == pytest.approx(1.022, abs=0.003)
    assert findings["spurious start"].recordings == ("46", "310")


def test_the_command_resumes_and_begins_afresh_when_it_is_told_to(run: Run, study: Callable[..., Path]) -> None:
    path = study(evaluations=8)
    arguments = ("identify", path, "--out", "out", "--jobs", 1)
    code, printed, _ = run(*arguments)
    assert code == 0
    assert "simplest *" in printed
    assert Path("out/figures/identification.png").stat().st_size > 0
    kept = {file.name: file.stat().st_mtime_ns for file in Path("out/evaluations").iterdir()}
    _, printed, _ = run(*arguments)
    assert f"{len(kept)} evaluations are in out already" in printed
    assert {file.name: file.stat().st_mtime_ns for file in Path("out/evaluations").iterdir()} == kept
    run(*arguments, "--fresh")
    again = {file.name: file.stat().st_mtime_ns for file in Path("out/evaluations").iterdir()}
    assert again.keys() == kept.keys()
    assert not again.items() & kept.items()


@pytest.mark.slow
def test_ctrl_c_keeps_the_evaluations_and_ends_in_one_line(tmp_path: Path, study: Callable[..., Path]) -> None:
    path, kept = study(), tmp_path / "results" / "evaluations"
    code, errors = interrupt(
        tmp_path,
        lambda _: kept.is_dir() and len(list(kept.glob("*.npz"))) > 3,
        *("identify", path, "--out", "results", "--jobs", 1),
    )
    assert code == 130
    assert is_one_line_about(errors, "interrupted", "the evaluations so far are kept in results")
    assert len(list(kept.glob("*.npz"))) > 3


@pytest.fixture
def address() -> Iterator[str]:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as running:
        yield running.scheduler_address


@pytest.mark.slow
def test_dask_workers_find_what_one_process_finds(
    fitted: tuple[Path, Identification], address: str, tmp_path: Path
) -> None:
    path, alone = fitted
    result = run_study(path, str(tmp_path), ParallelConfig(backend="dask", address=address))
    for one, other in zip(result.engines["mujoco"].candidates, alone.engines["mujoco"].candidates, strict=True):
        assert (one.parameters, one.loss, one.sizes) == (other.parameters, other.loss, other.sizes)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "dart"])
def test_a_hidden_friction_is_recovered_in_other_engines(engine: str, study: Callable[..., Path]) -> None:
    path = study(engines=[engine])
    write(path.parent / "tosses.csv", rows(thrown(cube_config(engine), number=18)))
    (parameter,) = run_study(path).engines[engine].best.parameters
    assert parameter.low < MU < parameter.high
    assert np.log(parameter.value / MU) == pytest.approx(0.0, abs=0.05)
