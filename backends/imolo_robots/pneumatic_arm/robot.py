"""The pneumatic arm, as the entry point offers it; its valve map and its air are in pneumatic_arm.yaml."""

from functools import cache
from pathlib import Path

from imolo.config.experiment import RobotConfig
from imolo.contracts.robot import Body, Effector, Marker, Robot
from imolo_backends.actuators.pneumatics import PneumaticExperiment

FOLDER = Path(__file__).parent
HEIGHT = 1.1  # [m] of the axes above the floor, assumed
RACKET = (0.0, 0.0, -0.50)  # [m] its middle in the arm frame
RACKET_SIDE = 0.18  # [m]
ARM_LENGTH = 0.59  # [m] axis to the end of the racket


@cache
def pneumatic_arm(options: RobotConfig) -> Body:
    """Return the body of the arm, which hangs down from its stand."""
    return Body(
        name=options.name,
        urdf=FOLDER / "pneumatic_arm.urdf",
        markers=(Marker(0, "shoulder", "arm"), Marker(1, "racket", "arm", RACKET), Marker(2, "stand", "stand")),
        effectors=(Effector("racket", "arm", RACKET_SIDE, "shoulder", ARM_LENGTH),),
        base=((0.0, 0.0, HEIGHT), (1.0, 0.0, 0.0, 0.0)),
        fixed_base=True,
    )


ROBOT = Robot(
    "a pneumatic arm on a stand, two joints and four valves: hits a ball",
    config=PneumaticExperiment,
    defaults=FOLDER / "pneumatic_arm.yaml",
    body=pneumatic_arm,
)
