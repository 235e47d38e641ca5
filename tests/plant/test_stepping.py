"""Steps in compiled code do what steps in Python do, and nothing that a subclass replaced."""

from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from liberobot import ready_scene
from played_trials import COARSE, play
from requirements import needs

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import make_config
from imolo.contracts.engine import Array, EngineOptions
from imolo.contracts.registry import ROBOTS
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.messaging.bus import Bus
from imolo.trials.trainer import MotionPlayer
from imolo_backends.engines import dart_step, pybullet_step
from imolo_backends.engines.adapter import EngineAdapter
from imolo_backends.engines.dart_engine import DartEngine, DartOptions
from imolo_backends.engines.pybullet_engine import PybulletEngine, PybulletOptions
from imolo_backends.simulation import stepping
from imolo_backends.simulation.simulated import simulated_plugin

STEPPED_WITHOUT_PYTHON = [(robot, "mujoco") for robot in ROBOTS.names()]
STEPPED_WITHOUT_PYTHON += [("liberobot", engine) for engine in ("pybullet", "dart", "ode")]
DURATION = 1.5  # [s] until every ball has touched something


def trial(robot: str, engine: str = "mujoco") -> ExperimentConfig:
    settings: dict[str, Any] = {"robot": {"name": robot}, "backend": {"name": engine}, "seed": 1}
    return make_config({**settings, "simulation": {"timestep": COARSE}})


def log_of(config: ExperimentConfig, path: Path) -> bytes:
    player = MotionPlayer(config.motion, config.training.motions[0])
    log = play(config, path, player, DURATION, TrialKind.HIT)
    told = {event.event for event in log.messages["TRIAL"]}
    assert told & {EventName.TOUCH, EventName.BALL_LANDED}
    return path.read_bytes()


@pytest.mark.parametrize(("robot", "engine"), [pytest.param(*x, marks=needs(x[1])) for x in STEPPED_WITHOUT_PYTHON])
def test_compiled_steps_leave_the_log_of_steps_in_python(robot: str, engine: str, tmp_path: Path) -> None:
    """Contacts of the ball included, in whichever step they begin."""
    taken, compile_steps = mock.Mock(), stepping._take_steps.compile

    def counted(types: Any) -> mock.Mock:
        taken.side_effect = compile_steps(types)
        return taken

    with mock.patch.object(stepping, "_take_steps", mock.Mock(compile=counted)):
        first = log_of(trial(robot, engine), tmp_path / "compiled")
    assert taken.call_count > DURATION * 1e3
    with mock.patch.object(stepping, "twin", return_value=None):
        assert log_of(trial(robot, engine), tmp_path / "python") == first


@pytest.mark.parametrize("method", ["step", "advance", "write_motion"])
def test_what_a_subclass_replaces_is_what_runs(method: str, tmp_path: Path) -> None:
    calls = []
    original = getattr(PybulletEngine, method)

    def counted(self: PybulletEngine, *arguments: Array) -> object:
        calls.append(1)
        return original(self, *arguments)

    plugin = simulated_plugin(type("Counted", (PybulletEngine,), {method: counted}), PybulletOptions, "counts")
    backend = plugin.create(trial("liberobot"), PybulletOptions())
    backend.start(Bus(), Trial(TrialKind.TRAINING, 0, 1))
    calls.clear()  # without those of the start-up check
    backend.advance(round(20 * COARSE * 1e6))
    backend.close()
    assert len(calls) == 20


@pytest.mark.parametrize(
    ("engine", "options", "hidden"),
    [
        (DartEngine, DartOptions(), mock.patch.object(dart_step, "PYBIND", b"another C++")),
        (DartEngine, DartOptions(), mock.patch.object(dart_step, "has_all", return_value=False)),
        (PybulletEngine, PybulletOptions(), mock.patch.object(pybullet_step, "_clients", return_value=0)),
        (PybulletEngine, PybulletOptions(), mock.patch.object(pybullet_step, "has_all", return_value=False)),
    ],
)
def test_a_library_that_hides_what_compiled_steps_need_is_stepped_in_python(
    engine: type[EngineAdapter], options: EngineOptions, hidden: Any
) -> None:
    one = engine(ready_scene(), options)
    assert one.compiled_step() is not None
    with hidden:
        assert one.compiled_step() is None
    one.close()
