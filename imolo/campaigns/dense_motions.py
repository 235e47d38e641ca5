"""Many training motions in a simulation, without a bus or logs: what a dense prior is learned from."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from imolo.campaigns.campaign import Work, run_work
from imolo.campaigns.kept_trials import (
    TrialTiming,
    discard_partial,
    environment,
    keep,
    kept,
    partial_path,
    plugin_code,
    writing,
)
from imolo.campaigns.results import SAMPLES_SUFFIX
from imolo.config.experiment import ExperimentConfig
from imolo.contracts.trial import Trial, TrialKind
from imolo.method.forward_model import TrainingData
from imolo.trials.recordings import merge
from imolo.trials.rollout import sample_motion

MOTIONS_PER_FILE = 50  # some seconds of work: as much as is lost where a process ends


class _Block(Work):
    """Some of the training motions of a config, whose samples go to one file."""

    def __init__(self, config: ExperimentConfig, numbers: range, folder: Path, origin: dict[str, str]) -> None:
        self.config, self.numbers = config, numbers
        self.path = folder.absolute() / f"training_{numbers.start:05d}{SAMPLES_SUFFIX}"
        self.origin = origin | {"motions": f"{numbers.start} to {numbers.stop - 1}"}

    def __str__(self) -> str:
        return f"training motions {self.origin['motions']} on {self.config.backend.name}"

    def run(self) -> TrialTiming:
        """Play the motions and keep their samples."""
        begin = time.perf_counter()
        partial = partial_path(self.path)
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with partial.open("wb") as file:
                # One thread, so that the sums do not depend on the number of cores.
                with threadpool_limits(limits=1):
                    samples = merge([self._samples(number) for number in self.numbers])
                np.savez(file, theta=samples.theta, time=samples.time, position=samples.position)
            timing = TrialTiming(simulated=0.0, elapsed=time.perf_counter() - begin, decisions=())
            keep(partial, self.path, self.origin, timing)
        return timing

    def _samples(self, number: int) -> TrainingData:
        return sample_motion(self.config, Trial(TrialKind.TRAINING, number, self.config.seed))


def play_motions(
    config: ExperimentConfig, folder: Path, jobs: int, on_done: Callable[[int, int], object] = lambda *_: None
) -> list[Path]:
    """Play the training motions of a config where `campaign.parallel` says; those that are there are not played again.

    The samples depend neither on that nor on the number of processes: they are those of the logs of the same trials.

    Args:
        config: Of a simulated backend.
        folder: Where to write the samples.
        jobs: Number of processes, or -1 for one per core; a cluster has as many as it has.
        on_done: Told how many motions are done, and how many there are.

    Returns:
        The files of samples, in the order of the motions; see `read_samples`.

    Raises:
        ResultsError: Samples are there that are of another campaign.
        WorkerError: A process died each time, or the cluster cannot be used.
        ImoloError: A motion failed; the samples of others stay.
    """
    total = len(config.training.motions)
    origin = {"seed": str(config.seed), "config": config.digest(), **environment(), **plugin_code(config)}
    starts = range(0, total, MOTIONS_PER_FILE)
    blocks = [_Block(config, range(start, min(start + MOTIONS_PER_FILE, total)), folder, origin) for start in starts]
    left = [block for block in blocks if kept(block.path, block.origin) is None]
    for block in left:
        discard_partial(block.path)
    done = total - sum(len(block.numbers) for block in left)
    on_done(done, total)
    for number, _ in run_work(left, jobs):
        discard_partial(left[number].path)
        done += len(left[number].numbers)
        on_done(done, total)
    return [block.path for block in blocks]


def read_samples(paths: Sequence[Path]) -> TrainingData:
    """Return the samples of files that `play_motions` named."""
    samples = []
    for path in paths:
        with np.load(path, allow_pickle=False) as arrays:
            samples.append(TrainingData(arrays["theta"], arrays["time"], arrays["position"]))
    return merge(samples)
