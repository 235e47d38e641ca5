"""The starting files of `imolo new`, where an environment finds them, and the pages of docs/ that show them."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PATIENCE = 500.0  # [s]


def blocks(page: str, language: str) -> list[str]:
    """Return the blocks of code of a page of docs/."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def write_and_install(folder: Path, kind: str, name: str) -> Path:
    """Write the starting files below `folder`, and what `pip install --editable` would write beside them."""
    made = command(folder, name, "-m", "imolo.command_line.main", "new", kind, name)
    assert made.returncode == 0, made.stderr
    written = folder / name
    info = written / f"{name}-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n", encoding="utf-8")
    project = (written / "pyproject.toml").read_text(encoding="utf-8")
    entry_points = re.findall(r'\[project\.entry-points\."(.*?)"\]\n((?:\w.*\n)+)', project)
    text = "".join(f"[{group}]\n{lines}".replace('"', "") for group, lines in entry_points)
    (info / "entry_points.txt").write_text(text, encoding="utf-8")
    return written


def imolo(folder: Path, name: str, *arguments: object) -> "subprocess.CompletedProcess[str]":
    """Run `imolo` in `folder`, in an environment that has the distribution `name`."""
    return command(folder, name, "-m", "imolo.command_line.main", *arguments)


def command(folder: Path, name: str, *arguments: object) -> "subprocess.CompletedProcess[str]":
    """Run Python in `folder`, in an environment that has the distribution `name`."""
    path = os.pathsep.join([str(folder / name), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
