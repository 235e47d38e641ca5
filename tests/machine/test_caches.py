"""Where there is no home, numba and matplotlib keep what they made in a temporary folder, and nothing is said."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

KERNEL = "from imolo.ball.gate_kernel import nearest_marker; import matplotlib; print(matplotlib.get_cachedir())"


def run(environment: dict[str, str], *program: str) -> "subprocess.CompletedProcess[str]":
    """Run Python where a home cannot be written, and where the package is as if it could not."""
    kept = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "MPLCONFIGDIR")}
    only_elsewhere = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator,UserWideCacheLocator"}
    command = [sys.executable, *program]
    return subprocess.run(
        command, env={**kept, "XDG_CACHE_HOME": "", **only_elsewhere, **environment}, capture_output=True, text=True
    )


@pytest.mark.parametrize("home", ["/etc/passwd", "relative"])
def test_program_without_a_home_keeps_its_caches_in_a_temporary_folder(tmp_path: Path, home: str) -> None:
    ended = run({"HOME": home, "TMPDIR": str(tmp_path)}, "-c", KERNEL)
    assert (ended.returncode, ended.stderr) == (0, "")
    [folder] = tmp_path.iterdir()
    assert Path(ended.stdout.strip()).is_relative_to(folder)
    assert folder.stat().st_mode & 0o777 == 0o700
    assert (folder / "numba_cache_dir").is_dir()


@pytest.mark.parametrize(
    "spoil", [lambda folder: folder.chmod(0o777), lambda folder: folder.rename(folder.parent / "a")]
)
def test_folder_that_others_may_write_is_not_used(tmp_path: Path, spoil: object) -> None:
    folder = tmp_path / f"imolo-caches-{os.getuid()}"
    folder.mkdir()
    spoil(folder)  # type: ignore[operator]
    if not folder.exists():
        folder.symlink_to(tmp_path / "a")
    ended = run({"HOME": "/etc/passwd", "TMPDIR": str(tmp_path)}, "-m", "imolo.command_line.main", "--help")
    assert ended.returncode == 2
    assert ended.stderr == (
        "imolo: neither the home folder nor a temporary one can be written; set HOME or TMPDIR to one that can\n"
    )


def test_home_that_can_be_written_is_left_alone(tmp_path: Path) -> None:
    program = "import imolo, os; print(*(name for name in os.environ if name in ('NUMBA_CACHE_DIR', 'MPLCONFIGDIR')))"
    ended = run({"HOME": str(tmp_path)}, "-c", program)
    assert ended.stdout == "\n"
    assert not list(tmp_path.iterdir())
