"""Liberobot's pneumatics (Secs. V-A, V-B, Fig. 6a).

*Fitted* numbers, which the paper does not give, were searched together, so that the motions meet what it says of its
robot's; docs/the-papers-robot.md has their ranges.
"""

from typing import Annotated

from pydantic import Field

from imolo.config.model import NonNegative, Positive, Searched
from imolo_backends.actuators.pneumatics import AirConfig, Cylinder

VALVES = (
    "extends right hip",
    "extends right knee",
    "extends right ankle",
    "extends left hip",
    "extends left knee",
    "extends left ankle",
    "raises both arms",
    "lowers arms, bends legs",
)  # Fig. 6(a)

# Valves that feed the chambers (Fig. 6a), by joint: driving its angle up, and down. Up is bending a leg joint and
# raising an arm. Valve 8 bends all leg joints and lowers both arms.
VALVES_OF_JOINTS = ((8, 1), (8, 2), (8, 3), (8, 4), (8, 5), (8, 6), (7, 8), (7, 8))
LEG_JOINTS = 6

EightPressures = Annotated[tuple[NonNegative, ...], Field(min_length=8, max_length=8)]


class LiberobotAir(AirConfig):
    """Cylinders, tubes, valves and tanks of Liberobot."""

    supply_pressure: Positive = Field(0.9e6, description="pressure of the filled tanks [Pa], Sec. VII-B")
    tank_volume: Positive = Field(4 * 550e-6, description="four tanks, lumped [m³], Sec. V-B")
    leg_bore: Positive = Field(0.040, description="inner diameter [m], Sec. V-A")
    arm_bore: Positive = Field(0.025, description="inner diameter [m], Sec. V-A")
    moment_arm: Positive = Field(0.026, description="radius of the joint pulley [m], Sec. V-A")
    leg_reduction: Positive = Field(2.0, description="speed reduction of the leg pulleys [-], Sec. V-A")
    tube_diameter: Positive = Field(0.004, description="inner diameter of the tubes [m], Sec. V-B")
    tube_length: Positive = Field(0.413, description="valve to chamber [m], fitted")
    supply_conductance: Positive = Field(
        5.022e-08, description="sonic conductance of a valve from tank to tube [m³/(s·Pa)], fitted"
    )
    exhaust_conductance: Positive = Field(
        2.908e-07, description="sonic conductance of a valve to the air [m³/(s·Pa)], fitted"
    )
    full_opening_error: Positive = Field(11920.0, description="pressure error that opens a valve fully [Pa], fitted")
    dead_volume: Positive = Field(3.214e-06, description="of a chamber at the end of its stroke [m³], fitted")
    valve_time_constant: Positive = Field(0.004225, description="first-order lag of the opening [s], fitted")
    valve_dead_time: NonNegative = Field(0.0031, description="delay of the command [s], fitted")
    leg_coulomb_friction: Annotated[NonNegative, Searched(0.1, 4)] = Field(0.5629, description="[N·m], fitted")
    leg_viscous_friction: Annotated[NonNegative, Searched(0.01, 0.5)] = Field(0.2167, description="[N·m·s], fitted")
    arm_coulomb_friction: Annotated[NonNegative, Searched(0.01, 0.6)] = Field(0.01016, description="[N·m], fitted")
    arm_viscous_friction: Annotated[NonNegative, Searched(0.001, 0.06)] = Field(0.0286, description="[N·m·s], fitted")
    rest_pressure: EightPressures = Field(
        (0.0,) * 7 + (30790.0,), description="valves 1..8 before the onset [Pa]: valve 8 holds the crouch; fitted"
    )
    valve_names: tuple[str, ...] = Field(VALVES, description="by number, Fig. 6")

    def cylinders_of_joints(self) -> tuple[Cylinder, ...]:
        """Return the cylinders of legs and arms; the reduction lets a leg's piston travel further per joint angle."""
        leg = {
            "bore": self.leg_bore,
            "lever": self.moment_arm * self.leg_reduction,
            "coulomb_friction": self.leg_coulomb_friction,
            "viscous_friction": self.leg_viscous_friction,
        }
        arm = {
            "bore": self.arm_bore,
            "lever": self.moment_arm,
            "coulomb_friction": self.arm_coulomb_friction,
            "viscous_friction": self.arm_viscous_friction,
        }
        limbs = [leg] * LEG_JOINTS + [arm] * (len(VALVES_OF_JOINTS) - LEG_JOINTS)
        return tuple(
            Cylinder(up=up, down=down, **limb) for limb, (up, down) in zip(limbs, VALVES_OF_JOINTS, strict=True)
        )
