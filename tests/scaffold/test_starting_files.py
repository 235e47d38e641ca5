"""What `imolo new` writes is formatted, linted and typed strictly, by the settings it comes with and by ours."""

from pathlib import Path

import pytest
from starting_files import ROOT, command, write_and_install

# Ours ban MuJoCo outside its one file; the folder is not among our sources.
OURS = ["--config", str(ROOT / "pyproject.toml"), "--config", f"src={[str(ROOT), str(ROOT / 'backends')]}"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["robot", "engine"])
def test_starting_files_pass_lint_and_types(tmp_path: Path, kind: str) -> None:
    name = "a_name_that_is_rather_long"
    written = write_and_install(tmp_path, kind, name)
    for tool in (
        ["ruff", "check"],
        ["ruff", "format", "--check"],
        ["ruff", "check", *OURS, "--ignore=TID251"],
        ["ruff", "format", "--check", *OURS],
        ["mypy", "--strict", "--config-file", str(written / "pyproject.toml")],
    ):
        done = command(tmp_path, name, "-m", *tool, name)
        assert done.returncode == 0, done.stdout + done.stderr
