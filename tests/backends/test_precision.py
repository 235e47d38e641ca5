"""An engine in single precision is let in by declaring it, and is granted its rounding and nothing more."""

import numpy as np
import pytest
from liberobot import BODY

from imolo.conformance import Verdict, run_check
from imolo.contracts.engine import Array
from imolo.errors import BackendError
from imolo_backends.conformance import SCENES
from imolo_backends.conformance.subject import Subject, bind
from imolo_backends.engines.mujoco_engine import MujocoEngine, MujocoOptions
from imolo_backends.simulation.start_up import check_start_up

CHECKS = {scene.__name__: scene for scene in SCENES}
ROUNDED = ("free_fall", "units", "braked_fall", "projectile")


class SingleOptions(MujocoOptions):
    @property
    def precision(self) -> float:
        return 2.0**-24


class Single(MujocoEngine):
    """MuJoCo whose state is rounded to single precision after every step."""

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        super().step(joint_torque, ball_force)
        self._data.qpos[:] = self._data.qpos.astype(np.float32)
        self._data.qvel[:] = self._data.qvel.astype(np.float32)


class Damped(Single):
    """Damps everything by what PhysX does at first."""

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        super().step(joint_torque, ball_force)
        self._data.qvel[:] *= 1.0 - 0.05 * self._scene.timestep


def failed(engine: type[MujocoEngine], options: MujocoOptions, check: str) -> bool:
    outcomes = run_check(bind(CHECKS[check], Subject(engine, options)), ())
    return any(outcome.verdict is Verdict.FAIL for outcome in outcomes)


@pytest.mark.parametrize("check", ROUNDED)
def test_rounding_passes_where_it_is_declared_and_fails_where_it_is_not(check: str) -> None:
    assert failed(Single, MujocoOptions(), check)
    assert not failed(Single, SingleOptions(), check)


@pytest.mark.parametrize("check", ["free_fall", "braked_fall", "projectile", "spinning_joint", "rod_pendulum"])
def test_default_damping_is_caught_in_single_precision_as_well(check: str) -> None:
    assert failed(Damped, SingleOptions(), check)


def test_start_up_lets_a_declared_precision_in_and_no_damping() -> None:
    with pytest.raises(BackendError, match="free fall"):
        check_start_up(Single, MujocoOptions(), 1e-4, BODY)
    check_start_up(Single, SingleOptions(), 1e-4, BODY)
    with pytest.raises(BackendError, match="free fall"):
        check_start_up(Damped, SingleOptions(), 1e-4, BODY)
