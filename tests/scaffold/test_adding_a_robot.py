"""The page docs/adding-a-robot.md: its code is the starting files, and these run."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Run, is_one_line_about

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "adding-a-robot.md").read_text(encoding="utf-8")
PATIENCE = 500.0  # [s]


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def paddle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a robot that `imolo new` has written, from where an environment finds it."""
    folder = tmp_path_factory.mktemp("new")
    made = imolo(folder, "new", "robot", "paddle")
    assert made.returncode == 0, made.stderr
    # What `pip install --editable` would write: a distribution with its entry point.
    info = folder / "paddle" / "paddle-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: paddle\nVersion: 0.1.0\n", encoding="utf-8")
    entry_points = re.findall(
        r'\[project\.entry-points\."(.*?)"\]\n((?:\w.*\n)+)', (folder / "paddle" / "pyproject.toml").read_text("utf-8")
    )
    text = "".join(f"[{group}]\n{lines}".replace('"', "") for group, lines in entry_points)
    (info / "entry_points.txt").write_text(text, encoding="utf-8")
    return folder


def imolo(folder: Path, *arguments: object) -> "subprocess.CompletedProcess[str]":
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(folder / "paddle"), os.environ.get("PYTHONPATH", "")]),
    }
    command = [sys.executable, "-m", "imolo.command_line.main", *map(str, arguments)]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
    )


@pytest.mark.parametrize(
    ("language", "file"), [("xml", "paddle.urdf"), ("python", "robot.py"), ("yaml", "paddle.yaml")]
)
def test_page_shows_the_starting_files(paddle: Path, language: str, file: str) -> None:
    assert (paddle / "paddle" / "paddle" / file).read_text(encoding="utf-8") == blocks(language)[0]


def test_starting_files_are_fewer_lines_than_promised(paddle: Path) -> None:
    files = [path for path in (paddle / "paddle").rglob("*") if path.suffix in (".py", ".urdf", ".yaml", ".toml")]
    assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files) < 150


def test_new_robot_is_listed_and_conforms(paddle: Path) -> None:
    assert "one motor swings a plate up" in imolo(paddle, "robots").stdout
    checked = imolo(paddle, "check", "--robot", "paddle", "mujoco", "--jobs", 1)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_new_robot_hits_balls(paddle: Path) -> None:
    config = f"{blocks('yaml')[1]}\ncampaign: {{learning_throws: 4, balls: 3}}\n"
    (paddle / "mujoco.yaml").write_text(config, encoding="utf-8")
    compared = imolo(paddle, "compare", "mujoco.yaml", "--out", "results", "--jobs", 1)
    assert compared.returncode == 0, compared.stderr
    summary = (paddle / "results" / "summary.json").read_text(encoding="utf-8")
    assert '"robot": "paddle"' in summary
    assert re.search(r'"improved": \{\s*"hits": [23],', summary), summary


def test_names_that_cannot_be_are_refused(run: Run) -> None:
    for name, part in (("My-Arm", "no name for a Python package"), ("liberobot", "already"), ("class", "no name")):
        code, _, errors = run("new", "robot", name)
        assert code == 2
        assert is_one_line_about(errors, name, part)
