"""The planner of the simulations hits balls through the wires of the robot."""

from pathlib import Path

import pytest

from benchmarks import hardware, learned
from imolo.trials.learning import build_table

METHOD = "improved"


@pytest.mark.slow
def test_at_least_16_of_20_balls_are_hit_through_the_emulated_robot(tmp_path: Path) -> None:
    """What a busy machine has held up does not count, hit or not: see `hardware.play_campaign`."""
    robot = learned.learn(tmp_path)
    path = tmp_path / "table.npz"
    build_table(robot.config, robot.config.methods[METHOD], robot.data, robot.ball_models[METHOD]).save(path)
    campaign = hardware.play_campaign(tmp_path, path, METHOD, balls=20)
    if campaign.balls < 20:
        pytest.skip(f"the machine was too busy: {campaign.void} trials were void, {campaign.balls} were not")
    assert campaign.hits >= 16
    assert campaign.hits_in_truth >= 16
