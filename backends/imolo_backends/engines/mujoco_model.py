"""The scene as a model of MuJoCo's: its options, its contacts and how soft contacts are made to bounce."""

from pathlib import Path
from typing import Annotated, Any, Literal

import mujoco
import numpy as np

from imolo.config.model import Positive, Searched
from imolo.contracts.engine import EngineOptions, Scene
from imolo.errors import BackendError
from imolo_backends.engines.adapter import FLOOR

BALL = "imolo_ball"
# A diverged state must be seen; the others look every step for what no scene has.
DISABLED = ("AUTORESET", "EQUALITY", "SPRING", "DAMPER", "EULERDAMP", "ACTUATION", "SENSOR", "MIDPHASE")
# Contact masks: the robot touches everything but itself, the ball touches everything.
ROBOT_MASK, FIXED_MASK, BALL_MASK = (1, 0), (0, 1), (1, 1)


class MujocoOptions(EngineOptions):
    """Options of the MuJoCo engine.

    Attributes:
        integrator: `euler` is semi-implicit; `rk4` evaluates every step four times.
        cone: `pyramidal` lets a box slide 41 % too far at 45°.
        impratio: Stiffness of friction relative to that of normal forces [-].
        solref: Time constant [s] and damping ratio [-] of the robot's contacts; MuJoCo raises the former to two
            timesteps. At its own .02 a ball at 10 m/s passes through the plate; at .002 the hand is 12 mm from where
            rigid contacts lead it.
        solref_limit: The same for joint limits. Softness here and in the contacts move the hand in opposite directions.
        ball_frequency: Natural frequency of the ball's contacts, and of the robot's where it bounces, in place of
            `solref` [rad/s]; their damping follows from the restitution.
    """

    integrator: Literal["euler", "implicitfast", "rk4"] = "euler"
    cone: Literal["elliptic", "pyramidal"] = "elliptic"
    impratio: Annotated[Positive, Searched(0.1, 1000.0)] = 10.0
    solref: tuple[Annotated[Positive, Searched(0.0005, 0.05)], Annotated[Positive, Searched(0.1, 3.0)]] = (0.0005, 1.0)
    solref_limit: tuple[Positive, Positive] = (0.0005, 1.0)
    ball_frequency: Positive = 1000.0

    @property
    def integrator_order(self) -> int:
        """See `EngineOptions.integrator_order`."""
        return 4 if self.integrator == "rk4" else 1


def build_model(scene: Scene, options: MujocoOptions, urdf: Path) -> Any:
    """Return the model of a scene with the robot of a URDF.

    Raises:
        BackendError: MuJoCo cannot load it.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(urdf))
        _set_options(spec, scene, options)
        _add_scene(spec, scene, options)
        return spec.compile()
    except ValueError as error:
        raise BackendError(f"MuJoCo cannot load {scene.urdf}: {error}") from error


def _set_options(spec: Any, scene: Scene, options: MujocoOptions) -> None:
    # Otherwise the base would become part of the world.
    spec.compiler.fusestatic = False
    spec.option.timestep = scene.timestep
    spec.option.gravity = scene.gravity
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{options.integrator.upper()}")
    spec.option.cone = getattr(mujoco.mjtCone, f"mjCONE_{options.cone.upper()}")
    spec.option.impratio = options.impratio
    for name in DISABLED:
        spec.option.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")


def _add_scene(spec: Any, scene: Scene, options: MujocoOptions) -> None:
    solref = options.solref
    if scene.robot_restitution > 0.0:
        solref = bouncing_solref(options.ball_frequency, scene.robot_restitution, scene.timestep)
    for geom in spec.geoms:
        _set_contact(geom, ROBOT_MASK, scene.friction, solref)
    for joint in spec.joints:
        joint.solref_limit = options.solref_limit
    base = spec.body(scene.link_names[0])
    base.pos, base.quat = scene.base_position, scene.base_quaternion
    if not scene.fixed_base:
        base.add_freejoint()

    world = spec.worldbody
    fixed = [world.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(50.0, 50.0, 1.0))]
    kind = mujoco.mjtGeom.mjGEOM_BOX
    fixed += [world.add_geom(name=box.name, type=kind, pos=box.center, size=box.half_extents) for box in scene.boxes]
    for geom in fixed:
        _set_contact(geom, FIXED_MASK, scene.friction, solref)
    ball = scene.ball
    # Left out, `ipos` would be a copy of `pos` (4.0.1), far from the ball.
    body = world.add_body(name=BALL, pos=ball.position, mass=ball.mass, inertia=[ball.inertia] * 3, ipos=[0.0] * 3)
    body.explicitinertial = True
    body.add_freejoint()
    geom = body.add_geom(name=BALL, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(ball.radius, 0.0, 0.0))
    _set_contact(
        geom, BALL_MASK, scene.friction, bouncing_solref(options.ball_frequency, scene.restitution, scene.timestep)
    )
    geom.priority = 1
    geom.solimp[:2] = 0.95


def _set_contact(geom: Any, mask: tuple[int, int], friction: float, solref: tuple[float, float]) -> None:
    geom.contype, geom.conaffinity = mask
    geom.condim = 3
    geom.friction = (friction, 0.0, 0.0)
    geom.solref = solref


def damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a spring-damper contact that can only push and bounces with this restitution.

    A ratio of sin(a) bounces with exp(-(pi - 2 a) tan(a)); see Schwager and Pöschel, Granular Matter 9, 465 (2007).
    Below .135, which is critical damping, the ratio stays 1.
    """
    angle = np.linspace(0.0, 0.5 * np.pi, 2001)[:-1]
    bounce = np.exp(-(np.pi - 2.0 * angle) * np.tan(angle))
    return float(np.sin(np.interp(-restitution, -bounce, angle, right=0.5 * np.pi)))


def bouncing_solref(frequency: float, restitution: float, timestep: float) -> tuple[float, float]:
    """Return the `solref` of contacts of a natural frequency [rad/s] that bounce."""
    # Ten steps per radian keep the explicit damper stable. Negative numbers are stiffness and damping per mass.
    frequency = min(frequency, 0.2 / timestep)
    return -(frequency**2), -2.0 * damping_ratio(restitution) * frequency
