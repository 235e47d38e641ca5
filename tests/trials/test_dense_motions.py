"""Training motions without a bus or logs are the motions of the logs, to the last bit."""

from pathlib import Path

import numpy as np
import pytest
from played_trials import BACKEND_PARAMS, config, play

from imolo.campaigns.dense_motions import play_motions, read_samples
from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ExperimentConfig
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import ResultsError, TrainingDataError
from imolo.method.forward_model import TrainingData
from imolo.trials.learning import spread_motions
from imolo.trials.recordings import hand_samples
from imolo.trials.rollout import sample_motion
from imolo.trials.trainer import START_MARGIN, MotionPlayer


def dense(count: int, backend: str = "mujoco", **simulation: object) -> ExperimentConfig:
    chosen = config(backend, 1e-3, seed=7, disturbance={"profile": "realistic"}, sensor_rate=240.0, **simulation)
    training = chosen.training.model_copy(update={"motions": spread_motions(chosen, count)})
    return chosen.model_copy(update={"training": training})


def assert_same(one: TrainingData, other: TrainingData) -> None:
    for name in ("theta", "time", "position"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


# Half of the frames are lost, so that the onset differs from trial to trial.
@pytest.mark.parametrize("backend", BACKEND_PARAMS)
def test_samples_without_a_bus_are_those_of_the_log(backend: str, tmp_path: Path) -> None:
    chosen = dense(3, backend, mocap={"frame_dropout": 0.5, "clock_offset": 0.01})
    for index, theta in enumerate(chosen.training.motions):
        duration = START_MARGIN + chosen.motion.swing_of(theta) + chosen.training.sampled_to
        log = play(chosen, tmp_path / f"{index}", MotionPlayer(chosen.motion, theta), duration, index=index)
        assert_same(sample_motion(chosen, Trial(TrialKind.TRAINING, index, chosen.seed)), hand_samples(log, chosen))


def test_a_motion_that_the_cameras_never_show_is_named() -> None:
    chosen = dense(1, mocap={"marker_dropout": 1.0})
    with pytest.raises(TrainingDataError, match=r"training motion 0.*marker"):
        sample_motion(chosen, Trial(TrialKind.TRAINING, 0, chosen.seed))


def test_motions_that_are_there_are_not_played_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imolo.campaigns.dense_motions.MOTIONS_PER_FILE", 2)
    chosen = dense(3)
    counts: list[tuple[int, int]] = []
    paths = play_motions(chosen, tmp_path, 1)
    samples = read_samples(paths)
    assert len(paths) == 2
    paths[1].write_bytes(paths[1].read_bytes()[:-1])  # as a disk may leave it
    again = play_motions(chosen, tmp_path, 1, lambda *count: counts.append(count))
    assert counts == [(2, 3), (3, 3)]
    assert_same(read_samples(again), samples)


def test_motions_of_another_seed_are_refused_until_they_are_deleted(tmp_path: Path) -> None:
    folder, chosen = ResultsFolder(tmp_path), dense(1)
    play_motions(chosen, folder.learning("mujoco"), 1)
    other = chosen.model_copy(update={"seed": 8})
    with pytest.raises(ResultsError, match=r"is of another seed.*--fresh"):
        play_motions(other, folder.learning("mujoco"), 1)
    folder.discard_trials()
    play_motions(other, folder.learning("mujoco"), 1)
