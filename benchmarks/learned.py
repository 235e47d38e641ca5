"""What the planner and its table are measured with: a robot that has learned in MuJoCo, once for all."""

from dataclasses import dataclass
from pathlib import Path

from imolo.ball.model import BallModel
from imolo.campaigns.campaign import learning_tasks, run_tasks
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import config_for
from imolo.contracts.trial import TrialKind
from imolo.method.forward_model import TrainingData
from imolo.trials.learning import learn_ball, learn_motions


@dataclass(frozen=True)
class Learned:
    """The outcome of the learning trials.

    Attributes:
        config: Of the experiment; its methods are the ones to measure.
        ball_models: How balls fly, by method.
        data: How the robot moves.
    """

    config: ExperimentConfig
    ball_models: dict[str, BallModel]
    data: TrainingData


def learn(folder: Path) -> Learned:
    """Run the throws and training motions of the default experiment, with logs in `folder`."""
    config = config_for("mujoco")
    tasks = learning_tasks(config, folder)
    run_tasks(tasks, jobs=-1)
    throws = [task.log_path for task in tasks if task.trial.kind is TrialKind.THROW]
    motions = [task.log_path for task in tasks if task.trial.kind is TrialKind.TRAINING]
    ball_models = {name: learn_ball(method, throws) for name, method in config.methods.items()}
    return Learned(config, ball_models, learn_motions(config, motions))
