"""The experiment of the paper, which most tests are about: Liberobot with the defaults of its own folder."""

from imolo.config.loading import body_of, config_for
from imolo.contracts.engine import Scene
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
