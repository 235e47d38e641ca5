"""The engine and the packaging that docs/adding-an-engine.md shows work as they stand there."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from liberobot import foam_ball, ready_scene
from mypy import api

from imolo.conformance import Verdict, run_check
from imolo.contracts.backend import BackendPlugin
from imolo_backends.engines.mujoco_engine import MujocoEngine, MujocoOptions

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "adding-an-engine.md").read_text()


def block(language: str) -> str:
    """Return the first block of code in this language."""
    found = re.search(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert found is not None
    return found[1]


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    (tmp_path / "my_engine.py").write_text(block("python"))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield import_module("my_engine")
    del sys.modules["my_engine"]


def test_the_entry_point_names_the_plugin(module: ModuleType) -> None:
    target = tomllib.loads(block("toml"))["project"]["entry-points"]["imolo.backends"]["my_engine"]
    name, attribute = target.split(":")
    assert name == module.__name__
    assert isinstance(getattr(module, attribute), BackendPlugin)


def test_it_passes_scenes_of_the_kit_or_declares_why_not(module: ModuleType) -> None:
    wanted = {"clock", "copies", "joint_order", "current_read", "base_frame", "divergence", "free_fall"}
    wanted |= {"rod_pendulum", "restitution_asked"}
    checks = [check for check in module.BACKEND.checks(module.MyOptions()) if check.name in wanted]
    assert {check.name for check in checks} == wanted
    outcomes = [outcome for check in checks for outcome in run_check(check, module.BACKEND.limitations)]
    assert [outcome for outcome in outcomes if outcome.verdict is Verdict.FAIL] == []


def test_it_tells_the_same_touch_as_our_adapter(module: ModuleType) -> None:
    scene = replace(ready_scene(), ball=replace(foam_ball((0.9, 0.13, 1.0)), velocity=(-6.0, 0.0, 1.0)))
    first = []
    for engine in (module.MyEngine(scene, module.MyOptions()), MujocoEngine(scene, MujocoOptions())):
        contacts = ()
        while not contacts:
            engine.step(np.zeros(8), np.zeros(3))
            contacts = engine.read().ball_contacts
        first.append(contacts[0])
    assert first[0].other == first[1].other
    assert first[0].time == pytest.approx(first[1].time, abs=scene.timestep)
    assert first[0].position == pytest.approx(first[1].position, abs=1e-3)  # two steps at 6 m/s


def test_it_is_formatted_linted_and_typed_strictly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_engine.py").write_text(block("python"))
    monkeypatch.chdir(ROOT)
    for command in (["check", "--ignore=TID251"], ["format", "--check"]):
        ran = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "--config", "pyproject.toml", tmp_path / "my_engine.py"],
            capture_output=True,
            text=True,
        )
        assert ran.returncode == 0, ran.stdout
    told, _, _ = api.run(["--strict", "--no-error-summary", str(tmp_path / "my_engine.py")])
    assert told == ""
