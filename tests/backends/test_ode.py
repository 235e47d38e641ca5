"""What ODE alone has: its options, its bindings, and friction that its pyramid would get wrong."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from requirements import needs

from imolo.contracts.engine import Engine, EngineState, Scene
from imolo.errors import BackendError, DivergenceError
from imolo_backends.conformance.bodies import (
    BALL_RADIUS,
    LINK_NAMES,
    PLATE_CENTER,
    ball_scene,
    box_scene,
    flying_robot,
    pendulum_scene,
    solid_ball,
    standing_robot,
)

pytestmark = needs("ode")

DT = 1e-4
G = 9.81
WEIGHTLESS = (0.0, 0.0, 0.0)


def options(**chosen: Any) -> Any:
    from imolo_backends.engines.ode_engine import OdeOptions

    return OdeOptions(**chosen)


def make(scene: Scene, **chosen: Any) -> Any:
    from imolo_backends.engines.ode_engine import OdeEngine

    return OdeEngine(scene, options(**chosen))


def run(engine: Engine, time: float, torque: float = 0.0) -> EngineState:
    joints = len(engine.motion()[0])
    for _ in range(round(time / DT)):
        engine.step(np.full(joints, torque), np.zeros(3))
    return engine.read()


def slide(degrees: float, **chosen: Any) -> tuple[float, float]:
    """Return how far [m] and in which direction [°] a box slides that starts at 2 m/s in a direction."""
    direction = np.radians(degrees)
    velocity = (2.0 * np.cos(direction), 2.0 * np.sin(direction), 0.0)
    scene = box_scene(base_position=(0.0, 0.0, 0.05), base_velocity=velocity, friction=0.5)
    x, y, _ = run(make(scene, **chosen), 0.6).link_position[0]
    return float(np.hypot(x, y)), float(np.degrees(np.arctan2(y, x)))


STOPPING = 2.0**2 / (2.0 * 0.5 * G)  # [m] of that box
EULER = 2.0 * DT  # [m] twice the bias ½ v dt of its integrator


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 90.0])
def test_a_box_slides_equally_far_in_every_direction(degrees: float) -> None:
    distance, direction = slide(degrees)
    assert distance == pytest.approx(STOPPING, abs=EULER)
    assert direction == pytest.approx(degrees, abs=1e-6)


def test_a_pyramid_slows_by_both_its_axes_at_once() -> None:
    assert slide(90.0, friction="pyramid")[0] == pytest.approx(STOPPING, abs=EULER)
    # At 45° both give μ N, so together √2 times too much.
    assert slide(45.0, friction="pyramid")[0] == pytest.approx(STOPPING / np.sqrt(2.0), abs=EULER)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0])
@pytest.mark.parametrize(("slope", "slides"), [(0.49, False), (0.51, True)])
def test_a_box_on_a_ramp_slides_where_it_is_steeper_than_its_friction(
    degrees: float, slope: float, slides: bool
) -> None:
    tilt, direction, time = np.arctan(slope), np.radians(degrees), 0.3
    down = np.sin(tilt) * np.array([np.cos(direction), np.sin(direction)])
    gravity = (G * down[0], G * down[1], -G * np.cos(tilt))
    state = run(make(box_scene(base_position=(0.0, 0.0, 0.05), gravity=gravity, friction=0.5)), time)
    moved = float(np.hypot(*state.link_position[0][:2]))
    acceleration = G * (np.sin(tilt) - 0.5 * np.cos(tilt)) if slides else 0.0
    assert moved == pytest.approx(0.5 * acceleration * time * (time + DT), abs=1e-6)


@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("height", [0.25, 0.5, 1.0])
def test_the_ball_bounces_with_the_restitution_asked_for(restitution: float, height: float) -> None:
    ball = solid_ball((3.0, 0.0, height + BALL_RADIUS))
    engine = make(ball_scene(ball, restitution=restitution))
    # Until it turns: free fall from this height takes √(2 h / g).
    before = run(engine, round(np.sqrt(2.0 * height / G) - 2 * DT, 4)).ball_velocity[2]
    after = max(run(engine, DT).ball_velocity[2] for _ in range(8))
    # It falls for a few steps more, at g dt each; without bounce, a share of the penetration is what lifts it.
    allowed = options().contact_erp if restitution == 0.0 else 8.0 * G * DT / abs(before)
    assert after / abs(before) == pytest.approx(restitution, abs=allowed)


@pytest.mark.parametrize("speed", [10.0, 25.0, 50.0])
def test_the_plate_of_a_pressed_arm_is_a_wall(speed: float) -> None:
    scene = flying_robot(fixed_base=True, gravity=WEIGHTLESS, joint_angle=(0.0,) * 8)
    hand = make(scene).read().link_position[LINK_NAMES.index("right_arm")] + PLATE_CENTER
    ball = solid_ball(tuple(hand + np.array([0.2, 0.0, 0.0])), (-speed, 0.0, 0.0))
    engine = make(replace(scene, ball=ball))
    nearest = min(run(engine, DT, -0.6).ball_position[0] for _ in range(400)) - hand[0]
    # It enters by no more than it flies in a step.
    assert ball.radius + 0.0015 - speed * DT <= nearest <= ball.radius + 0.0015
    assert engine.read().ball_velocity[0] == pytest.approx(scene.restitution * speed, rel=1e-6)


def test_the_papers_settings_replace_defaults_and_give_way_to_what_is_said() -> None:
    paper = options(settings="paper")
    assert (paper.erp, paper.cfm, paper.contact_erp, paper.max_contacts) == (1e-6, 1e-6, 1e-6, 3)
    assert options(settings="paper", erp=0.2) == paper.model_copy(update={"erp": 0.2})
    # What a results folder keeps gives the same again.
    assert options(**paper.model_dump()) == paper
    with pytest.raises(ValidationError):
        options(settings="papers")


@pytest.mark.parametrize(("chosen", "points"), [({}, 4), ({"settings": "paper"}, 3), ({"max_contacts": 1}, 1)])
def test_contact_points_are_at_most_as_many_as_asked_for(chosen: dict[str, Any], points: int) -> None:
    from imolo_backends.engines.ode_step import MADE

    depth = 1e-4
    engine = make(box_scene(base_position=(0.0, 0.0, 0.05 - depth)), **chosen)
    state = run(engine, DT)
    assert engine._block[0][MADE] == points
    # As deep as they were found: no step lifts the box by more than all of it.
    assert state.link_position[0][2] == pytest.approx(0.05 - depth, abs=depth)


def test_constants_of_an_older_ode_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    from imolo_backends.engines import ode_library, ode_model

    monkeypatch.setattr(ode_model, "STOP_ERP", ode_library.ode.ParamStopERP)
    with pytest.raises(BackendError, match="bounce, ERP and CFM of right_hip's stops"):
        make(standing_robot())


def test_joints_are_tighter_than_with_the_papers_settings() -> None:
    scene = replace(pendulum_scene(), joint_angle=(np.pi / 2,))

    def gap(**chosen: Any) -> float:
        stand, rod = run(make(scene, **chosen), 1.0).link_position
        return float(np.linalg.norm(rod - stand))

    # A step leaves the arc by (w dt)² / 2 times the lever, of which the ERP removes its share in the next.
    fastest, lever = np.sqrt(3.0 * G), 0.5
    assert gap() < fastest**2 * DT**2 / 2 * lever / 0.8 * 1.1
    assert gap(settings="paper") > 10.0 * gap()


@pytest.mark.parametrize(("torque", "speed"), [(0.0, 1e150), (1e150, 0.0), (np.inf, 0.0), (np.nan, 0.0)])
def test_what_would_end_the_process_is_a_divergence(torque: float, speed: float) -> None:
    engine = make(flying_robot(base_angular_velocity=(speed, 0.0, 0.0)))
    with pytest.raises(DivergenceError, match="not finite or beyond"):
        engine.step(np.full(8, torque), np.zeros(3))


def test_a_range_of_a_whole_turn_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(standing_robot().urdf.read_text().replace('lower="0" upper="1.1"', 'lower="-4" upper="2.6"'))
    with pytest.raises(BackendError, match=r"ODE cannot limit right_hip to \(-4\.0, 2\.6.*a whole turn or more"):
        make(replace(standing_robot(), urdf=path))


def test_an_impact_takes_no_more_along_the_floor_than_friction_times_what_it_gives_upwards() -> None:
    # A tumbling box turns the slip of its contacts within an impact; across it friction has nothing to hold.
    mu, worst = 0.2, 0.0
    for seed in range(4):
        chance = np.random.default_rng(seed)
        turn = chance.normal(size=4)
        scene = box_scene(
            base_position=(0.0, 0.0, 0.2),
            base_quaternion=tuple((turn / np.linalg.norm(turn)).tolist()),
            base_velocity=(1.0, 0.5, -1.0),
            base_angular_velocity=tuple(chance.uniform(-8.0, 8.0, 3).tolist()),
            friction=mu,
            timestep=1e-3,
        )
        engine = make(scene, sweeps=50)
        places = []
        for _ in range(150):
            engine.step(np.zeros(0), np.zeros(3))
            places.append(engine.read().link_position[0])
        change = np.diff(places, n=2, axis=0) / 1e-3 + [0.0, 0.0, G * 1e-3]
        hits = change[change[:, 2] > 0.05]
        assert len(hits)
        worst = max(worst, float((np.hypot(hits[:, 0], hits[:, 1]) / hits[:, 2]).max()))
    # The sweeps leave a hundredth or so.
    assert worst == pytest.approx(mu, rel=0.02)


def test_sweeps_slide_as_far_as_the_exact_solver() -> None:
    exact, swept = slide(30.0), slide(30.0, sweeps=50)
    assert swept == pytest.approx(exact, rel=2e-3)
