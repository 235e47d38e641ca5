"""Masses and centres of mass as settings, for any robot."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of, config_for, validated_config
from imolo.errors import ConfigError
from imolo.identification.parameters import apply, patch, read_setting
from imolo.trials.rollout import roll_out

TRUNK: dict[str, Any] = {"trunk": {"mass": 4.2, "center_of_mass": [0.01, 0.0, 0.2]}}


def changed(links: dict[str, Any], robot: str = "liberobot") -> ExperimentConfig:
    return config_for("mujoco", robot={"name": robot, "links": links})


def test_only_what_is_given_of_a_link_differs_and_inertia_grows_with_its_mass() -> None:
    before, after = body_of(changed({}).robot).model, body_of(changed(TRUNK).robot).model
    for name, link in after.links.items():
        was = before.links[name]
        factor, com = (4.2 / was.mass, np.array([0.01, 0.0, 0.2])) if name == "trunk" else (1.0, was.com)
        assert link.mass == factor * was.mass
        assert np.array_equal(link.com, com)
        np.testing.assert_allclose(link.inertia, factor * was.inertia, rtol=1e-15)
    half = body_of(changed({"trunk": {"mass": 4.2}}).robot).model.links["trunk"]
    assert np.array_equal(half.com, before.links["trunk"].com)


def test_robot_keeps_its_own_model_and_config_its_content_unless_a_link_differs() -> None:
    plain = changed({})
    assert body_of(plain.robot).urdf.name == "liberobot.urdf"
    assert "links" not in plain.model_dump(mode="json")["robot"]
    again = validated_config(changed(TRUNK).model_dump(mode="json"), "a copy")
    assert again.digest() == changed(TRUNK).digest() != plain.digest()
    assert body_of(again.robot) is body_of(changed(TRUNK).robot)


def test_options_of_the_robot_hold_for_a_changed_link(tmp_path: Path) -> None:
    flat = config_for("mujoco", robot={"sole": "flat", "links": TRUNK})
    links = body_of(flat.robot).model.links
    assert links["trunk"].mass == 4.2
    assert [shape.kind for shape in links["right_foot"].collisions] == ["box"]


def test_meshes_are_found_from_the_copy() -> None:
    body = body_of(changed({"lbr_iiwa_link_7": {"mass": 0.5}}, "iiwa").robot)
    assert body.model.links["lbr_iiwa_link_7"].mass == 0.5
    assert any(shape.kind == "mesh" for link in body.model.links.values() for shape in link.collisions)


@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "dart"])
def test_engine_moves_the_changed_robot(engine: str) -> None:
    settings: dict[str, Any] = {"simulation": {"timestep": 4e-4, "disturbance": {"profile": "none"}}}
    height = {}
    for mass in (3.5, 7.0):
        config = config_for(engine, robot={"links": {"trunk": {"mass": mass}}}, **settings)
        commands = config.motion.commands((0.0, 0.3), 100_000)
        height[mass] = roll_out(config, commands, 0.6).markers[2][:, 2].max()
    assert height[3.5] > height[7.0] + 0.05  # [m] of an ankle: a heavier robot jumps less high


@pytest.mark.parametrize(
    ("links", "words"),
    [
        ({"trunc": {"mass": 3.0}}, "no link 'trunc' with a mass; did you mean 'trunk'"),
        ({"trunk": {"mass": 0.0}}, "robot.links.trunk.mass"),
        ({"trunk": {"com": [0, 0, 0]}}, "robot.links.trunk.com"),
    ],
)
def test_bad_link_is_refused_in_one_line(links: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as error:
        body_of(changed(links).robot)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_link_is_a_parameter_from_the_value_of_the_model_on() -> None:
    plain = changed({})
    assert read_setting(plain, "robot.links.trunk.mass") == 3.5
    assert read_setting(plain, "robot.links.trunk.center_of_mass.2") == 0.2254
    settings = {"robot.links.trunk.mass": 4.0, "robot.links.trunk.center_of_mass.2": 0.2}
    assert body_of(apply(plain, settings).robot).model.links["trunk"].mass == 4.0
    assert patch(settings, plain) == {
        "robot": {"links": {"trunk": {"mass": 4.0, "center_of_mass": [-0.02411, 0.0, 0.2]}}}
    }
    assert apply(plain, {"simulation.timestep": 2e-4}).robot == plain.robot
    with pytest.raises(ConfigError, match="did you mean 'trunk'"):
        read_setting(plain, "robot.links.trunc.mass")
