"""The plant gives its closed forms, whatever its parameters, and the checks of it see what is wrong."""

from typing import Any

import numpy as np
import pytest
from liberobot import BODY
from numpy.typing import NDArray

from imolo.conformance import Verdict, run_check
from imolo_backends.actuators.checks import SCENES, SUBSTEP, PneumaticDrive, pneumatic_checks
from imolo_backends.actuators.pneumatics import AirConfig, Pneumatics
from imolo_robots.liberobot.air import LiberobotAir

OTHER = {
    **{"supply_pressure": 0.6e6, "tube_length": 1.2, "exhaust_conductance": 2e-8, "heat_in": 1.3, "leg_bore": 0.032},
    **{"temperature": 283.15, "rest_pressure": tuple(1e5 + 1e4 * valve for valve in range(8))},
}


def drive(wrong: dict[str, Any] | None = None, **values: Any) -> PneumaticDrive:
    """Return Liberobot's drive with some parameters, and a plant that has others of them."""

    def make(config: AirConfig, angle: NDArray[np.float64]) -> Pneumatics:
        return Pneumatics(config.model_copy(update=wrong or {}), SUBSTEP, BODY.joint_limits, angle)

    return PneumaticDrive(LiberobotAir(**values), BODY.joint_limits, make)


def failed(name: str, checked: PneumaticDrive) -> list[str]:
    (check,) = (check for check in pneumatic_checks(checked) if check.name == name)
    outcomes = run_check(check, ())
    return [str(o.measurement or o.remark) for o in outcomes if o.verdict is not Verdict.PASS]


@pytest.mark.parametrize("values", [{}, OTHER], ids=["liberobot", "other"])
@pytest.mark.parametrize("name", [scene.__name__ for scene in SCENES])
def test_the_plant_gives_the_closed_form(name: str, values: dict[str, Any]) -> None:
    assert failed(name, drive(**values)) == []


@pytest.mark.parametrize(
    ("parameter", "name", "seen"),
    [
        ("leg_bore", "sealed_piston", ["isothermal", "polytropic", "adiabatic"]),
        ("supply_conductance", "choked_filling", ["pressure'", "pressure at a third"]),
        ("exhaust_conductance", "emptying", ["absolute pressure while choked", "order", "decay constant of valve"]),
        ("full_opening_error", "emptying", ["decay constant of valve"]),
        ("valve_time_constant", "valve_step", ["opening after 1 tau", "opening after 3 tau", "lag"]),
        ("valve_dead_time", "valve_step", ["dead time"]),
        ("dead_volume", "tank_balance", ["air from the tanks in the robot"]),
        ("tank_volume", "tank_balance", ["air from the tanks in the robot"]),
        ("dead_volume", "closed_valves", ["air in the robot"]),
    ],
)
def test_a_parameter_that_is_a_hundredth_off_is_seen_by_all_that_depends_on_it(
    parameter: str, name: str, seen: list[str]
) -> None:
    slow = {"valve_dead_time": 0.01}  # of the default one, a hundredth is less than a step
    wrong = {parameter: 1.01 * getattr(LiberobotAir(**slow), parameter)}
    told = failed(name, drive(wrong, **slow))
    assert all(any(f"quantity='{quantity}" in one for one in told) for quantity in seen)


class Leaking(Pneumatics):
    """Its tanks lose a billionth of their air at every step."""

    def step(self, joint_angle: NDArray[np.float64], joint_velocity: NDArray[np.float64]) -> None:
        super().step(joint_angle, joint_velocity)
        self._state[self._tank] *= 1.0 - 1e-9


def test_a_tank_that_leaks_while_it_is_shut_off_is_seen() -> None:
    limits = BODY.joint_limits
    checked = PneumaticDrive(LiberobotAir(), limits, lambda config, angle: Leaking(config, SUBSTEP, limits, angle))
    assert any("while venting" in measurement for measurement in failed("tank_balance", checked))
