"""Mistakes of friction that engines and their adapters are known for are caught by the conformance kit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mutants import BULLET, ENGINES, OPTIONS, assert_caught, changed

from imolo.contracts.engine import Array, EngineState, Scene
from imolo_backends.engines import pybullet_engine
from imolo_backends.engines.dart_engine import DartEngine
from imolo_backends.engines.mujoco_engine import MujocoEngine
from imolo_backends.engines.pybullet_engine import PybulletEngine


def set_friction(engine: Any, friction: float) -> None:
    """Set the friction coefficient of every contact."""
    if isinstance(engine, MujocoEngine):
        engine._model.geom_friction[:, 0] = friction
    elif isinstance(engine, PybulletEngine):
        for body, link in [*engine._names, (engine._ball, pybullet_engine.BASE)]:
            BULLET.changeDynamics(body, link, lateralFriction=friction**0.5, physicsClientId=engine._client)
    else:
        world = engine._world
        for node in (n for i in range(world.getNumSkeletons()) for n in world.getSkeleton(i).getBodyNodes()):
            for shape in (shape for shape in node.getShapeNodes() if shape.hasDynamicsAspect()):
                shape.getDynamicsAspect().setFrictionCoeff(friction)


@pytest.mark.parametrize("engine", ENGINES)
def test_gliding_contacts_are_caught(engine: Any) -> None:
    mutated = changed(engine, lambda self, _: set_friction(self, 0.0))
    assert_caught(engine, mutated, "friction_asked", "friction_begins", "slide_to_roll", "friction_ramp")


def ball_or_robot_touches(engine: Any) -> bool:
    """Whether anything touched anything in the last step."""
    if isinstance(engine, MujocoEngine):
        return bool(engine._data.ncon)
    if isinstance(engine, PybulletEngine):
        return bool(BULLET.getContactPoints(physicsClientId=engine._client))
    return bool(engine._world.getLastCollisionResult().getNumContacts())


@pytest.mark.parametrize("engine", ENGINES)
def test_a_step_of_friction_that_is_lost_when_a_contact_begins_is_caught(engine: Any) -> None:
    class Lagged(engine):  # type: ignore[misc]
        """Glides until something has touched for a step."""

        def step(self, joint_torque: Array, ball_force: Array) -> None:
            set_friction(self, self._scene.friction if ball_or_robot_touches(self) else 0.0)
            super().step(joint_torque, ball_force)

    assert_caught(engine, Lagged, "friction_begins")


@pytest.mark.parametrize(
    ("engine", "options"),
    [
        pytest.param(PybulletEngine, {"cone_friction": False}, id="pybullet"),
        pytest.param(DartEngine, {"friction": "pyramid"}, id="dart"),
    ],
)
def test_a_pyramid_is_caught_in_impacts(engine: Any, options: dict[str, Any]) -> None:
    class Pyramid(engine):  # type: ignore[misc]
        def __init__(self, scene: Scene, _: Any) -> None:
            super().__init__(scene, OPTIONS[engine](**options))

    assert_caught(engine, Pyramid, "friction_of_impacts")


@pytest.mark.parametrize("engine", ENGINES[1:])  # MuJoCo declares that it hops
def test_what_hops_while_it_slides_is_caught(engine: Any) -> None:
    class Hopping(engine):  # type: ignore[misc]
        """Tells of a body that slides .1 mm above where it is."""

        def read(self) -> EngineState:
            state: EngineState = super().read()
            raised = np.add(state.link_position, (0.0, 0.0, 1e-4 * (self._steps > 0)))
            return replace(state, link_position=raised)

    assert_caught(engine, Hopping, "slide_0")
