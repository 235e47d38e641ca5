"""Studies of robots' logs, from their file to the result."""

import re
from pathlib import Path

import pytest
import yaml
from command_line import Run

from benchmarks.twins import ASSUMED, hide, record
from imolo.config.loading import config_for
from imolo.config.yaml_file import dump_yaml
from imolo.errors import ConfigError, TrainingDataError
from imolo.identification.parameters import declared
from imolo.identification.robot_log_study import RobotLogStudy
from imolo.identification.study_file import load_study

PAGE = Path(__file__).parents[2] / "docs" / "identify-a-robot.md"
BLOCKS = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
AIR = "simulation.actuators."


def written(folder: Path, **changes: object) -> Path:
    path = folder / "study.yaml"
    path.write_text(dump_yaml({**yaml.safe_load(BLOCKS[0]), **changes}))
    return path


def test_studies_on_the_page_can_be_read(tmp_path: Path) -> None:
    study = load_study(written(tmp_path, **yaml.safe_load(BLOCKS[1])))
    assert isinstance(study, RobotLogStudy)
    assert len(study.stages) == 3
    _, parameters = study.parameters_of(config_for("mujoco"))
    assert [one.path for one in parameters] == list(study.parameters)


def test_ranges_are_declared_where_defaults_of_a_robot_differ_and_hold_them() -> None:
    config = config_for("mujoco")
    marks = declared(config)
    assert marks[f"{AIR}tube_length"].low == 0.15
    assert {f"{AIR}rest_pressure.{index}" for index in range(8)} <= set(marks)
    actuators = config.simulation.actuators.model_dump()
    for path, mark in marks.items():
        name = path.removeprefix(AIR)
        if name in actuators:
            assert mark.low < actuators[name] < mark.high, path


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stages": [{"parameters": ["simulation.actuators.tub*"]}]}, "has none of the parameters"),
        (
            {"quantities": ["effector"], "stages": [{"parameters": [f"{AIR}*"], "quantities": ["sensors"]}]},
            "the study does not",
        ),
        (
            {"stages": [{"parameters": [f"{AIR}*"], "quantities": ["markers"], "without_engine": True}]},
            "compares sensors alone",
        ),
        ({"quantities": ["pressures"]}, "quantities"),
    ],
)
def test_study_that_cannot_be_meant_is_refused_in_one_line(
    tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(ConfigError, match=words) as error:
        load_study(written(tmp_path, **changes))
    assert "\n" not in str(error.value)


def test_folder_without_logs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TrainingDataError, match=r"holds no \.lcmlog; give the folder"):
        load_study(written(tmp_path)).experiment(tmp_path)  # type: ignore[union-attr]


def test_logs_are_fitted_judged_and_written_as_a_part_of_a_config(tmp_path: Path, run: Run) -> None:
    path = f"{AIR}exhaust_conductance"
    config, settings = hide("mujoco", 2, {path: 1.6})
    record(config, tmp_path / "logs", 10, seed=2)
    few = {"training": 5, "evaluations": 8, "halve_timestep": False, "quantities": ["effector"]}
    study = written(tmp_path, engines=["mujoco"], config=ASSUMED, parameters={path: {}}, **few)
    code, said, errors = run("identify", study, "--out", tmp_path / "out", "--jobs", 1)
    assert code == 0, said + errors
    found = yaml.safe_load((tmp_path / "out/patches/mujoco.yaml").read_text())
    assert found["simulation"]["actuators"]["exhaust_conductance"] == pytest.approx(settings[path], rel=0.1)
