"""What an engine is: rigid-body dynamics of one robot, one ball and fixed boxes, and nothing else.

World frame: x forward, y left, z up, floor at z = 0. Every array of joints follows `Scene.joint_names`, every array
of links `Scene.link_names`. Quaternions are w, x, y, z. A prismatic joint has a way [m] where others have an angle
[rad], and a force [N] where others have a torque [N·m].

**The robot.** Links of a tree: `revolute`, `continuous`, `prismatic` and `fixed` joints. Its links do not collide with
each other. Shapes that occur: boxes, spheres, cylinders and meshes, which stand for their convex hull in every engine
(PyBullet keeps 1 mm around it; ODE has none and refuses them); beside the robot the ball, the floor and boxes. What a
URDF says of motors (damping, friction, effort, speed, mimic, transmission) is not the engine's: torques come from
actuators, which own it. So joints turn without resistance, at any speed and torque, up to their limits. A link without
mass must be welded to one that has some, or to a fixed base.

**Order of calls.** `__init__`; then `step` and `motion` for every step; `read` now and then, before the first step as
well; `close` at the end, once or more, and nothing after it. There is one instance for each trial, and several live in
one process.

**Divergence.** A state that is not finite must be seen: `motion` and `read` show it, or `step` or `read` raises
`DivergenceError`, as it must where the library would abort the process or replace what is not finite. Whoever runs the
engine looks at each state that it reads.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from imolo.config.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BoxShape:
    """A box that never moves: name, centre (3,) [m], half extents (3,) [m]."""

    name: str
    center: tuple[float, float, float]
    half_extents: tuple[float, float, float]


@dataclass(frozen=True)
class Ball:
    """A free solid sphere: radius [m], mass [kg], moment of inertia [kg m²], and its state when the trial starts."""

    radius: float
    mass: float
    inertia: float
    position: tuple[float, float, float]
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)


NO_BALL = Ball(0.02, 0.01, 1.6e-6, (0.0, 0.0, 1e3))
"""The ball of a scene without one: out of reach, a kilometre above the floor."""


@dataclass(frozen=True)
class Scene:
    """All an engine needs to know, the same for every engine.

    Attributes:
        urdf: Robot model; its links do not collide with each other.
        joint_names: All joints that move, in the order of every joint array.
        link_names: Links in the order of every link array; the first one is the base.
        base_position: Origin of the base link [m], shape (3,).
        base_quaternion: Rotation of the base link, w, x, y, z.
        joint_angle: Joint angles at the start [rad or m].
        ball: The ball; `NO_BALL` where there is none.
        boxes: Fixed boxes beside the floor.
        timestep: Length of one step [s].
        friction: Coulomb friction coefficient of every contact [-].
        restitution: Coefficient of restitution of the ball's contacts [-].
        gravity: Acceleration of free fall [m/s²], shape (3,); tilted, it makes a ramp of the floor.
        fixed_base: Whether the base link is welded to the world.
        base_velocity: Velocity of the base link's origin at the start [m/s], shape (3,).
        base_angular_velocity: Angular velocity of the base link at the start, world axes [rad/s], shape (3,).
        robot_restitution: Coefficient of restitution of the robot's contacts with floor and boxes [-].
    """

    urdf: Path
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    base_position: tuple[float, float, float]
    base_quaternion: tuple[float, float, float, float]
    joint_angle: tuple[float, ...]
    ball: Ball
    boxes: tuple[BoxShape, ...]
    timestep: float
    friction: float
    restitution: float
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    fixed_base: bool = False
    base_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base_angular_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    robot_restitution: float = 0.0


@dataclass(frozen=True)
class BallContact:
    """The ball touched something during a step.

    Attributes:
        time: Time at the end of that step [s].
        other: Link name, box name or "floor".
        position: Contact point in the world frame [m], shape (3,).
        force: Normal force [N].
    """

    time: float
    other: str
    position: Array
    force: float


@dataclass(frozen=True)
class EngineState:
    """A copy of the whole state.

    Attributes:
        time: Time since the start [s].
        joint_angle: Joint angles [rad or m], shape (J,).
        joint_velocity: Joint velocities [rad/s or m/s], shape (J,).
        link_position: Origins of the link frames in the world [m], shape (L, 3).
        link_rotation: Rotation matrices of the link frames, shape (L, 3, 3).
        base_quaternion: Rotation of the base link, w, x, y, z, shape (4,).
        ball_position: Centre of the ball [m], shape (3,).
        ball_velocity: Velocity of the ball's centre [m/s], shape (3,).
        ball_contacts: Every contact of the ball since the last read; one entry per step and touched body.
    """

    time: float
    joint_angle: Array
    joint_velocity: Array
    link_position: Array
    link_rotation: Array
    base_quaternion: Array
    ball_position: Array
    ball_velocity: Array
    ball_contacts: tuple[BallContact, ...] = field(default=())


class EngineOptions(Model):
    """Base of the options of every engine; they appear as keys of the config's backend section."""

    @property
    def integrator_order(self) -> int:
        """Order of the time integration under these options; semi-implicit Euler's is 1."""
        return 1

    @property
    def precision(self) -> float:
        """Relative error of rounding a number of the state; 2**-53 is double precision, 2**-24 single."""
        return 2.0**-53


class Engine(Protocol):
    """One trial of one robot and one ball; a fresh instance per trial, since a reset engine is not a fresh one.

    The constructor takes the `Scene` and the engine's own options, and raises `BackendError` when what the engine
    loaded is not what the scene asks for. `EngineAdapter` in `imolo_backends.engines.adapter` is all of it but what a
    physics library does itself.
    """

    def __init__(self, scene: Scene, options: Any) -> None: ...

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        """Advance by exactly one timestep.

        Args:
            joint_torque: Torques of the actuators about the joint axes [N·m], or forces along them [N], shape (J,).
            ball_force: External force on the ball's centre beside gravity, world frame [N], shape (3,).
        """

    def motion(self) -> tuple[Array, Array, Array]:
        """Return joint angles [rad], joint velocities [rad/s] and the ball's velocity [m/s] after the last step.

        This is the hot path, called at every step. The arrays are C-contiguous and may be views that the next step
        overwrites.
        """

    def read(self) -> EngineState:
        """Return a copy of the whole state after the last step, and forget the ball contacts it holds."""

    def close(self) -> None:
        """Free what the engine holds."""
