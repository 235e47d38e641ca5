"""What the checks of imolo_backends/actuators/checks.py do not measure of air, valves and cylinders."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from liberobot import BODY
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from pydantic import ValidationError

from imolo.errors import ConfigError
from imolo_backends.actuators.pneumatics import (
    AirDisturbance,
    Cylinder,
    Pneumatics,
    PneumaticsConfig,
    tube_conductance,
)
from imolo_backends.actuators.pneumatics_kernel import mass_flow
from imolo_robots.liberobot.air import VALVES_OF_JOINTS, LiberobotAir

Array = NDArray[np.float64]

H = 1e-4  # [s]
ATMOSPHERE = 101_325.0  # [Pa]
R_T = 287.05 * 293.15  # [J/kg] of air at 20 °C
DENSITY = 1.185  # [kg/m³] reference air of ISO 6358
JOINT_LIMITS = BODY.joint_limits
READY = np.array(BODY.ready)
MIDDLE = JOINT_LIMITS.mean(axis=1)
# Fig. 6a: of the chambers that drive the joints up, then of those that drive them down.
VALVE_OF_CHAMBER = np.array(VALVES_OF_JOINTS).T.ravel() - 1
LEG_SWEEP = math.pi / 4 * 0.040**2 * 0.026 * 2.0  # [m³/rad] Sec. V-A: 40 mm bore, 26 mm arm, reduction 2
ARM_SWEEP = math.pi / 4 * 0.025**2 * 0.026  # [m³/rad] Sec. V-A: 25 mm bore, 26 mm arm
SWEEP = np.array([LEG_SWEEP] * 6 + [ARM_SWEEP] * 2)
STILL = np.zeros(8)
ROUNDING = 1e-12  # relative, of some thousand operations in double precision
CLOSED_TUBE = {"tube_diameter": 1e-9}


def plant(
    timestep: float = H, angle: Array = MIDDLE, changes: AirDisturbance | None = None, **values: Any
) -> Pneumatics:
    return Pneumatics(LiberobotAir(**values), timestep, JOINT_LIMITS, angle, changes)


def run(air: Pneumatics, steps: int, angle: Array = MIDDLE) -> None:
    for _ in range(steps):
        air.step(angle, STILL)


def volumes(config: LiberobotAir, angle: Array) -> tuple[Array, Array]:
    """Return chamber volumes, shape (2, 8), and volumes behind the valves, shape (8,) [m³]."""
    half_tube = math.pi / 4 * config.tube_diameter**2 * config.tube_length / 2
    stroke = np.array([angle - JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1] - angle])
    tubes = np.array([sum(valve == VALVE_OF_CHAMBER) for valve in range(8)])
    return config.dead_volume + half_tube + SWEEP * stroke, config.manifold_volume + half_tube * tubes


# Flow through an orifice, ISO 6358.


@pytest.mark.parametrize(
    # sqrt(1 - x²) with x = (ratio - 0.3) / 0.7, by hand.
    ("ratio", "share"),
    [(0.0, 1.0), (0.3, 1.0), (0.65, math.sqrt(0.75)), (0.72, 0.8), (0.86, 0.6), (0.972, 0.28), (1.0, 0.0)],
)
def test_flow_follows_the_ellipse_of_iso_6358(ratio: float, share: float) -> None:
    conductance, up = 2e-8, 7e5
    flow = mass_flow(conductance, up, ratio * up, 0.3, 0.995)
    assert_allclose(flow, conductance * up * share, rtol=ROUNDING, atol=0.0)


@given(st.floats(1e3, 2e6), st.floats(0.0, 0.3))
def test_choked_flow_does_not_feel_the_pressure_behind(up: float, ratio: float) -> None:
    assert mass_flow(1e-8, up, ratio * up, 0.3, 0.995) == pytest.approx(1e-8 * up, rel=1e-15)


@given(st.floats(1e3, 2e6), st.floats(1e3, 2e6))
def test_flow_backwards_is_the_flow_forwards_with_the_other_sign(one: float, other: float) -> None:
    assert mass_flow(1e-8, one, other, 0.3, 0.995) == -mass_flow(1e-8, other, one, 0.3, 0.995)


@given(st.floats(1e3, 2e6), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_flow_never_grows_with_the_pressure_behind(up: float, one: float, other: float) -> None:
    low, high = sorted((one, other))
    more, less = (mass_flow(1e-8, up, ratio * up, 0.3, 0.995) for ratio in (low, high))
    assert less <= more * (1.0 + ROUNDING)


def test_flow_is_linear_above_the_laminar_ratio() -> None:
    at, halfway = (mass_flow(1e-8, 5e5, ratio * 5e5, 0.3, 0.995) for ratio in (0.995, 0.9975))
    # The ratio is rounded to 1e-16 and its distance to one is 0.0025.
    assert halfway == pytest.approx(at / 2, rel=1e-13)


def test_tube_conductance_is_that_of_the_formula_in_iso_6358_3() -> None:
    # C = 0.029 d² / sqrt(L / d^1.25 + 510) of the robot's 4 mm tubes, half a metre long; three digits were worked out.
    assert tube_conductance(0.004, 0.5) == pytest.approx(1.46e-8, abs=0.005e-8)


# Emptying, rest and time.


@pytest.mark.parametrize("timestep", [H, 5 * H])
def test_rest_is_an_equilibrium(timestep: float) -> None:
    air = plant(timestep, READY)
    before = air.measured(), air.chamber_pressure, air.tank_pressure
    run(air, 1000, READY)
    after = air.measured(), air.chamber_pressure, air.tank_pressure
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize(("dead_time", "timestep"), [(0.0, H), (0.010, H), (0.010, 5 * H), (0.0203, H)])
def test_nothing_moves_before_the_dead_time_and_everything_after(dead_time: float, timestep: float) -> None:
    air = plant(timestep, valve_dead_time=dead_time)
    rest = air.measured()
    air.target[:] = 0.6e6
    run(air, int(dead_time / timestep + 1e-9))
    assert np.array_equal(air.measured(), rest)
    run(air, 1)
    assert (air.measured() > rest).all()


def test_each_valve_has_its_own_dead_time() -> None:
    extra = np.arange(8) * 5 * H
    air = plant(valve_dead_time=0.010, changes=AirDisturbance(extra, 0.0))
    rest = air.measured()
    air.target[:] = 0.6e6
    first = np.full(8, -1)
    for step in range(200):
        run(air, 1)
        first[(first < 0) & (air.measured() > rest)] = step
    assert first.tolist() == [round((0.010 + time) / H) for time in extra]


def test_dead_time_is_never_negative() -> None:
    air = plant(valve_dead_time=0.001, changes=AirDisturbance(np.full(8, -0.005), 0.0))
    rest = air.measured()
    air.target[:] = 0.6e6
    run(air, 1)
    assert (air.measured() > rest).all()


def test_vented_valves_go_down_to_the_air_and_not_below() -> None:
    """Opening and flow both fall with the error e, so de/dt = -K e² and e < 1 / (K t)."""
    air = plant()
    air.target[:7] = 0.4e6
    run(air, 2000)
    air.target[:] = 0.0
    steps = 20_000
    run(air, steps)
    config = LiberobotAir()
    chamber, manifold = volumes(config, MIDDLE)
    x = (config.laminar_ratio - 0.3) / 0.7
    laminar = config.exhaust_conductance * DENSITY * math.sqrt(1 - x**2) / (1 - config.laminar_ratio)  # [kg/(s·Pa)]
    for valve in range(8):
        volume = chamber.ravel()[valve == VALVE_OF_CHAMBER].sum() + manifold[valve]
        K = R_T * laminar / (config.full_opening_error * volume)
        # Twice the time that the linear part takes alone: the first second gets it there.
        assert 0.0 <= air.measured()[valve] < 2.0 / (K * steps * H)


def test_supply_pressure_of_a_trial_is_that_of_its_tanks() -> None:
    air = plant(changes=AirDisturbance(np.zeros(8), -0.02e6), supply_pressure=0.9e6)
    assert air.tank_pressure == pytest.approx(0.88e6, rel=ROUNDING)


@pytest.mark.parametrize("joint_moves", [0.5, -0.5])
def test_air_is_adiabatic_where_it_enters_and_isothermal_where_it_leaves(joint_moves: float) -> None:
    """Behind a shut valve, p V falls by R T m where m leaves and rises by 1.4 R T m where it enters."""
    shut = {"full_opening_error": 1e15, "rest_pressure": (0.2e6,) * 8}
    config, air = LiberobotAir(**shut), plant(**shut)
    angle = MIDDLE.copy()
    angle[0] += joint_moves  # the right hip squeezes the chamber of valve 1, or widens it
    chamber, manifold = volumes(config, angle)
    air.step(angle, STILL)
    in_chamber, behind_valve = air.chamber_pressure[1, 0], air.measured()[0]
    run(air, 5, angle)
    gained = (air.chamber_pressure[1, 0] - in_chamber) * chamber[1, 0]
    lost = -(air.measured()[0] - behind_valve) * manifold[0]
    assert gained * joint_moves < 0.0
    ratio = gained / lost if gained > 0.0 else lost / gained
    # The changes are a hundredth of the pressures.
    assert ratio == pytest.approx(1.4, rel=1e-9)


# Pistons.


def test_moving_joint_is_followed_between_the_steps() -> None:
    """Substeps see the angle move with the velocity, as far as the start of the last one."""
    config = LiberobotAir(**CLOSED_TUBE, rest_pressure=(0.2e6,) * 8)
    air = plant(5 * H, **CLOSED_TUBE, rest_pressure=config.rest_pressure)
    start, _ = volumes(config, MIDDLE)
    end, _ = volumes(config, MIDDLE + 4 * H * 10.0)
    air.step(MIDDLE, np.full(8, 10.0))
    expected = (0.2e6 + ATMOSPHERE) * (start / end) ** 1.2 - ATMOSPHERE
    assert_allclose(air.chamber_pressure, expected, rtol=1e-10)


@pytest.mark.parametrize(
    # A r N Δp with Sec. V-A: 4π cm² · 26 mm · 2 · 0.6 MPa = 39.2 N·m, 4.91 cm² · 26 mm · 0.3 MPa = 3.83 N·m.
    ("joint", "valve", "pressure", "torque"),
    [(1, 1, 0.6e6, -39.2), (4, 4, 0.6e6, -39.2), (6, 6, 0.3e6, 3.83), (7, 6, 0.3e6, 3.83)],
)
def test_torque_is_pressure_times_area_times_moment_arm(joint: int, valve: int, pressure: float, torque: float) -> None:
    rest = np.zeros(8)
    rest[valve] = pressure
    air = plant(rest_pressure=tuple(rest.tolist()))
    air.step(MIDDLE, STILL)
    assert air.joint_torque[joint] == pytest.approx(torque, abs=0.05 if abs(torque) > 10 else 0.005)


def test_valve_8_bends_the_legs_and_lowers_the_arms() -> None:
    air = plant(rest_pressure=(0.0,) * 7 + (0.5e6,))
    air.step(MIDDLE, STILL)
    assert (air.joint_torque[:6] > 0.0).all()
    assert (air.joint_torque[6:] < 0.0).all()


@given(st.lists(st.floats(-30.0, 30.0), min_size=8, max_size=8))
def test_friction_takes_energy_from_every_joint(speed: list[float]) -> None:
    velocity = np.array(speed)
    config = LiberobotAir(rest_pressure=(0.0,) * 8)
    air = plant(rest_pressure=config.rest_pressure)
    air.step(MIDDLE, velocity)
    dry = np.array([config.leg_coulomb_friction] * 6 + [config.arm_coulomb_friction] * 2)
    viscous = np.array([config.leg_viscous_friction] * 6 + [config.arm_viscous_friction] * 2)
    expected = -dry * np.tanh(velocity / config.friction_smoothing) - viscous * velocity
    # One substep at zero displacement: both chambers of each joint still hold the same pressure.
    assert_allclose(air.joint_torque, expected, rtol=1e-12, atol=1e-12)
    assert (air.joint_torque * velocity <= 0.0).all()


# The steps themselves.


def test_long_step_is_made_of_short_ones() -> None:
    long, short = plant(5 * H), plant(H)
    for air in (long, short):
        air.target[:] = 0.3e6
    run(long, 100)
    run(short, 500)
    assert_allclose(long.chamber_pressure, short.chamber_pressure, rtol=ROUNDING)
    assert_allclose(long.joint_torque, short.joint_torque, rtol=ROUNDING, atol=1e-9)


def test_half_the_substep_halves_the_error() -> None:
    lag = 0.015  # [s] of the valve: the shortest time in this plant, with narrow valves

    def pressures(halvings: int) -> Array:
        narrow = {"supply_conductance": 8e-9, "exhaust_conductance": 3e-8, "full_opening_error": 3e4}
        air = plant(H, max_substep=H / 2**halvings, valve_time_constant=lag, valve_dead_time=0.01, **narrow)
        air.target[:] = (0.6e6, 0.4e6, 0.1e6, 0.6e6, 0.4e6, 0.1e6, 0.0, 0.05e6)
        run(air, 400)
        return air.chamber_pressure[1, :6]

    coarse, middle, fine = (pressures(halvings) for halvings in (2, 3, 4))
    ratio = np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine)
    # First order: 2 + O(h / tau), with h a quarter of H and tau the lag of the valve; second order would be 4.
    assert abs(ratio - 2.0) < 0.25 * H / lag


# Valve maps from a config.

LIMITS = np.array([[-1.0, 1.0], [-2.0, 2.0]])  # [rad]


def two_cylinders(*valves: tuple[int, int], pressures: int = 4, **values: Any) -> PneumaticsConfig:
    cylinders = [Cylinder(bore=0.02, lever=0.03, up=up, down=down) for up, down in valves]
    tanks = {"supply_pressure": 0.6e6, "tank_volume": 2e-3, "supply_conductance": 1e-8, "exhaust_conductance": 3e-8}
    content = {**tanks, "rest_pressure": (0.1e6,) * pressures, "cylinders": cylinders, **values}
    return PneumaticsConfig.model_validate(content)


def test_torque_of_a_cylinder_is_that_of_its_own_valves() -> None:
    config = two_cylinders((1, 2), (4, 3), rest_pressure=(0.3e6, 0.0, 0.0, 0.2e6))
    air = Pneumatics(config, H, LIMITS, np.zeros(2))
    lever = math.pi / 4 * 0.02**2 * 0.03  # [m³] area times lever
    for velocity in (0.0, 1.0, -3.0):  # a cylinder has no friction that nobody gives it
        air.step(np.zeros(2), np.full(2, velocity))
        assert_allclose(air.joint_torque, [0.3e6 * lever, 0.2e6 * lever], rtol=1e-9)
    assert_allclose(air.measured(), config.rest_pressure, rtol=1e-9)


def test_channels_are_named_after_the_valves() -> None:
    config = two_cylinders((1, 2), (2, 1), pressures=2, valve_names=("lifts", "lowers"))
    assert [(c.name, c.unit, c.low, c.high, c.rest) for c in config.channels] == [
        ("valve 1: lifts", "Pa", 0.0, 0.6e6, 0.1e6),
        ("valve 2: lowers", "Pa", 0.0, 0.6e6, 0.1e6),
    ]


@pytest.mark.parametrize(
    ("valves", "values", "named"),
    [
        (((1, 2), (4, 5)), {}, "a cylinder names valve 5, but rest_pressure has 4 valves; give it a pressure"),
        (((1, 2), (4, 1)), {}, "valve 3 feeds no chamber; name it in `up` or `down` of a cylinder, or leave it out"),
        (((1, 2), (3, 4)), {"valve_names": ("one",)}, "valve_names has 1 names, rest_pressure 4 valves"),
        (((1, 2), (3, 4)), {"rest_pressure": (0.0, 0.0, 0.0, 0.7e6)}, "rest_pressure 700000 Pa is above supply"),
        (((1, 0), (3, 4)), {}, "greater than or equal to 1"),
    ],
)
def test_valve_map_that_cannot_be_is_refused(
    valves: tuple[tuple[int, int], ...], values: dict[str, Any], named: str
) -> None:
    with pytest.raises(ValidationError, match=named):
        two_cylinders(*valves, **values)


@pytest.mark.parametrize(
    ("limits", "named"),
    [
        (LIMITS[:1], "there are 2 cylinders for 1 joints; give one for each"),
        (np.array([[-np.inf, np.inf], [0.0, 1.0]]), "a joint without limits has no cylinder that fits"),
    ],
)
def test_cylinders_that_do_not_fit_the_joints_are_refused(limits: Array, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        Pneumatics(two_cylinders((1, 2), (3, 4)), H, limits, np.zeros(len(limits)))
