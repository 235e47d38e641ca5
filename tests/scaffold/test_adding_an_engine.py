"""The page docs/adding-an-engine.md: its code is the starting files, and these run."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from liberobot import foam_ball, ready_scene
from starting_files import blocks, imolo, write_and_install

from imolo.conformance import Verdict, run_check
from imolo_backends.engines.mujoco_engine import MujocoEngine, MujocoOptions

PAGE = "adding-an-engine.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which `imolo new` has written an engine, from where an environment finds it."""
    folder = tmp_path_factory.mktemp("new")
    write_and_install(folder, "engine", "wrapped")
    return folder


@pytest.fixture
def module(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(folder / "wrapped"))
    yield import_module("wrapped.engine")
    for name in ("wrapped.engine", "wrapped"):
        del sys.modules[name]


@pytest.mark.parametrize(
    ("language", "file"), [("python", "wrapped/engine.py"), ("toml", "pyproject.toml")], ids=["engine", "packaging"]
)
def test_page_shows_the_starting_files(folder: Path, language: str, file: str) -> None:
    assert (folder / "wrapped" / file).read_text(encoding="utf-8") == blocks(PAGE, language)[0]


@pytest.mark.slow
def test_new_engine_is_listed_and_runs_at_once(folder: Path) -> None:
    assert "one line for `imolo backends`" in " ".join(imolo(folder, "wrapped", "backends").stdout.split())
    checked = imolo(folder, "wrapped", "check", "wrapped", "--only", "clock")
    assert checked.returncode == 0, checked.stdout + checked.stderr


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
