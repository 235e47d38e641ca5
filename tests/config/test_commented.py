"""`imolo config NAME` writes what the name stands for, and a name goes wherever a config does."""

from pathlib import Path

import pytest
import yaml
from command_line import Run, is_one_line_about
from requirements import BACKEND_PARAMS

from imolo.config.loading import backend_options, config_for, load_config
from imolo.contracts.registry import ROBOTS

CONFIGS = Path(__file__).parents[2] / "configs"
BACKENDS = [*BACKEND_PARAMS, "hardware"]


def written(run: Run, *arguments: object) -> Path:
    code, output, errors = run("config", *arguments)
    assert (code, errors) == (0, "")
    Path("my.yaml").write_text(output, encoding="utf-8")
    return Path("my.yaml")


@pytest.mark.parametrize("backend", BACKENDS)
def test_written_config_is_what_the_name_stands_for(run: Run, backend: str) -> None:
    config = load_config(written(run, backend))
    assert config == config_for(backend)
    assert config.digest() == config_for(backend).digest()


@pytest.mark.parametrize("robot", ROBOTS.names())
def test_written_config_is_that_of_the_robot(run: Run, robot: str) -> None:
    assert load_config(written(run, "mujoco", "--robot", robot)) == config_for("mujoco", robot={"name": robot})


@pytest.mark.parametrize("backend", BACKENDS)
def test_name_of_a_backend_is_the_shipped_config(backend: str) -> None:
    assert config_for(backend) == load_config(CONFIGS / f"{backend}.yaml")


def test_every_setting_is_told_once_where_it_first_stands(run: Run) -> None:
    text = written(run, "mujoco").read_text(encoding="utf-8")
    timestep = type(config_for("mujoco").simulation).model_fields["timestep"].description
    assert f"  timestep: 0.0001  # {timestep}\n" in text
    horizon = type(config_for("mujoco").methods["paper"].planner).model_fields["horizon"].description
    assert text.count(f"# {horizon}\n") == 1
    assert text.count(" horizon: ") == len(config_for("mujoco").methods)


def test_options_of_the_backend_stand_in_comments_and_are_its_defaults(run: Run) -> None:
    lines = written(run, "mujoco").read_text(encoding="utf-8").splitlines()
    first = next(row for row, line in enumerate(lines, 1) if line.startswith("  name: mujoco"))
    comments = [line for line in lines[first : first + 20] if line.startswith("  # ")]
    options = yaml.safe_load("\n".join(line.removeprefix("  # ") for line in comments))
    assert options == backend_options(config_for("mujoco")).model_dump(mode="json")


def test_config_of_a_file_is_written_with_what_it_leaves_out(run: Run) -> None:
    Path("short.yaml").write_text("backend: {name: mujoco, cone: pyramidal}\nseed: 7\n", encoding="utf-8")
    config = load_config(written(run, "short.yaml"))
    assert config == load_config(Path("short.yaml"))
    assert config.seed == 7


def test_name_that_is_neither_backend_nor_file_is_refused_with_the_nearest(run: Run) -> None:
    for command in (("config", "mujocco"), ("compare", "mujocco"), ("up", "mujocco"), ("attribute", "mujocco", "dart")):
        code, _, errors = run(*command)
        assert code == 2
        assert is_one_line_about(errors, "unknown backend 'mujocco'; did you mean 'mujoco'?")


def test_yaml_that_is_not_there_is_refused_as_a_file(run: Run) -> None:
    code, _, errors = run("learn", "mujoco.yaml")
    assert code == 2
    assert is_one_line_about(errors, "cannot read the config mujoco.yaml")


def test_robot_is_not_chosen_beside_a_file(run: Run) -> None:
    Path("short.yaml").write_text("backend: {name: mujoco}\n", encoding="utf-8")
    code, _, errors = run("config", "short.yaml", "--robot", "iiwa")
    assert code == 2
    assert is_one_line_about(errors, "short.yaml", "--robot")


def test_session_without_a_table_says_what_makes_one(run: Run) -> None:
    code, _, errors = run("up", "mujoco")
    assert code == 2
    assert is_one_line_about(errors, "no table of 'mujoco'", "`imolo learn mujoco` makes one")
