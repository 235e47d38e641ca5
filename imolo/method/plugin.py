"""IMoLo's planner as a plug-in."""

from collections.abc import Callable
from pathlib import Path

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of
from imolo.config.model import Model
from imolo.contracts.planner import Planner as PlannerContract
from imolo.contracts.planner import PlannerPlugin
from imolo.method.learned import load_learned
from imolo.method.planner import Planner, PlannerConfig


class NoOptions(Model):
    """The settings of IMoLo's planner are the `planner` section of a method."""


def planner_config(config: ExperimentConfig, method: str) -> PlannerConfig:
    """Return the settings of a method's planner, the size of hand and ball filled in."""
    chosen = config.methods[method].planner
    width = chosen.hit.effector_width or body_of(config.robot).effectors[0].width
    radius = chosen.hit.ball_radius or config.simulation.ball.radius
    hit = chosen.hit.model_copy(update={"effector_width": width, "ball_radius": radius})
    return chosen.model_copy(update={"hit": hit})


def _create(
    config: ExperimentConfig, method: str, table_path: Path, on_decision: Callable[[float], object]
) -> PlannerContract:
    table, ball_model = load_learned(table_path, config.robot.name, type(config.motion))
    return Planner(table, ball_model, planner_config(config, method), config.tracker, on_decision)


PLANNER = PlannerPlugin("a lookup table of learned dynamics", NoOptions, _create)
