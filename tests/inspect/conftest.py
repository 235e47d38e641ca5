"""Two short recorded trials with their planner's table, learned once."""

import pytest
from recorded_trials import METHOD, Recorded

from imolo.campaigns.campaign import learning_tasks, run_tasks
from imolo.config.loading import config_for
from imolo.contracts.trial import Trial, TrialKind
from imolo.method.forward_model import ForwardModelConfig
from imolo.method.planner import Planner
from imolo.method.table_grid import GridAxis, TableGrid
from imolo.trials.learning import build_table, learn_ball, learn_motions
from imolo.trials.trial import run_trial

# A fifth of the paper's predictions along each axis and twice its tolerances: as many queries are answered.
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
QUICK = ForwardModelConfig(parameters={"C": 100.0, "epsilon": 0.001, "gamma": 0.3}, inputs="standardized")


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("recorded")
    config = config_for("mujoco", simulation={"timestep": 5e-4}, campaign={"learning_throws": 3})
    tasks = learning_tasks(config, folder / "learning")
    run_tasks(tasks, jobs=1)
    logs = {kind: [task.log_path for task in tasks if task.trial.kind is kind] for kind in TrialKind}
    method = config.methods[METHOD].model_copy(update={"grid": GRID, "forward_model": QUICK})
    ball_model = learn_ball(method, logs[TrialKind.THROW])
    table = build_table(config, method, learn_motions(config, logs[TrialKind.TRAINING]), ball_model)
    table.save(folder / "table.npz")
    paths = []
    for index in (0, 1):
        planner = Planner(table, ball_model, method.planner, config.tracker)
        paths.append(folder / f"hit_{index}.lcmlog")
        run_trial(config, Trial(TrialKind.HIT, index, 3), planner, paths[-1], 0.9)
    return Recorded(paths[0], paths[1], folder / "table.npz")


@pytest.fixture
def columns() -> int:
    return 140
