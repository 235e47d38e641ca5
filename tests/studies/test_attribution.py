"""Which ingredient two backends differ by."""

from pathlib import Path

import pytest
from played_trials import COARSE

from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import make_config
from imolo.errors import ConfigError
from imolo.studies.attribution import LEAST_GAIN, Attribution, attribute


def config(backend: str, **options: object) -> ExperimentConfig:
    return make_config(
        {
            "backend": {"name": backend, **options},
            "simulation": {"timestep": COARSE},
            "training": {"motions": [(0.0, 0.21)]},
        }
    )


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Attribution:
    """MuJoCo with its own soft contacts, which throw the hand far off, against PyBullet."""
    soft = config("mujoco", solref=(0.02, 1.0))
    folder = ResultsFolder(tmp_path_factory.mktemp("attribution"))
    return attribute((soft, config("pybullet")), folder, jobs=1)


def test_the_soft_contacts_are_named_first(answer: Attribution) -> None:
    first = answer.waterfall[0]
    assert (first.swap.ingredient, first.swap.side) == ("contact stiffness", "mujoco")
    assert answer.start.mean is not None
    assert first.mean < 0.5 * answer.start.mean


def test_every_kept_swap_brings_the_hands_closer(answer: Attribution) -> None:
    level = answer.start.mean
    assert level is not None
    for step in answer.waterfall:
        assert step.mean < level - LEAST_GAIN
        level = step.mean


def test_every_ingredient_is_tried_alone(answer: Attribution) -> None:
    tried = {(result.swap.ingredient, result.swap.side) for result in answer.alone}
    assert {
        ("time step", "both"),
        ("sole shape", "both"),
        ("integrator", "mujoco"),
        ("friction cone", "mujoco"),
        ("friction cone", "pybullet"),
        ("contact stiffness", "mujoco"),
        ("joint-limit model", "pybullet"),
    } <= tried
    # What is configured already is no swap.
    assert not any(result.swap.change == "solref: [0.02, 1.0]" for result in answer.alone)


def test_a_swap_alone_is_rated_from_the_backends_as_they_are(answer: Attribution) -> None:
    for result in answer.alone:
        assert answer.start.mean is not None
        # The triangle inequality, for one motion.
        assert abs(result.mean - answer.start.mean) <= 2.0 * result.moved + 1e-12


def test_one_backend_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="both configs are of backend 'mujoco'"):
        attribute((config("mujoco"), config("mujoco")), ResultsFolder(tmp_path), jobs=1)
