"""The engine under check, and how its scenes are run."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imolo.conformance import Check, Measurement
from imolo.contracts.engine import Array, Engine, EngineOptions, EngineState, Scene
from imolo_backends.conformance.bodies import CONTACT_TIMESTEP

Errors = Mapping[str, tuple[Array, float]]
"""By quantity, its SI unit in brackets at the end: an error, shape (N,), and the size of what it is an error of."""
WINDOW_STEP = 1e-2  # [s] between states from whose poses velocities are taken: long, against single precision
CONTACT_TIMESTEPS = (2.0 * CONTACT_TIMESTEP, CONTACT_TIMESTEP)  # [s] of motions in contact
ROUNDING = 1e-6  # [m, rad, ...] of long runs; link frames and COMs may be in single precision


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

    def rounding(self, size: float, steps: int = 1, least: float = 1e-9) -> float:
        """Return how far a number may be off for rounding alone.

        Args:
            size: Of the number, or of the largest one that goes into it.
            steps: That add it up: each rounds the sum, and four numbers that go in (force, mass, gravity, timestep).
            least: What is granted anyway.
        """
        return max(least, self.options.precision * size * (steps + 4))

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

    @property
    def timesteps(self) -> tuple[float, float]:
        """Timestep and half of it [s] for smooth motions: small, but the errors far above rounding."""
        return (1e-3, 5e-4) if self.order == 1 else (2e-2, 1e-2)

    def converge(
        self, scene: Scene, rate: float, duration: float, errors: Callable[["Run"], Errors]
    ) -> Iterator[Measurement]:
        """Measure errors of a smooth motion at both `timesteps`, what is left of them at dt = 0, and their order.

        With p the integrator's order, N = `rate` * `duration` and h = `rate` * dt, a motion of this rate may be wrong
        by about s N h^p, s being its size: e. Extrapolated to dt = 0 (Richardson) only the next order is left, which is
        e h or, as errors feed on errors, e N h^p. No order is measured where the error drowns in rounding.

        Args:
            scene: The scene; its timestep does not matter.
            rate: Fastest rate of the motion [1/s].
            duration: How long it lasts [s].
            errors: Runs the scene and returns its errors.
        """
        return self._converge(scene, (rate, duration), errors, self.timesteps, self.order, (ROUNDING, "rounding"))

    def converge_in_contact(
        self, scene: Scene, rate: float, duration: float, errors: Callable[["Run"], Errors], give: float
    ) -> Iterator[Measurement]:
        """Do as `converge` does for a motion in contact, which is of first order in every engine.

        Args:
            scene: The scene; its timestep does not matter.
            rate: Fastest rate of the motion [1/s].
            duration: How long it lasts [s].
            errors: Runs the scene and returns its errors.
            give: How far contacts that count as rigid may be off [m], soft ones and late ones.
        """
        return self._converge(scene, (rate, duration), errors, CONTACT_TIMESTEPS, 1, (give, "what contacts give"))

    def _converge(
        self,
        scene: Scene,
        motion: tuple[float, float],
        errors: Callable[["Run"], Errors],
        timesteps: tuple[float, float],
        order: int,
        floor: tuple[float, str],
    ) -> Iterator[Measurement]:
        results = []
        for timestep in timesteps:
            with self.run(at_timestep(scene, timestep)) as run:
                results.append(errors(run))
        coarse, fine = results
        rate, duration = motion
        give, cause = floor
        step = rate * timesteps[1]
        relative = rate * duration * step**order
        for key, (error, size) in fine.items():
            quantity, unit = key.rstrip("]").split(" [")
            rounding = self.rounding(size, round(duration / timesteps[1]), least=0.0)
            lowest = max(give, rounding)
            before = coarse[key][0]
            limit = at_zero(before, error, order)
            yield Measurement(
                f"error of {quantity}",
                unit,
                0.0,
                float(np.linalg.norm(error)),
                size * relative + lowest,
                f"size x N h^p = {size:.3g} x {relative:.2g}, p = {order}, and {cause}",
            )
            yield Measurement(
                f"error of {quantity} at dt = 0",
                unit,
                0.0,
                float(np.linalg.norm(limit)),
                size * relative * max(step, relative) + max(give, 3.0 * rounding),
                f"Richardson leaves the next order, and {cause}",
            )
            if np.linalg.norm(error) > 10.0 * lowest:
                yield Measurement(
                    f"order of {quantity}",
                    "",
                    order,
                    observed_order(float(np.linalg.norm(before)), float(np.linalg.norm(error))),
                    0.2 * order,
                    "the next order at these timesteps",
                )


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

    def joint_motion(self, duration: float, torque: Array | None = None) -> tuple[Array, Array]:
        """Step for a duration [s]; return joint angles [rad] and velocities [rad/s] of every step, shape (N + 1, J)."""
        torque, no_force = self.no_torque if torque is None else torque, np.zeros(3)
        steps = round(duration / self.scene.timestep)
        motion = np.empty((2, steps + 1, len(torque)))
        motion[:, 0] = self.engine.motion()[:2]
        for number in range(1, steps + 1):
            self.engine.step(torque, no_force)
            motion[0, number], motion[1, number], _ = self.engine.motion()
        return motion[0], motion[1]

    def window(self, middle: float, torque: Array | None = None) -> list[EngineState]:
        """Return five states, `WINDOW_STEP` or one timestep apart, the third of which is `middle` [s] after now."""
        step = max(WINDOW_STEP, self.scene.timestep)
        first = self.advance(middle - 2.0 * step, torque)
        return [first, *(self.advance(step, torque) for _ in range(4))]


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


def at_zero(coarse: Array, fine: Array, order: int = 1) -> Array:
    """Return what two timesteps, one half of the other, lead to at dt = 0 (Richardson)."""
    gain = 2.0**order
    return (gain * fine - coarse) / (gain - 1.0)


def observed_order(coarse_error: float, fine_error: float, ratio: float = 2.0) -> float:
    """Return the order of convergence from the errors at two timesteps whose ratio is `ratio`."""
    return float(np.log(abs(coarse_error) / abs(fine_error)) / np.log(ratio))
