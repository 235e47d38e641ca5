"""Steps in compiled code do what steps in Python do, and nothing that a subclass replaced."""

from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from played_trials import COARSE, play

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import make_config
from imolo.contracts.engine import Array
from imolo.contracts.registry import ROBOTS
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.messaging.bus import Bus
from imolo.trials.trainer import MotionPlayer
from imolo_backends.engines.mujoco_engine import MujocoEngine, MujocoOptions
from imolo_backends.simulation import stepping
from imolo_backends.simulation.simulated import simulated_plugin

DURATION = 1.5  # [s] until every ball has touched something


def trial(robot: str) -> ExperimentConfig:
    settings: dict[str, Any] = {"robot": {"name": robot}, "backend": {"name": "mujoco"}, "seed": 1}
    return make_config({**settings, "simulation": {"timestep": COARSE}})


def log_of(config: ExperimentConfig, path: Path) -> bytes:
    player = MotionPlayer(config.motion, config.training.motions[0])
    log = play(config, path, player, DURATION, TrialKind.HIT)
    told = {event.event for event in log.messages["TRIAL"]}
    assert told & {EventName.TOUCH, EventName.BALL_LANDED}
    return path.read_bytes()


@pytest.mark.parametrize("robot", ROBOTS.names())
def test_compiled_steps_leave_the_log_of_steps_in_python(robot: str, tmp_path: Path) -> None:
    """Contacts of the ball included, in whichever step they begin."""
    taken, compile_steps = mock.Mock(), stepping._take_steps.compile

    def counted(types: Any) -> mock.Mock:
        taken.side_effect = compile_steps(types)
        return taken

    with mock.patch.object(stepping, "_take_steps", mock.Mock(compile=counted)):
        first = log_of(trial(robot), tmp_path / "compiled")
    assert taken.call_count > DURATION * 1e3
    with mock.patch.object(stepping, "twin", return_value=None):
        assert log_of(trial(robot), tmp_path / "python") == first


@pytest.mark.parametrize("method", ["step", "advance"])
def test_what_a_subclass_replaces_is_what_runs(method: str, tmp_path: Path) -> None:
    calls = []
    original = getattr(MujocoEngine, method)

    def counted(self: MujocoEngine, joint_torque: Array, ball_force: Array) -> object:
        calls.append(1)
        return original(self, joint_torque, ball_force)

    plugin = simulated_plugin(type("Counted", (MujocoEngine,), {method: counted}), MujocoOptions, "counts")
    backend = plugin.create(trial("liberobot"), MujocoOptions())
    backend.start(Bus(), Trial(TrialKind.TRAINING, 0, 1))
    calls.clear()  # without those of the start-up check
    backend.advance(round(20 * COARSE * 1e6))
    backend.close()
    assert len(calls) == 20
