"""Paths to settings, and the scale on which a search sees them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_tosses import cube_config

from imolo.errors import ConfigError
from imolo.identification.parameters import Parameter, ParameterConfig, apply, declared, patch, read_setting, resolve

FRICTION = "simulation.contact.friction"


def test_a_path_leads_to_settings_entries_of_lists_and_options_of_the_engine() -> None:
    config = cube_config(friction=0.3)
    assert read_setting(config, FRICTION) == 0.3
    assert read_setting(config, "backend.impratio") == 10.0
    assert read_setting(config, "backend.solref.1") == 1.0


def test_settings_change_what_they_name_and_nothing_else() -> None:
    config = cube_config()
    changed = apply(config, {"backend.solref.1": 0.5, FRICTION: 0.7})
    assert read_setting(changed, "backend.solref.1") == 0.5
    assert read_setting(changed, "backend.solref.0") == read_setting(config, "backend.solref.0")
    assert apply(changed, {"backend.solref.1": 1.0, FRICTION: read_setting(config, FRICTION)}) == apply(config, {})


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("simulation.contact.frictoin", "no 'frictoin' in simulation.contact; did you mean 'friction'"),
        ("simulaton.contact", "no 'simulaton' in the config; did you mean 'simulation'"),
        ("backend.solref.2", "no '2' in backend.solref; known: 0, 1"),
        ("backend.cone", "is 'elliptic', no number"),
        ("simulation.contact", "no number"),
        ("", "no '' in the config"),
    ],
)
def test_a_path_that_leads_to_no_number_is_named(path: str, message: str) -> None:
    with pytest.raises(ConfigError) as raised:
        read_setting(cube_config(), path)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        (ParameterConfig(), "has no range; give one, such as range: [0.125, 0.5]"),
        (ParameterConfig(range=(0.5, 1.0)), "starts at 0.25, outside its range 0.5 to 1"),
        (ParameterConfig(range=(0.0, 1.0), scale="log"), "log scale from 0 on; give a positive lower bound"),
        (ParameterConfig(range=(-1.0, 1.0)), "greater than or equal to 0"),
    ],
)
def test_a_parameter_that_cannot_be_searched_is_refused(said: ParameterConfig, message: str) -> None:
    with pytest.raises(ConfigError) as raised:
        resolve(cube_config(), FRICTION, said, {})
    assert message in str(raised.value)


def test_a_range_upside_down_is_refused() -> None:
    with pytest.raises(ValueError, match="give the lower bound first"):
        ParameterConfig(range=(1.0, 0.5))


def test_an_option_brings_its_own_range() -> None:
    config = cube_config()
    options = declared(config)
    assert {"backend.impratio", "backend.solref.0", "backend.solref.1"} <= set(options)
    found = resolve(config, "backend.impratio", ParameterConfig(), options)
    assert (found.low, found.high, found.scale) == (0.1, 1000.0, "log")


@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "dart", "ode"])
def test_every_declared_range_holds_the_default_and_is_accepted(engine: str) -> None:
    pytest.importorskip({"dart": "dartpy"}.get(engine, engine))
    config = cube_config(engine)
    for path in (options := declared(config)):
        parameter = resolve(config, path, ParameterConfig(), options)
        assert parameter.low < parameter.start < parameter.high or parameter.start in (parameter.low, parameter.high)


parameters = st.builds(
    lambda low, width, scale: Parameter("p", low, low * width, scale, low),
    st.floats(1e-6, 1e3),
    st.floats(1.1, 1e6),
    st.sampled_from(["linear", "log"]),
)


@given(parameters, st.floats(0.0, 1.0))
def test_a_place_between_the_bounds_survives_the_way_there_and_back(parameter: Parameter, unit: float) -> None:
    value = parameter.from_unit(unit)
    assert parameter.low <= value <= parameter.high
    assert parameter.to_unit(value) == pytest.approx(unit, abs=1e-9)


@given(parameters, st.floats(-5.0, 5.0))
def test_a_place_beyond_the_bounds_is_cut_off_at_them(parameter: Parameter, unit: float) -> None:
    assert parameter.low <= parameter.from_unit(unit) <= parameter.high


def test_a_prior_costs_half_a_squared_standard_deviation() -> None:
    linear = Parameter("p", 0.0, 2.0, "linear", 1.0, (1.0, 0.1))
    relative = Parameter("p", 0.1, 10.0, "log", 1.0, (1.0, 0.1))
    assert linear.surprise(1.2) == pytest.approx(2.0)
    assert relative.surprise(math.exp(0.2)) == pytest.approx(2.0)


def test_a_patch_sets_what_was_fitted() -> None:
    config = cube_config()
    assert patch({FRICTION: 0.2, "backend.solref.1": 0.5}, config) == {
        "simulation": {"contact": {"friction": 0.2}},
        "backend": {"solref": [0.0005, 0.5]},
    }
