"""The short run before the first trial catches what cannot be read back."""

from types import ModuleType
from typing import Any

import pytest
from conftest import ENGINES
from liberobot import BODY

from imolo.contracts.engine import Array
from imolo.errors import BackendError
from imolo_backends.engines.mujoco_engine import MujocoEngine, MujocoOptions
from imolo_backends.simulation.start_up import check_start_up


@pytest.mark.parametrize("timestep", [1e-4, 1e-3])
def test_every_engine_passes(engine_name: str, engine_module: ModuleType, timestep: float) -> None:
    _, engine, options = ENGINES[engine_name]
    check_start_up(getattr(engine_module, engine), getattr(engine_module, options)(), timestep, BODY)


class Damped(MujocoEngine):
    """Bullet's default damping of 0.04 /s."""

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        super().step(joint_torque, ball_force)
        self._ball_velocity *= 1.0 - 0.04 * 1e-4


def test_default_damping_of_the_ball_is_caught() -> None:
    with pytest.raises(BackendError, match="free fall"):
        check_start_up(Damped, MujocoOptions(), 1e-4, BODY)


class Limitless(MujocoEngine):
    """DART's default."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._model.jnt_limited[:] = 0


def test_joint_limits_that_are_not_enforced_are_caught() -> None:
    with pytest.raises(BackendError, match="joint limits are not enforced"):
        check_start_up(Limitless, MujocoOptions(), 1e-4, BODY)
