"""The robot's body, as the entry point offers it; all numbers of an experiment are in the YAML beside it."""

from functools import cache
from pathlib import Path

from imolo.config.experiment import RobotConfig
from imolo.contracts.robot import Body, Effector, Marker, Robot
from imolo_backends.actuators.motors import MotorExperiment

FOLDER = Path(__file__).parent


@cache
def paddle(options: RobotConfig) -> Body:
    """Return the body: what the cameras see of it, and what is to meet the ball."""
    return Body(
        name=options.name,
        urdf=FOLDER / "paddle.urdf",
        markers=(Marker(0, "shoulder", "arm"), Marker(1, "plate", "arm", (0.0, 0.0, -0.6))),
        effectors=(Effector("plate", "arm", width=0.3),),
        base=((0.0, 0.0, 1.2), (1.0, 0.0, 0.0, 0.0)),  # [m], and a quaternion w, x, y, z
        fixed_base=True,
    )


ROBOT = Robot(
    "one motor swings a plate up: hits a ball",
    config=MotorExperiment,
    defaults=FOLDER / "paddle.yaml",
    body=paddle,
)
