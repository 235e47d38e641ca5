"""How a mutated engine is put before the conformance kit."""

from collections.abc import Callable
from functools import cache
from typing import Any

import pytest

from imolo.conformance import Verdict, run_check
from imolo.contracts.engine import Scene
from imolo.contracts.registry import BACKENDS
from imolo.contracts.urdf import read_urdf
from imolo_backends.conformance import SCENES
from imolo_backends.conformance.bodies import ROBOT
from imolo_backends.conformance.subject import Subject, bind
from imolo_backends.engines import dart_engine, mujoco_engine, pybullet_engine
from imolo_backends.engines.dart_engine import DartEngine
from imolo_backends.engines.mujoco_engine import MujocoEngine
from imolo_backends.engines.pybullet_engine import PybulletEngine

OPTIONS: dict[Any, Any] = {
    MujocoEngine: mujoco_engine.MujocoOptions,
    PybulletEngine: pybullet_engine.PybulletOptions,
    DartEngine: dart_engine.DartOptions,
}
NAMES = {MujocoEngine: "mujoco", PybulletEngine: "pybullet", DartEngine: "dart"}
ENGINES = [pytest.param(engine, id=name) for engine, name in NAMES.items()]
TOUCHABLE_LINKS = [name for name, link in read_urdf(ROBOT).links.items() if link.collisions]
CHECKS = {scene.__name__: scene for scene in SCENES}
BULLET: Any = pybullet_engine.pybullet
MUJOCO: Any = mujoco_engine.mujoco


def failed(engine: Any, mutated: Any, check: str) -> list[str]:
    """Return the quantities of a check that fail in the mutated engine."""
    subject = Subject(mutated, OPTIONS[engine]())
    outcomes = run_check(bind(CHECKS[check], subject), BACKENDS.load(NAMES[engine]).limitations)
    return [o.measurement.quantity if o.measurement else o.remark for o in outcomes if o.verdict is Verdict.FAIL]


@cache
def failed_unmutated(engine: Any, check: str) -> list[str]:
    return failed(engine, engine, check)


def assert_caught(engine: Any, mutated: Any, *checks: str) -> None:
    """Assert that each of these checks fails in the mutated engine and passes in the real one."""
    for check in checks:
        assert failed_unmutated(engine, check) == []
        assert failed(engine, mutated, check) != [], f"{check} does not see it"


def changed(engine: Any, change: Callable[[Any, Scene], None]) -> Any:
    """Return the engine with a change made after it was loaded and checked."""

    def load(self: Any, scene: Scene, options: Any) -> None:
        engine.__init__(self, scene, options)
        change(self, scene)

    return type(f"Changed{engine.__name__}", (engine,), {"__init__": load})
