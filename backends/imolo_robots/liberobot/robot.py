"""Liberobot, as the entry point offers it."""

from pathlib import Path

from imolo.config.experiment import ExperimentConfig
from imolo.config.simulation import SimulationConfig
from imolo.contracts.robot import Published, Robot
from imolo.method.motion import PhasedMotion
from imolo_backends.actuators.pneumatics import PneumaticDisturbance
from imolo_robots.liberobot.air import LiberobotAir
from imolo_robots.liberobot.body import LiberobotOptions, liberobot


class LiberobotSimulation(SimulationConfig):
    """What surrounds Liberobot."""

    actuators: LiberobotAir = LiberobotAir()
    disturbance: PneumaticDisturbance = PneumaticDisturbance()


class LiberobotExperiment(ExperimentConfig):
    """An experiment with Liberobot."""

    robot: LiberobotOptions
    motion: PhasedMotion
    simulation: LiberobotSimulation


PAPER = Published(
    method="paper",
    successes="16/20",
    rate=0.8,
    interval="58-92",
    hand_error="13±9",
    ball_errors={"0.25": "46±34", "0.50": "156±32", "0.75": "338±36"},
    source="Liberobot itself, Sec. VII-C of the paper",
)

ROBOT = Robot(
    "the paper's pneumatic humanoid: jumps off its box and hits a ball",
    config=LiberobotExperiment,
    defaults=Path(__file__).with_name("liberobot.yaml"),
    body=liberobot,
    published=(PAPER,),
    ingredients={"sole shape": [{"robot": {"sole": "flat"}}]},
)
