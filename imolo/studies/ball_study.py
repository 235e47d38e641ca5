"""Rate ball models on a file of recorded flights, or on throws of a simulated backend."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from imolo.ball.csv_format import CsvFormat
from imolo.ball.evaluation import Evaluation, leave_one_out
from imolo.ball.flight_file import read_flights
from imolo.ball.model import KINDS, BallModelConfig, Kind
from imolo.campaigns.campaign import TrialTask, log_name, run_tasks
from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import ExperimentConfig
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import ConfigError, TrainingDataError, did_you_mean
from imolo.messaging.log import read_log
from imolo.trials.recordings import ball_flight

RECORDED_HORIZONS = (0.1, 0.2, 0.3, 0.4)  # [s] a ball from a launcher flies for half a second
SIMULATED_HORIZONS = (0.25, 0.50, 0.75)  # [s] Sec. VII-C
Progress = Callable[[str, int, int], object]


@dataclass(frozen=True)
class Study:
    """What is rated.

    Attributes:
        models: Kinds of ball model.
        horizons: Lead times [s].
    """

    models: tuple[Kind, ...]
    horizons: tuple[float, ...]

    def rate_recorded(self, path: Path, form: CsvFormat, jobs: int, progress: Progress) -> Evaluation:
        """Rate on a CSV file of flights.

        Args:
            path: The file.
            form: What is said about its units, axes, separators and decimals.
            jobs: Number of processes.
            progress: Told what is done.

        Raises:
            TrainingDataError: The file cannot be read, or holds too few flights.
        """
        recorded = read_flights(path, BallModelConfig().min_duration, form)
        return leave_one_out(
            str(path), recorded.flights, recorded.left_out, self._configs(), self.horizons, jobs, progress
        )

    def rate_simulated(
        self, config: ExperimentConfig, throws: int, folder: ResultsFolder, jobs: int, progress: Progress
    ) -> Evaluation:
        """Throw balls on a backend and rate on what its cameras saw; the logs stay in the folder.

        Raises:
            ImoloError: A trial failed, or too few of the throws can be used.
        """
        name = config.backend.name
        trials = [Trial(TrialKind.THROW, index, config.seed) for index in range(throws)]
        tasks = [TrialTask(config, trial, folder.learning(name) / log_name(trial)) for trial in trials]
        done = 0

        def count(_: TrialTask) -> None:
            nonlocal done
            done += 1
            progress(f"{name}: throws", done, throws)

        run_tasks(tasks, jobs, count)
        flights, left_out = {}, {}
        for task in tasks:
            try:
                flights[task.log_path.stem] = ball_flight(read_log(task.log_path))
            except TrainingDataError as error:
                left_out[task.log_path.stem] = str(error)
        return leave_one_out(
            f"{throws} throws in {name}", flights, left_out, self._configs(), self.horizons, jobs, progress
        )

    def _configs(self) -> list[BallModelConfig]:
        return [BallModelConfig(kind=kind) for kind in self.models]


def parse_models(text: str) -> tuple[Kind, ...]:
    """Return the kinds of ball model in a list with commas.

    Raises:
        ConfigError: One is unknown, or there is none.
    """
    names = dict.fromkeys(name.strip() for name in text.split(",") if name.strip())
    for name in names:
        if name not in KINDS:
            raise ConfigError(f"unknown ball model {name!r}{did_you_mean(name, KINDS)}; known: {', '.join(KINDS)}")
    if not names:
        raise ConfigError(f"no ball model is named; known: {', '.join(KINDS)}")
    return tuple(kind for kind in KINDS if kind in names)


def parse_horizons(text: str | None, recorded: bool) -> tuple[float, ...]:
    """Return the lead times [s] in a list with commas, in order, or the usual ones of recorded or simulated flights.

    Raises:
        ConfigError: One is no positive number, or there is none.
    """
    if text is None:
        return RECORDED_HORIZONS if recorded else SIMULATED_HORIZONS
    horizons = set()
    for part in filter(None, (part.strip() for part in text.split(","))):
        try:
            horizon = float(part)
        except ValueError:
            horizon = 0.0
        if not 0.0 < horizon < 60.0:
            raise ConfigError(f"the lead time {part!r} is no number between 0 and 60; give seconds, such as 0.1,0.2")
        horizons.add(horizon)
    if not horizons:
        raise ConfigError("no lead time is named; give seconds, such as --horizons 0.1,0.2")
    return tuple(sorted(horizons))
