"""The page docs/adding-a-robot.md: its code is the starting files, and these run."""

import re
from pathlib import Path

import pytest
from command_line import Run, is_one_line_about
from starting_files import blocks, imolo, write_and_install

PAGE = "adding-a-robot.md"
IMPORTS = """
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imolo.errors import ConfigError
from imolo.method.commands import Commands
from imolo.method.motion import MotionTemplate, Parameter
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which `imolo new` has written a robot, from where an environment finds it."""
    folder = tmp_path_factory.mktemp("new")
    write_and_install(folder, "robot", "paddle")
    return folder


@pytest.mark.parametrize(
    ("language", "file"), [("xml", "paddle.urdf"), ("python", "robot.py"), ("yaml", "paddle.yaml")]
)
def test_page_shows_the_starting_files(folder: Path, language: str, file: str) -> None:
    assert (folder / "paddle" / "paddle" / file).read_text(encoding="utf-8") == blocks(PAGE, language)[0]


def test_starting_files_are_fewer_lines_than_promised(folder: Path) -> None:
    files = [path for path in (folder / "paddle").rglob("*") if path.suffix in (".py", ".urdf", ".yaml", ".toml")]
    assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files) < 150


def test_new_robot_is_listed_and_conforms(folder: Path) -> None:
    assert "one motor swings a plate up" in imolo(folder, "paddle", "robots").stdout
    checked = imolo(folder, "paddle", "check", "--robot", "paddle", "mujoco", "--jobs", 1)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_new_robot_hits_balls(folder: Path) -> None:
    config = f"{blocks(PAGE, 'yaml')[1]}\ncampaign: {{learning_throws: 4, balls: 3}}\n"
    (folder / "mujoco.yaml").write_text(config, encoding="utf-8")
    compared = imolo(folder, "paddle", "compare", "mujoco.yaml", "--out", "results", "--jobs", 1)
    assert compared.returncode == 0, compared.stderr
    summary = (folder / "results" / "summary.json").read_text(encoding="utf-8")
    assert '"robot": "paddle"' in summary
    assert re.search(r'"improved": \{\s*"hits": [23],', summary), summary


def test_motion_of_ones_own_hits_balls(tmp_path: Path) -> None:
    package = write_and_install(tmp_path, "robot", "paddle") / "paddle"
    template, settings = blocks(PAGE, "python")[1], blocks(PAGE, "yaml")[2]
    robot = (package / "robot.py").read_text(encoding="utf-8")
    head, said, rest = robot.partition("\nROBOT = ")
    assert said
    rest = rest.replace("config=MotorExperiment", "config=PaddleExperiment")
    (package / "robot.py").write_text(f"{head}\n{IMPORTS}\n{template}\n{said}{rest}", encoding="utf-8")
    defaults = (package / "paddle.yaml").read_text(encoding="utf-8")
    before = re.search(r"^motion:.*?(?=^methods:)", defaults, re.MULTILINE | re.DOTALL)
    assert before is not None
    sampled = "  sampled_from: 0.06\n  sampled_to: 0.24\n"
    defaults = defaults.replace(before[0], settings + sampled)
    grid = "        t_w: {start: 0.1,"
    assert grid in defaults
    rise = "        rise: {start: 2.2, stop: 2.4, step: 0.1}\n"
    (package / "paddle.yaml").write_text(defaults.replace(grid, rise + grid), encoding="utf-8")
    config = f"{blocks(PAGE, 'yaml')[1]}\ncampaign: {{learning_throws: 4, balls: 3}}\n"
    (tmp_path / "mujoco.yaml").write_text(config, encoding="utf-8")
    compared = imolo(tmp_path, "paddle", "compare", "mujoco.yaml", "--out", "results", "--jobs", 1)
    assert compared.returncode == 0, compared.stderr
    summary = (tmp_path / "results" / "summary.json").read_text(encoding="utf-8")
    assert re.search(r'"improved": \{\s*"hits": [23],', summary), summary


def test_names_that_cannot_be_are_refused(run: Run) -> None:
    for name, part in (("My-Arm", "no name for a Python package"), ("liberobot", "already"), ("class", "no name")):
        code, _, errors = run("new", "robot", name)
        assert code == 2
        assert is_one_line_about(errors, name, part)
