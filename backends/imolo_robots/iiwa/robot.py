"""The iiwa as the entry point offers it: a model that nobody here made, motors from its data sheet.

The URDF, its meshes and inertias are those of `pybullet_data`, which comes with PyBullet's wheel; they are read where
they lie, as they are. Joint order: lbr_iiwa_joint_1 to 7, from the base.
"""

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from imolo.config.experiment import RobotConfig
from imolo.contracts.robot import Body, Effector, Marker, Robot
from imolo.errors import BackendError
from imolo_backends.actuators.motors import MotorExperiment

FLANGE = "lbr_iiwa_link_7"
FACE_HEIGHT = 0.045  # [m] of the flange above the frame of link 7, from its mesh
FACE_DIAMETER = 0.104  # [m] of the flange, from its mesh
EDGE = 0.045  # [m] of two markers from the middle of the flange, assumed

# Ready: leaning forward, the flange towards the thrower; also the rest of the motors in iiwa.yaml.
READY = (0.0, 0.5, 0.0, 0.0, 0.0, 0.7, 0.0)  # [rad] assumed


def model() -> Path:
    """Return the URDF in PyBullet's wheel.

    Raises:
        BackendError: PyBullet is not installed.
    """
    found = find_spec("pybullet_data")
    if found is None or found.origin is None:
        raise BackendError('the iiwa\'s model comes with PyBullet: pip install "pybullet>=3.2.7"')
    return Path(found.origin).with_name("kuka_iiwa") / "model.urdf"


@cache
def iiwa(options: RobotConfig) -> Body:
    """Return the body of the arm, bolted to the floor."""
    return Body(
        name=options.name,
        urdf=model(),
        markers=(
            Marker(0, "flange", FLANGE, (0.0, 0.0, FACE_HEIGHT)),
            Marker(1, "flange_x", FLANGE, (EDGE, 0.0, FACE_HEIGHT)),
            Marker(2, "flange_y", FLANGE, (0.0, EDGE, FACE_HEIGHT)),
            Marker(3, "elbow", "lbr_iiwa_link_4"),
            Marker(4, "base", "lbr_iiwa_link_0"),
        ),
        effectors=(Effector("flange", FLANGE, FACE_DIAMETER, normal=(0.0, 0.0, 1.0)),),
        ready=READY,
        fixed_base=True,
    )


ROBOT = Robot(
    "KUKA LBR iiwa 7 R800, seven motors: catches a ball with its flange",
    config=MotorExperiment,
    defaults=Path(__file__).with_name("iiwa.yaml"),
    body=iiwa,
)
