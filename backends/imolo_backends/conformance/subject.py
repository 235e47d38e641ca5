"""The engine under check, and how its scenes are run."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imolo.conformance import Check, Measurement
from imolo_backends.engine import Array, Engine, EngineOptions, EngineState, Scene

Observe = Callable[[EngineState], object]


@dataclass(frozen=True)
class Subject:
    """The engine under check.

    Attributes:
        engine: Its class.
        options: Its options.
    """

    engine: type[Engine]
    options: EngineOptions

    @property
    def order(self) -> int:
        """Order of the engine's integrator under these options."""
        return self.options.integrator_order

    @contextmanager
    def run(self, scene: Scene) -> Iterator["Run"]:
        """Load a scene, and free the engine at the end."""
        engine = self.engine(scene, self.options)
        try:
            yield Run(engine, scene)
        finally:
            engine.close()

    def final_state(self, scene: Scene, duration: float, torque: Array | None = None) -> EngineState:
        """Run a scene for a duration [s] under constant torques [N·m] and return the last state."""
        with self.run(scene) as run:
            return run.advance(duration, torque)


class Run:
    """A scene that is running."""

    def __init__(self, engine: Engine, scene: Scene) -> None:
        self.engine = engine
        self.scene = scene
        self.weight = -scene.ball.mass * np.array(scene.gravity)  # [N] that holds the ball against gravity
        self.no_torque = np.zeros(len(scene.joint_names))

    def advance(self, duration: float, torque: Array | None = None, force: Array | None = None) -> EngineState:
        """Step for a duration and return the state.

        Args:
            duration: [s], rounded to steps.
            torque: Joint torques [N·m], shape (J,); None for none.
            force: On the ball beside gravity [N], shape (3,); None for none.
        """
        step = self.engine.step
        torque = self.no_torque if torque is None else torque
        force = np.zeros(3) if force is None else force
        for _ in range(round(duration / self.scene.timestep)):
            step(torque, force)
        return self.engine.read()

    def states(self, duration: float, every: float, torque: Array | None = None) -> Iterator[EngineState]:
        """Yield the state at the start and then every `every` seconds until `duration` [s] has passed."""
        yield self.engine.read()
        for _ in range(round(duration / every)):
            yield self.advance(every, torque)


SceneCheck = Callable[[Subject], Iterable[Measurement]]
"""A scene: a function named as the check, whose docstring's first line is its title."""


def bind(scene_check: SceneCheck, subject: Subject) -> Check:
    """Make the check of one engine from a scene."""
    function: Any = scene_check
    title = (function.__doc__ or function.__name__).strip().splitlines()[0].rstrip(".")
    group = function.__module__.rsplit(".", 1)[-1].replace("_", " ")
    return Check(function.__name__, group, title, lambda: scene_check(subject))


def at_timestep(scene: Scene, timestep: float) -> Scene:
    """Return the scene with another timestep [s]."""
    return replace(scene, timestep=timestep)


def observed_order(coarse_error: float, fine_error: float, ratio: float = 2.0) -> float:
    """Return the order of convergence from the errors at two timesteps whose ratio is `ratio`."""
    return float(np.log(abs(coarse_error) / abs(fine_error)) / np.log(ratio))
