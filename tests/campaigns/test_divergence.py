"""A simulation that breaks says when and where, and keeps what was recorded until then."""

from collections.abc import Callable
from math import ceil
from typing import Any

import numpy as np
import pytest
from liberobot import BODY
from numpy.typing import NDArray
from played_trials import COARSE, config

from imolo.config.experiment import PluginConfig
from imolo.config.model import Model
from imolo.contracts.engine import EngineState, Scene
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import DivergenceError
from imolo.messaging.bus import Bus
from imolo_backends.simulation.simulated import simulated_plugin

Array = NDArray[np.float64]
BREAKS_AT = 0.0125  # [s]
CONFIG = config("mujoco").model_copy(update={"backend": PluginConfig(name="stub")})
LOOK = 1.0 / CONFIG.simulation.truth_rate  # [s] between two looks at the state
SEEN_AT = LOOK * ceil(BREAKS_AT / LOOK)


@pytest.fixture(autouse=True)
def no_start_up_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """The engines of these tests do not fall, and would not get as far as to diverge."""
    monkeypatch.setattr("imolo_backends.simulation.simulated.check_start_up", lambda *_: None)


class NoOptions(Model):
    pass


class FrozenEngine:
    """An engine in which nothing moves until one number breaks."""

    broken: Callable[[dict[str, Array]], None]

    def __init__(self, scene: Scene, _: Any) -> None:
        self._scene = scene
        self._steps = 0
        self._parts = {
            "joint_angle": np.array(scene.joint_angle),
            "joint_velocity": np.zeros(8),
            "link_position": np.ones((len(BODY.link_names), 3)),
            "link_rotation": np.tile(np.eye(3), (len(BODY.link_names), 1, 1)),
            "base_quaternion": np.array([1.0, 0.0, 0.0, 0.0]),
            "ball_position": np.array(scene.ball.position),
            "ball_velocity": np.zeros(3),
        }

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        self._steps += 1
        if self._steps == round(BREAKS_AT / self._scene.timestep):
            type(self).broken(self._parts)

    def motion(self) -> tuple[Array, Array, Array]:
        return self._parts["joint_angle"], self._parts["joint_velocity"], self._parts["ball_velocity"]

    def read(self) -> EngineState:
        copies = {name: part.copy() for name, part in self._parts.items()}
        return EngineState(time=self._steps * self._scene.timestep, **copies)

    def close(self) -> None:
        pass


def breaking(part: str, index: Any, value: float) -> type[FrozenEngine]:
    def broken(parts: dict[str, Array]) -> None:
        parts[part][index] = value

    return type("Breaking", (FrozenEngine,), {"broken": staticmethod(broken)})


def run(engine: type[FrozenEngine], until: float) -> None:
    plugin = simulated_plugin(engine, NoOptions, "breaks")
    backend = plugin.create(CONFIG, NoOptions())
    bus = Bus()
    backend.start(bus, Trial(TrialKind.TRAINING, 3, 1))
    try:
        backend.advance(round(until * 1e6))
    finally:
        backend.close()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("part", "index", "where"),
    [
        ("joint_angle", 1, "joint right_knee"),
        ("joint_velocity", 6, "joint right_shoulder"),
        ("link_position", (0, 2), "link trunk"),
        ("ball_position", 0, "the ball"),
    ],
)
def test_divergence_names_backend_place_time_and_trial(part: str, index: Any, where: str, value: float) -> None:
    with pytest.raises(DivergenceError) as caught:
        run(breaking(part, index, value), 0.02)
    assert str(caught.value) == (
        f"stub: {where} is no longer finite at {SEEN_AT:.4f} s of training trial 3; "
        f"try a smaller simulation.timestep than {COARSE:g} s"
    )


def test_nothing_is_said_before_it_breaks() -> None:
    run(breaking("joint_angle", 1, np.nan), BREAKS_AT - COARSE)


def test_two_joints_that_cancel_are_still_seen() -> None:
    def broken(parts: dict[str, Array]) -> None:
        parts["joint_angle"][2], parts["joint_angle"][5] = np.inf, -np.inf

    engine = type("Breaking", (FrozenEngine,), {"broken": staticmethod(broken)})
    with pytest.raises(DivergenceError, match="joint right_ankle"):
        run(engine, 0.02)


def test_speed_of_the_ball_is_checked_too() -> None:
    with pytest.raises(DivergenceError, match="the ball"):
        run(breaking("ball_velocity", 1, np.nan), 0.02)
