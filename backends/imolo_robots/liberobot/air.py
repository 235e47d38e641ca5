"""Liberobot's pneumatics (Secs. V-A, V-B, Fig. 6a).

*Assumed* numbers were chosen together, so that the motion looks like the paper's: k moves the hand sideways, t_w
forward and up.
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
    tube_length: Positive = Field(0.5, description="valve to chamber [m], assumed: half the robot's height")
    supply_conductance: Positive = Field(
        0.8e-8, description="sonic conductance of a valve from tank to tube [m³/(s·Pa)], assumed: lift-off at 0.23 s"
    )
    exhaust_conductance: Positive = Field(
        3.0e-8,
        description="sonic conductance of a valve to the air [m³/(s·Pa)], assumed: arm at 60-130° at t_w + 0.17 s",
    )
    valve_time_constant: Positive = Field(
        0.015, description="first-order lag of the opening [s], assumed: see conductances"
    )
    valve_dead_time: NonNegative = Field(0.010, description="delay of the command [s], assumed: see conductances")
    leg_coulomb_friction: Annotated[NonNegative, Searched(0.1, 4)] = Field(1.2, description="[N·m], assumed")
    leg_viscous_friction: Annotated[NonNegative, Searched(0.01, 0.5)] = Field(0.10, description="[N·m·s], assumed")
    arm_coulomb_friction: Annotated[NonNegative, Searched(0.01, 0.6)] = Field(0.12, description="[N·m], assumed")
    arm_viscous_friction: Annotated[NonNegative, Searched(0.001, 0.06)] = Field(0.01, description="[N·m·s], assumed")
    rest_pressure: EightPressures = Field(
        (0.0,) * 7 + (0.05e6,), description="valves 1..8 before the onset [Pa], assumed: valve 8 holds the crouch"
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
