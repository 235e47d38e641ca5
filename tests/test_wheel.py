"""The wheel: installed into a new environment it works in an empty folder, without a checkout."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import imolo

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
HERE = f"{sys.version_info.major}.{sys.version_info.minor}"


def call(*command: object, folder: Path) -> str:
    """Run a program in a folder, without what this environment has set, and return what it printed."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
    ended = subprocess.run(
        list(map(str, command)), cwd=folder, env={**environment, "COLUMNS": "80"}, capture_output=True, text=True
    )
    assert ended.returncode == 0, f"{ended.stdout}\n{ended.stderr}"
    return ended.stdout


def interpreter(version: str) -> str:
    """Return a Python of this version; empty where there is none that runs."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob(f"versions/{version}.*/bin/python")
    for found in [sys.executable] if version == HERE else [shutil.which(f"python{version}"), *sorted(pyenv)]:
        asked = [found or "false", "-c", "import sys; print(sys.executable)"]
        ended = subprocess.run(asked, capture_output=True, text=True)  # a shim of pyenv is there, and runs nothing
        if ended.returncode == 0:
            return ended.stdout.strip()
    return ""


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    call(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT, folder=folder)
    (built,) = folder.glob("imolo-*.whl")
    return built


def install(wheel: Path, version: str, folder: Path) -> Path:
    """Make an environment with the wheel; return its `imolo`.

    What the wheel needs comes from this environment, or from the registry for another version of Python.
    """
    python = interpreter(version)
    if not python:
        pytest.skip(f"there is no Python {version} here; install one, for example with pyenv")
    call(python, "-m", "venv", folder / "env", folder=folder)
    pip = [folder / "env/bin/python", "-m", "pip", "install", "--quiet"]
    if version == HERE:
        call(*pip, "--no-deps", wheel, folder=folder)
        (packages,) = (folder / "env/lib").glob("python*/site-packages")
        there = [path for path in sys.path if path.endswith("site-packages")]
        (packages / "shared.pth").write_text("\n".join(there), encoding="utf-8")
    else:
        call(*pip, "--only-binary", ":all:", f"{wheel}[mujoco,export]", folder=folder)
    return folder / "env/bin/imolo"


@pytest.mark.slow
@pytest.mark.parametrize("version", PYTHONS)
def test_wheel_works_in_an_empty_folder(wheel: Path, version: str, tmp_path: Path) -> None:
    program = install(wheel, version, tmp_path)
    empty = tmp_path / "empty"
    empty.mkdir()
    python = program.with_name("python")
    where = call(python, "-c", "import imolo, imolo_msgs; print(imolo.__file__, imolo_msgs.__file__)", folder=empty)
    assert where.count(str(tmp_path)) == 2
    assert call(program, "--version", folder=empty) == f"imolo {imolo.__version__}\n"
    assert re.search(r"^mujoco +ready ", call(program, "backends", folder=empty), re.MULTILINE)
    config = call(program, "config", "mujoco", folder=empty)
    coarse = config.replace("  timestep: 0.0001 ", "  timestep: 0.0005 ")
    assert coarse != config
    (empty / "my.yaml").write_text(coarse, encoding="utf-8")
    call(program, "compare", "my.yaml", "--balls", 1, "--jobs", 1, "--out", "results/first", folder=empty)
    assert (empty / "results/first/summary.json").is_file()
    logs = sorted((empty / "results/first").rglob("hit_*.lcmlog"))
    assert len(logs) == 2  # a ball for each method
    assert "TRUTH_BALL" in call(program, "top", logs[0], folder=empty)
    for to in ("mcap", "csv"):
        call(program, "export", logs[0], "--to", to, folder=empty)
    call(program, "report", "results/first", folder=empty)
    assert (empty / "results/first/report.html").is_file()


def test_version_is_the_same_wherever_it_stands() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    assert cited is not None
    assert project["version"] == imolo.__version__ == cited[1]


@pytest.mark.parametrize("version", PYTHONS)
def test_classifiers_name_the_pythons_that_are_tested(version: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"Programming Language :: Python :: {version}" in project["classifiers"]
    assert project["requires-python"] == f">={PYTHONS[0]}"
