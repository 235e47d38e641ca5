"""What the programs of the tests start from: a coarse config, and a table that was learned with it."""

from dataclasses import dataclass
from pathlib import Path

from imolo.campaigns.campaign import learning_tasks, run_tasks
from imolo.config.experiment import ExperimentConfig
from imolo.contracts.trial import TrialKind
from imolo.method.forward_model import ForwardModelConfig
from imolo.method.table_grid import GridAxis, TableGrid
from imolo.trials.learning import build_table, learn_ball, learn_motions

COARSE = """
backend: {name: mujoco}
simulation: {timestep: 5.0e-4}
campaign: {learning_throws: 4}
"""
GRID = TableGrid(
    parameters={
        "t_w": GridAxis(start=0.21, stop=0.41, step=0.01),
        "k": GridAxis(start=-1.0, stop=1.0, step=0.05),
    },
    time_since_swing=GridAxis(start=0.14, stop=0.21, step=0.01),
    spacing=0.02,
    time_tolerance=0.02,
    unique="all",
)
# Fits in milliseconds; how well it predicts is not the point here.
QUICK = ForwardModelConfig(parameters={"C": 100.0, "epsilon": 0.001, "gamma": 0.3}, inputs="standardized")


@dataclass(frozen=True)
class Learned:
    """Files from which programs start."""

    config_path: Path
    table_path: Path
    config: ExperimentConfig


def learn(config: ExperimentConfig, folder: Path, table_path: Path) -> None:
    tasks = learning_tasks(config, folder)
    run_tasks(tasks, jobs=1)
    by_kind = {kind: [task.log_path for task in tasks if task.trial.kind is kind] for kind in TrialKind}
    data = learn_motions(config, by_kind[TrialKind.TRAINING])
    method = config.methods["paper"].model_copy(update={"grid": GRID, "forward_model": QUICK})
    ball_model = learn_ball(method, by_kind[TrialKind.THROW])
    build_table(config, method, data, ball_model).save(table_path)
