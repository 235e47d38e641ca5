"""The part of an engine that is the same for all of them."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from imolo.contracts.engine import Array, BallContact, EngineState, Scene
from imolo.contracts.urdf import RobotModel, read_urdf
from imolo_backends.compiled import CompiledStep, definer, twin
from imolo_backends.engines.engine_checks import (
    FLOOR,
    Body,
    Loaded,
    Touch,
    check_loaded,
    check_scene,
    merge_touches,
)
from imolo_backends.engines.plain_urdf import fill_masses, plain_urdf

__all__ = ["FLOOR", "Body", "EngineAdapter", "Loaded", "Poses", "Touch"]


Poses = tuple[Array, Array, Array, Array]
"""Where everything is after the last step; views will do, since `EngineAdapter.read` copies.

Origins of the link frames in the order of `Scene.link_names` [m], shape (L, 3); rotation matrices of the link frames,
shape (L, 3, 3); rotation of the base link, w, x, y, z, shape (4,); centre of the ball [m], shape (3,).
"""


class EngineAdapter(ABC):
    """An `Engine`, but for what its physics library has to do and say.

    It reads the URDF, compares what was loaded with it, counts time, merges contacts and copies states. An adapter has
    six methods. They are called in this order: `load` once; then `write_motion`, `advance`, and `touches` after an
    `advance` that returned something true, for every step; `poses` now and then, at the start as well; `close` at the
    end, also if `load` fails.
    """

    def __init__(self, scene: Scene, options: Any) -> None:
        """Load a scene.

        Raises:
            BackendError: The scene cannot be loaded, or the library holds something else than it asks for.
        """
        self._scene = scene
        self._steps = 0
        self._contacts: list[BallContact] = []
        joints = len(scene.joint_names)
        self._motion = np.zeros(joints), np.zeros(joints), np.zeros(3)
        self._motion_is_old = True
        robot = fill_masses(read_urdf(scene.urdf))
        check_scene(scene, robot)
        with plain_urdf(scene.urdf, robot) as urdf:
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
    def advance(self, joint_torque: Array, ball_force: Array) -> object:
        """Advance by exactly one timestep, and return something true if the ball may have touched; see `Engine.step`.

        Raises:
            DivergenceError: Where the library would otherwise abort or hide what is not finite.
        """

    @abstractmethod
    def touches(self) -> Iterable[Touch]:
        """Return each contact point of the ball in the last step: with what, where [m], and the normal force [N].

        With what is a link's name, a box's name or `FLOOR`; points without force are passed over.
        """

    @abstractmethod
    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """Write joint angles [rad] and velocities [rad/s], each of shape (J,), and the ball's [m/s], shape (3,)."""

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
        self._count(1, self.advance(joint_torque, ball_force))
        self._motion_is_old = True

    def compiled_step(self) -> CompiledStep | None:
        """Return what does the same as `step` in compiled code, of an adapter with a `compiled_advance`.

        It also writes the arrays of `motion`.
        """
        advance = twin(self, "advance")
        if advance is None or not issubclass(definer(self, "advance"), definer(self, "write_motion")):
            return None
        function, joint_torque, ball_force, ball_reaction = advance
        return CompiledStep(function, joint_torque, ball_force, ball_reaction, self._count)

    def _count(self, steps: int, touched: object) -> None:
        self._steps += steps
        if touched:
            self._contacts += merge_touches(self.time, self.touches())

    def motion(self) -> tuple[Array, Array, Array]:
        """See `Engine.motion`; an adapter whose library shows its own memory sets `_motion` in `load`."""
        if self._motion_is_old:
            self.write_motion(*self._motion)
            self._motion_is_old = False
        return self._motion

    def read(self) -> EngineState:
        """See `Engine.read`."""
        link_position, link_rotation, base_quaternion, ball_position = self.poses()
        joint_angle, joint_velocity, ball_velocity = self.motion()
        contacts, self._contacts = tuple(self._contacts), []
        return EngineState(
            time=self.time,
            joint_angle=joint_angle.copy(),
            joint_velocity=joint_velocity.copy(),
            link_position=link_position.copy(),
            link_rotation=link_rotation.copy(),
            base_quaternion=base_quaternion.copy(),
            ball_position=ball_position.copy(),
            ball_velocity=ball_velocity.copy(),
            ball_contacts=contacts,
        )
