"""Robots that bounce: the coefficient of restitution of their own contacts, apart from that of the ball."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imolo.config.loading import config_for
from imolo.errors import BackendError
from imolo_backends.conformance.bodies import BALL_RADIUS, ball_scene, body_scene, solid_ball

DT = 1e-4
G = 9.81
RADIUS = 0.05  # [m]
SPEED = 1.5  # [m/s] downwards
GAP, END = 0.02, 0.06  # [m], [s]
BODY = (
    '<link name="body"><inertial><mass value="1"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" '
    f'iyz="0"/></inertial><collision><geometry><sphere radius="{RADIUS}"/></geometry></collision></link>'
)


def rebound(make_engine: Any, restitution: float) -> float:
    """Return the speed at which a sphere leaves the floor over that at which it came."""
    start = {"base_position": (0.0, 0.0, RADIUS + GAP), "base_velocity": (0.0, 0.0, -SPEED), "timestep": DT}
    engine = make_engine(replace(body_scene("sphere", BODY, ("body",), **start), robot_restitution=restitution))
    before = np.sqrt(SPEED**2 + 2.0 * G * GAP)
    last = 0.0
    for _ in range(round(END / DT)):
        if engine.time > END - 1.5 * DT:
            last = engine.read().link_position[0, 2]
        engine.step(np.zeros(0), np.zeros(3))
    after = (engine.read().link_position[0, 2] - last) / DT
    since_impact = END - GAP / (0.5 * (SPEED + before))
    return float((after + G * since_impact) / before)


@pytest.fixture
def bouncing_engine(make_engine: Any, engine_name: str) -> Any:
    """Return what makes an engine, or makes sure that one whose robots cannot bounce says so."""
    if engine_name == "drake":
        with pytest.raises(BackendError, match="leave robot_restitution at 0"):
            make_engine(replace(body_scene("sphere", BODY, ("body",)), robot_restitution=0.3))
        pytest.skip("its robots do not bounce, as it says")
    return make_engine


@pytest.mark.parametrize("restitution", [0.3, 0.6])
def test_a_body_bounces_with_the_restitution_asked_for(bouncing_engine: Any, restitution: float) -> None:
    # Gravity of the steps in contact: MuJoCo's spring of 1000 rad/s or more is in contact for pi ms at most.
    allowed = G * np.pi * 1e-3 / SPEED
    assert rebound(bouncing_engine, restitution) == pytest.approx(restitution, abs=allowed)


def test_the_ball_bounces_as_before_where_the_robot_bounces(bouncing_engine: Any) -> None:
    speeds = []
    for robot_restitution in (0.0, 0.6):
        ball = solid_ball((0.0, 0.0, BALL_RADIUS + 0.01))
        scene = replace(ball_scene(ball, restitution=0.3), robot_restitution=robot_restitution)
        engine = bouncing_engine(scene)
        joints = len(scene.joint_names)
        for _ in range(round(0.06 / scene.timestep)):
            engine.step(np.zeros(joints), np.zeros(3))
        speeds.append(float(engine.motion()[2][2]))
    # Bullet's factors are floats of 32 bits.
    assert speeds[1] == pytest.approx(speeds[0], abs=1e-5)


def test_a_robot_does_not_bounce_unless_it_is_told_to() -> None:
    assert config_for("mujoco").simulation.contact.robot_restitution == 0.0
