"""Fixtures that tests of several folders use."""

import sys
from pathlib import Path

import pytest
from command_line import Run
from hypothesis import settings

from imolo.command_line.main import main

# On a busy machine any example may take long.
settings.register_profile("imolo", deadline=None)
settings.load_profile("imolo")


@pytest.fixture
def columns() -> int:
    """Return the width of the terminal."""
    return 80


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, columns: int) -> Run:
    """Run `imolo` in this process and in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", str(columns))
    # `python -m pytest` would be part of the program's name in its help.
    monkeypatch.setattr(sys.modules["__main__"], "__package__", "")

    def run_it(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["imolo", *map(str, arguments)])
        try:
            main()
            code: object = 0
        except SystemExit as ended:
            code = ended.code or 0
        captured = capsys.readouterr()
        assert isinstance(code, int)
        return code, captured.out, captured.err

    return run_it
