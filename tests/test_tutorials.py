"""The tutorials of docs/ do what they say: their files are written, their commands run as printed, in their order."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import nbformat
import pytest
from live.network import namespace
from nbclient import NotebookClient
from requirements import needs

ROOT = Path(__file__).parents[1]
NETWORK = re.compile(r"^PIP_|_PROXY$|_CERT|_CA_|CAINFO", re.IGNORECASE)
PATIENCE = 1500.0  # [s] for one block, on a busy machine
BLOCK = re.compile(r"^```(sh|yaml|python)\n(?:# ([\w ]+(?:\.\w+)?)\n)?(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.fixture
def screen() -> Iterator[str]:
    """Return a display that nobody sees."""
    read, write = os.pipe()
    server = subprocess.Popen(["Xvfb", "-displayfd", str(write)], pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as told:
        yield f":{told.readline().strip()}"
    server.terminate()
    server.wait(10.0)


def here(display: str = "") -> dict[str, str]:
    """Return the environment of these tests, as activated in a terminal."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return {**os.environ, "PATH": path, "MPLBACKEND": "agg", "DISPLAY": display, "COLUMNS": "120"}


def follow(page: str, folder: Path, environment: dict[str, str]) -> str:
    """Do what a page says, in a folder and as in one terminal; return what its commands printed."""
    text = (ROOT / "docs/tutorials" / page).read_text(encoding="utf-8")
    printed, begun, others = "", [], []
    left = folder / ".environment"  # of the last block, for the next one
    try:
        for language, name, code in BLOCK.findall(text):
            if language != "sh":
                (folder / name).write_text(code, encoding="utf-8")
                continue
            shell = subprocess.Popen(
                ["bash", "-euc", f"{code}\nenv -0 > {left}"],
                cwd=folder,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
            begun.append(shell)
            if name == "second terminal":
                others.append(shell)
                continue
            output, _ = shell.communicate(timeout=PATIENCE)
            assert shell.returncode == 0, f"{code}\n{output}"
            printed += output
            environment = dict(line.split("=", 1) for line in left.read_text("utf-8").split("\0") if line)
        assert all(other.poll() is None for other in others), "what was to stay open has ended"
    finally:
        for shell in begun:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(shell.pid, signal.SIGTERM)
            shell.communicate(timeout=30.0)
    return printed


@pytest.mark.slow
def test_fresh_clone_ends_with_a_plot_of_ones_own_and_notebooks_that_go_on_from_it(tmp_path: Path) -> None:
    """By a user who has an empty home and of this machine's settings those alone by which it reaches a registry."""
    clone = tmp_path / "imolo"
    subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
    network = {name: value for name, value in os.environ.items() if NETWORK.search(name)}
    path = f"{Path(sys.base_prefix) / 'bin'}:/usr/bin:/bin"
    printed = follow("first-comparison.md", clone, {**network, "HOME": str(tmp_path), "PATH": path})
    assert "improved" in printed
    summary = json.loads((clone / "results/first/summary.json").read_text(encoding="utf-8"))
    assert set(summary["results"]) == {"mujoco", "dart"}
    for made in ("results/first/report.html", "pressures.png", "my_plot.png"):
        assert (clone / made).stat().st_size > 10_000, made
    for example in sorted((ROOT / "examples").glob("*.ipynb")):
        notebook = nbformat.read(example, as_version=4)
        NotebookClient(notebook, timeout=PATIENCE, resources={"metadata": {"path": str(clone)}}).execute()
        outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
        assert sum("image/png" in output.get("data", {}) for output in outputs) >= 2, example.name
        assert not [output for output in outputs if output.output_type == "error"]


@pytest.mark.slow
def test_engines_are_fitted_to_recordings(tmp_path: Path) -> None:
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    printed = follow("your-recordings.md", tmp_path, here())
    frictions = [float(value) for value in re.findall(r"^(?:mujoco|dart) ([\d.]+)$", printed, re.MULTILINE)]
    # What the page says of them, within the interval of so few tosses.
    assert len(frictions) == 2
    assert all(0.1 < friction < 0.3 for friction in frictions)
    assert (tmp_path / "results/tosses/report.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("mark", [pytest.param(None, marks=needs("netns", "jdk", "display"))], ids=["screen"])
def test_live_session_is_watched(mark: None, tmp_path: Path, screen: str) -> None:
    with namespace():
        printed = follow("watch-live.md", tmp_path, here(screen))
    for channel in ("MOCAP", "ACTUATOR_STATE", "PLAN"):
        assert channel in printed
