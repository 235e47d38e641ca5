"""The engines under test."""

from collections.abc import Callable, Iterator
from importlib import import_module
from types import ModuleType
from typing import Any

import pytest
from requirements import BACKEND_PARAMS

from imolo.contracts.engine import Engine, Scene

ENGINES = {
    "mujoco": ("imolo_backends.engines.mujoco_engine", "MujocoEngine", "MujocoOptions"),
    "pybullet": ("imolo_backends.engines.pybullet_engine", "PybulletEngine", "PybulletOptions"),
    "dart": ("imolo_backends.engines.dart_engine", "DartEngine", "DartOptions"),
    "drake": ("imolo_backends.engines.drake_engine", "DrakeEngine", "DrakeOptions"),
    "sapien": ("imolo_backends.engines.sapien_engine", "SapienEngine", "SapienOptions"),
    "ode": ("imolo_backends.engines.ode_engine", "OdeEngine", "OdeOptions"),
}

MakeEngine = Callable[..., Engine]


@pytest.fixture(params=BACKEND_PARAMS)
def engine_name(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
def engine_module(engine_name: str) -> ModuleType:
    return import_module(ENGINES[engine_name][0])


@pytest.fixture
def make_engine(engine_name: str, engine_module: ModuleType) -> Iterator[MakeEngine]:
    _, engine, options = ENGINES[engine_name]
    made: list[Engine] = []

    def make(scene: Scene, **chosen: Any) -> Engine:
        made.append(getattr(engine_module, engine)(scene, getattr(engine_module, options)(**chosen)))
        return made[-1]

    yield make
    for one in made:
        one.close()
