"""How the robot differs from trial to trial: not at all, as the profile says, or as the user chose."""

from math import sqrt

import numpy as np
import pytest
from liberobot import AIR, BODY, ready_scene
from pydantic import ValidationError

from imolo.config.disturbance import DisturbanceConfig
from imolo_backends.actuators.motors import MotorDisturbance
from imolo_backends.actuators.pneumatics import PneumaticDisturbance
from imolo_backends.simulation.simulated import draw_joint_offset

KINDS = (DisturbanceConfig, PneumaticDisturbance, MotorDisturbance)
READY = np.array(BODY.ready)
DRAWS = 500


def draw(config: PneumaticDisturbance, seed: int = 0, draws: int = DRAWS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return dead times (N, 8), supply pressures (N,) and joint angles (N, 8)."""
    rng = np.random.default_rng(seed)
    # In the order of a trial.
    drawn = [(AIR.draw(config, rng), draw_joint_offset(BODY, config.joint_angle, rng)) for _ in range(draws)]
    return (
        np.array([air.valve_dead_time for air, _ in drawn]),
        np.array([air.supply_pressure for air, _ in drawn]),
        np.array([offset for _, offset in drawn]),
    )


def test_none_disturbs_nothing() -> None:
    assert not any(values.any() for values in draw(PneumaticDisturbance(profile="none")))


def test_custom_starts_from_nothing() -> None:
    assert not any(values.any() for values in draw(PneumaticDisturbance(profile="custom")))


@pytest.mark.parametrize("kind", KINDS)
def test_custom_of_every_kind_starts_from_nothing(kind: type[DisturbanceConfig]) -> None:
    assert set(kind(profile="custom").model_dump(exclude={"profile"}).values()) == {0.0}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["none", "realistic"])
def test_named_profile_sets_every_value(kind: type[DisturbanceConfig], name: str) -> None:
    config = kind.model_validate({"profile": name})
    values = dict.fromkeys(set(kind.model_fields) - {"profile"}, 0.0) | kind.profiles[name]
    assert config.model_dump(exclude={"profile"}) == values
    assert kind.model_validate(config.model_dump()) == config


@pytest.mark.parametrize("seed", range(3))
def test_standard_deviations_are_as_configured(seed: int) -> None:
    config = PneumaticDisturbance(profile="custom", valve_dead_time=0.001, supply_pressure=1e4, joint_angle=0.02)
    dead_time, supply, angle = draw(config, seed)
    # Five standard errors; the joints' are half normals, whose root mean square is the standard deviation of the whole.
    for values, sd in ((dead_time, 0.001), (supply, 1e4), (angle, 0.02)):
        assert abs(sqrt(np.mean(values**2)) / sd - 1.0) < 5 / sqrt(2 * values.size)
    assert abs(dead_time.mean()) < 5 * 0.001 / sqrt(dead_time.size)
    assert abs(supply.mean()) < 5 * 1e4 / sqrt(supply.size)


def test_joints_are_off_to_the_inside_alone() -> None:
    _, _, angle = draw(PneumaticDisturbance(profile="custom", joint_angle=0.02))
    at = READY + angle
    assert (at >= BODY.joint_limits[:, 0]).all()
    assert (at <= BODY.joint_limits[:, 1]).all()
    assert (angle != 0.0).all()


def test_disturbed_ready_pose_is_accepted_by_the_scene() -> None:
    _, _, angle = draw(PneumaticDisturbance(), draws=3)
    for offset in angle:
        assert ready_scene(offset).joint_angle == pytest.approx(READY + offset, abs=1e-15)


def test_one_disturbance_does_not_change_the_chance_of_another() -> None:
    one = draw(PneumaticDisturbance(profile="custom", joint_angle=0.02))
    both = draw(PneumaticDisturbance(profile="custom", joint_angle=0.02, supply_pressure=1e4))
    assert np.array_equal(one[2], both[2])


@pytest.mark.parametrize("profile", ["none", "realistic"])
def test_value_beside_a_named_profile_is_refused(profile: str) -> None:
    with pytest.raises(ValidationError, match=f"profile '{profile}' sets joint_angle itself; use `profile: custom`"):
        DisturbanceConfig(profile=profile, joint_angle=0.5)


def test_unknown_profile_is_refused() -> None:
    with pytest.raises(ValidationError, match="profile"):
        DisturbanceConfig.model_validate({"profile": "relistic"})
