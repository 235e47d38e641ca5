"""What every engine refuses, and how it tells contacts; what it computes is checked by the conformance kit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from liberobot import BODY, foam_ball, ready_scene
from pydantic import ValidationError

from imolo.contracts.engine import Array, Engine, EngineState, Scene
from imolo.contracts.urdf import RobotModel, read_urdf
from imolo.errors import BackendError
from imolo_backends.engines import adapter
from imolo_backends.engines.engine_checks import Loaded, check_loaded
from imolo_robots.liberobot.body import JOINT_NAMES, LINK_NAMES

DT = 1e-4
G = 9.81
NO_TORQUE = np.zeros(8)
NO_FORCE = np.zeros(3)
FAR_UP = (0.0, 0.0, 50.0)


def run(engine: Engine, time: float, torque: Array = NO_TORQUE, force: Array = NO_FORCE) -> EngineState:
    for _ in range(round(time / DT)):
        engine.step(torque, force)
    return engine.read()


def flying(**changes: Any) -> Scene:
    """Return the robot high in the air, all joints in the middle of their range."""
    scene = replace(ready_scene(), base_position=FAR_UP, joint_angle=tuple(BODY.joint_limits.mean(axis=1).tolist()))
    return replace(scene, **changes)


def expect_otherwise(monkeypatch: pytest.MonkeyPatch, part: str, name: str, **changes: Any) -> None:
    """Let the framework expect a link or joint that is not the URDF's, as if the engine had loaded it wrongly."""

    def check(scene: Scene, model: RobotModel, loaded: Loaded) -> None:
        items = getattr(model, part)
        check_loaded(scene, replace(model, **{part: {**items, name: replace(items[name], **changes)}}), loaded)

    monkeypatch.setattr(adapter, "check_loaded", check)


@pytest.mark.parametrize(
    ("value", "message"),
    [("mass", "mass of left_arm"), ("com", "COM of left_arm"), ("inertia", "inertia of left_arm")],
)
def test_a_link_that_is_not_the_urdfs_is_refused(
    make_engine: Any, monkeypatch: pytest.MonkeyPatch, value: str, message: str
) -> None:
    right = getattr(read_urdf(ready_scene().urdf).links["left_arm"], value)
    expect_otherwise(monkeypatch, "links", "left_arm", **{value: 1.001 * right})
    with pytest.raises(BackendError, match=message):
        make_engine(ready_scene())


@pytest.mark.parametrize("limits", [(0.0, 2.0), None])
def test_a_limit_that_is_not_the_urdfs_is_refused(
    make_engine: Any, monkeypatch: pytest.MonkeyPatch, limits: Any
) -> None:
    expect_otherwise(monkeypatch, "joints", "left_knee", limits=limits)
    with pytest.raises(BackendError, match="limits of left_knee"):
        make_engine(ready_scene())


def test_names_that_are_not_in_the_urdf_are_refused_with_a_hint(make_engine: Any) -> None:
    scene = ready_scene()
    with pytest.raises(BackendError, match=r"'right_hips' is not in liberobot\.urdf; did you mean 'right_hip'"):
        make_engine(replace(scene, joint_names=("right_hips", *JOINT_NAMES[1:])))
    with pytest.raises(BackendError, match="first link is 'left_arm'; expected the base 'trunk'"):
        make_engine(replace(scene, link_names=LINK_NAMES[::-1]))


def test_unknown_options_are_refused(make_engine: Any) -> None:
    with pytest.raises(ValidationError, match="no_such_option"):
        make_engine(ready_scene(), no_such_option=1)


def test_closing_twice_is_harmless(make_engine: Any) -> None:
    engine = make_engine(ready_scene())
    engine.close()
    engine.close()


def test_an_arm_swung_at_the_ball_hits_it(make_engine: Any) -> None:
    scene = flying(fixed_base=True, base_quaternion=(1.0, 0.0, 0.0, 0.0), joint_angle=(0.0,) * 8)
    shoulder = make_engine(scene).read().link_position[LINK_NAMES.index("left_arm")]
    ball = foam_ball(tuple(shoulder + np.array([0.40, 0.0, 0.0])))
    engine = make_engine(replace(scene, ball=ball))
    hold = np.array([0.0, 0.0, ball.mass * G])
    state = run(engine, 0.4, np.array([0.0] * 6 + [0.0, 6.0]), hold)
    assert {contact.other for contact in state.ball_contacts} <= {effector.link for effector in BODY.effectors}
    assert state.ball_velocity[2] > 3.0
