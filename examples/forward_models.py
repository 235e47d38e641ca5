"""Compare how well regressions predict the hand between the 15 training motions.

Learns from the motions of Table III with realistic disturbances, then looks at a 7 x 7 grid of theta that the robot
executes undisturbed: `python examples/forward_models.py [backend]`.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from imolo.campaigns.campaign import learning_tasks, run_tasks
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import config_for
from imolo.contracts.trial import TrialKind
from imolo.method.forward_model import GPR, MLP, PAPER_SVR, ForwardModel, TrainingData
from imolo.trials.learning import learn_motions

GRID = [(k, t_w) for k in np.linspace(-1.0, 1.0, 7).tolist() for t_w in np.linspace(0.21, 0.41, 7).tolist()]
MODELS = {
    "SVR, the paper's": PAPER_SVR,
    "SVR, inputs standardised": PAPER_SVR.model_copy(update={"inputs": "standardized"}),
    "Gaussian process": GPR,
    "Gaussian process of `improved`": GPR.model_copy(update={"kernel": "matern", "time": "since_swing"}),
    "neural network": MLP,
}


def record(config: ExperimentConfig, folder: Path) -> TrainingData:
    """Execute the training motions of a config and return where the hand was."""
    tasks = [task for task in learning_tasks(config, folder) if task.trial.kind is TrialKind.TRAINING]
    run_tasks(tasks, jobs=2)
    return learn_motions(config, [task.log_path for task in tasks])


def main() -> None:
    """Print the distance between predicted and executed hand for each model."""
    backend = sys.argv[1] if len(sys.argv) > 1 else "mujoco"
    config = config_for(backend)
    grid = config_for(backend, training={"motions": GRID}, simulation={"disturbance": {"profile": "none"}})
    with tempfile.TemporaryDirectory() as folder:
        learned = record(config, Path(folder) / "learned")
        executed = record(grid, Path(folder) / "executed")
    since_swing = executed.time - executed.theta[:, 1]
    in_table = (since_swing > 0.14) & (since_swing < 0.21)
    table = Table("model", "mean [mm]", "median [mm]", "90 % [mm]", title=f"Hand error on a 7 x 7 grid, {backend}")
    for name, chosen in MODELS.items():
        model = ForwardModel(chosen, config.motion).fit(learned.theta, learned.time, learned.position)
        error = 1e3 * np.linalg.norm(model.predict(executed.theta, executed.time) - executed.position, axis=1)[in_table]
        table.add_row(name, f"{error.mean():.0f}", f"{np.median(error):.0f}", f"{np.percentile(error, 90):.0f}")
    Console().print(table)


if __name__ == "__main__":
    main()
