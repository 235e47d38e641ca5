"""How a robot differs from one trial to the next."""

from dataclasses import dataclass

import numpy as np

from imolo.config.simulation import DisturbanceConfig
from imolo.contracts.engine import Array
from imolo_backends.actuators.plant import PlantDisturbance


@dataclass(frozen=True)
class Disturbance:
    """What is different in this trial.

    Attributes:
        plant: In the air and the valves.
        joint_angle: Added to the ready pose [rad], shape (8,); never beyond a joint's limit.
    """

    plant: PlantDisturbance
    joint_angle: Array


def draw_disturbance(
    config: DisturbanceConfig, ready_angle: Array, joint_limits: Array, rng: np.random.Generator
) -> Disturbance:
    """Draw the disturbance of one trial.

    Args:
        config: Standard deviations.
        ready_angle: Joint angles of the ready pose [rad], shape (8,).
        joint_limits: Lowest and highest angle of each joint [rad], shape (8, 2).
        rng: Chance of this trial.
    """
    # The ready pose rests on the joints' stops, so a joint can only be off to the inside.
    inwards = np.where(ready_angle > joint_limits.mean(axis=1), -1.0, 1.0)
    return Disturbance(
        plant=PlantDisturbance(
            valve_dead_time=rng.normal(0.0, 1.0, 8) * config.valve_dead_time,
            supply_pressure=float(rng.normal() * config.supply_pressure),
        ),
        joint_angle=inwards * np.abs(rng.normal(0.0, 1.0, 8)) * config.joint_angle,
    )
