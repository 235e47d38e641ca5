"""Where logs come from: those of other code or of another arithmetic are refused, not mixed in."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from instant_trials import CONFIG, play_at_once, tasks

from imolo.campaigns import campaign, kept_trials
from imolo.campaigns.campaign import TrialTask, run_tasks
from imolo.config.experiment import PluginConfig
from imolo.contracts import provenance
from imolo.errors import ResultsError


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "run_task", play_at_once)


@pytest.mark.parametrize("key", ["blas", "processor"])
def test_trials_of_another_arithmetic_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str) -> None:
    run_tasks(tasks(tmp_path), jobs=1)
    monkeypatch.setattr(campaign, "environment", lambda: kept_trials.environment() | {key: "another"})
    with pytest.raises(ResultsError, match=f"is of another {key}; give another --out"):
        run_tasks(tasks(tmp_path), jobs=1)


def test_kernel_of_the_linear_algebra_is_told_as_it_is() -> None:
    program = "from imolo.contracts.provenance import arithmetic; print(arithmetic()['blas'])"
    said = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "OPENBLAS_CORETYPE": core},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for core in ("Nehalem", "Sandybridge")
    }
    assert len(said) == 2


PLUGIN = "from imolo_backends.engines.mujoco_engine import BACKEND\n"


@pytest.mark.parametrize(
    ("lists", "changed"),
    [
        ({}, "toy/robot.xml"),  # data of a plug-in shapes its trials too
        ({"RECORD": "toy/engine.py,,\ntoy_physics/step.py,,\n"}, "toy_physics/step.py"),
        (
            {"RECORD": "toy/engine.py,,\n__editable___toy.py,,\ntoy_constants.py,,\n../bin/toy,,\n"},
            "toy_constants.py",
        ),
        ({"top_level.txt": "toy\ntoy_physics\n"}, "toy_physics/step.py"),
    ],
)
def test_plug_in_that_was_changed_is_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lists: dict[str, str], changed: str
) -> None:
    package = tmp_path / "site/toy"
    for folder in (package, tmp_path / "site/toy_physics"):
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text("")
    (package / "engine.py").write_text(PLUGIN)
    (tmp_path / "site/toy_constants.py").write_text("")
    about = tmp_path / "site/toy_engine-1.5.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-engine\nVersion: 1.5\n")
    (about / "entry_points.txt").write_text("[imolo.backends]\ntoy = toy.engine:BACKEND\n")
    for name, text in lists.items():
        (about / name).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    config = CONFIG.model_copy(update={"backend": PluginConfig(name="toy")})
    chosen = [TrialTask(config, task.trial, task.log_path) for task in tasks(tmp_path / "out")]

    def forget() -> None:
        provenance.provenance.cache_clear()
        provenance.digest_of_packages.cache_clear()

    forget()
    found = provenance.provenance("imolo.backends", "toy")
    assert (found.distribution, found.version) == ("toy-engine", "1.5")
    run_tasks(chosen, jobs=1)
    run_tasks(chosen, jobs=1)
    (tmp_path / "site" / changed).write_text("GRAVITY = 9.8\n")
    forget()
    with pytest.raises(ResultsError, match="is of another backend code; give another --out"):
        run_tasks(chosen, jobs=1)
    forget()
