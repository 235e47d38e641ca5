"""The part of an engine that is the same for all of them."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from imolo.contracts.engine import Array, BallContact, EngineState, Scene
from imolo.contracts.urdf import RobotModel, read_urdf
from imolo_backends.engines.engine_checks import Loaded, Numbers, Touch, check_loaded, check_scene, merge_touches
from imolo_backends.engines.plain_urdf import plain_urdf


class Poses(NamedTuple):
    """Where everything is after the last step; views and lists will do, since `EngineAdapter.read` copies.

    Attributes:
        link_position: Origins of the link frames, in the order of `Scene.link_names` [m], shape (L, 3).
        link_rotation: Rotation matrices of the link frames, shape (L, 3, 3).
        base_quaternion: Rotation of the base link, w, x, y, z, shape (4,).
        ball_position: Centre of the ball [m], shape (3,).
    """

    link_position: Any
    link_rotation: Any
    base_quaternion: Any
    ball_position: Any


class EngineAdapter(ABC):
    """An `Engine`, but for what its physics library has to do and say.

    It reads the URDF, compares what was loaded with it, counts time, merges contacts and copies states. An adapter has
    six methods. They are called in this order: `load` once; then `motion`, `advance`, and `touches` after an `advance`
    that returned True, for every step; `poses` now and then, at the start as well; `close` at the end, also if `load`
    fails.
    """

    def __init__(self, scene: Scene, options: Any) -> None:
        """Load a scene.

        Raises:
            BackendError: The scene cannot be loaded, or the library holds something else than it asks for.
        """
        self._scene = scene
        self._steps = 0
        self._contacts: list[BallContact] = []
        with plain_urdf(scene.urdf) as urdf:
            robot = read_urdf(urdf)
            check_scene(scene, robot)
            try:
                check_loaded(scene, robot, self.load(urdf, robot, options))
            except BaseException:
                self.close()
                raise

    @abstractmethod
    def load(self, urdf: Path, robot: RobotModel, options: Any) -> Loaded:
        """Load `self._scene`, put everything where it starts, and say what the library holds.

        Args:
            urdf: What to load: the scene's URDF without anything that engines read in different ways, in a folder that
                is gone afterwards (see `plain_urdf`).
            robot: What it says, for libraries that do not read URDFs.
            options: The engine's own options.

        Raises:
            BackendError: The library cannot do what the scene asks for.
        """

    @abstractmethod
    def advance(self, joint_torque: Array, ball_force: Array) -> bool:
        """Advance by exactly one timestep, and return whether the ball may have touched something; see `Engine.step`.

        Raises:
            DivergenceError: Where the library would otherwise abort or hide what is not finite.
        """

    @abstractmethod
    def touches(self) -> Iterable[Touch]:
        """Return each contact point of the ball in the last step: with what, where [m], and the normal force [N].

        With what is a link's name, a box's name or `FLOOR`; points without force are passed over.
        """

    @abstractmethod
    def motion(self) -> tuple[Array, Array, Array]:
        """See `Engine.motion`."""

    @abstractmethod
    def poses(self) -> Poses:
        """Return where links and ball are after the last step.

        Raises:
            DivergenceError: Where the library hides that something is not finite.
        """

    def close(self) -> None:  # noqa: B027 - most libraries free their memory with the object
        """See `Engine.close`; called once or more, and after a `load` that failed."""

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self._steps * self._scene.timestep

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        """See `Engine.step`."""
        touched = self.advance(joint_torque, ball_force)
        self._steps += 1
        if touched:
            self._contacts += merge_touches(self.time, self.touches())

    def read(self) -> EngineState:
        """See `Engine.read`."""
        link_position, link_rotation, base_quaternion, ball_position = self.poses()
        joint_angle, joint_velocity, ball_velocity = self.motion()
        contacts, self._contacts = tuple(self._contacts), []
        return EngineState(
            time=self.time,
            joint_angle=joint_angle.copy(),
            joint_velocity=joint_velocity.copy(),
            link_position=_copy(link_position),
            link_rotation=_copy(link_rotation),
            base_quaternion=_copy(base_quaternion),
            ball_position=_copy(ball_position),
            ball_velocity=ball_velocity.copy(),
            ball_contacts=contacts,
        )


def _copy(values: Numbers) -> Array:
    return np.array(values, dtype=np.float64, order="C")
