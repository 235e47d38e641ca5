"""The experiment of the paper, which most tests are about: Liberobot with the defaults of its own folder."""

from dataclasses import replace

from imolo.config.loading import body_of, config_for, create_task
from imolo.contracts.engine import Array, Ball, Scene
from imolo.contracts.robot import Body
from imolo.method.motion import PhasedMotion
from imolo_robots.liberobot.air import LiberobotAir

CONFIG = config_for("mujoco")
BODY = body_of(CONFIG.robot)
HAND = BODY.learning_marker
MOTION = CONFIG.motion
AIR = CONFIG.simulation.actuators
CHANNELS = AIR.channels
BALL = CONFIG.simulation.ball
THROWER = CONFIG.simulation.thrower
TRAINING_MOTIONS = CONFIG.training.motions
PAPER = CONFIG.methods["paper"]
GRID = PAPER.grid

assert isinstance(MOTION, PhasedMotion)
assert isinstance(AIR, LiberobotAir)


def foam_ball(position: tuple[float, float, float] = (5.0, 0.0, 1.1)) -> Ball:
    """Return the ball of the paper at rest somewhere [m]."""
    return replace(create_task(CONFIG).ball, position=position)


def ready_scene(joint_offset: Array | list[float] | None = None, body: Body = BODY) -> Scene:
    """Return how a trial starts, the joints off by so much [rad], shape (J,)."""
    simulation = CONFIG.simulation
    contact = simulation.contact
    return body.scene(foam_ball(), simulation.timestep, contact.friction, contact.restitution, joint_offset)
