"""Does what was learned in one engine help in another? Tables of each engine play the same balls in every other one."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from imolo.campaigns.comparison import Progress, hit, learn
from imolo.campaigns.results import ResultsFolder, installed_versions
from imolo.config.experiment import ExperimentConfig, MethodConfig
from imolo.errors import ConfigError
from imolo.trials.learning import spread_motions
from imolo.trials.metrics import MethodResult, Statistic

Array = NDArray[np.float64]

DENSE = "dense"
ALONE = "alone"
ANOTHER_DAY = 1000  # added to the seed of the dense session, so that the trials do not meet its chance again


class Cell(BaseModel):
    """One table on one backend.

    Attributes:
        learned_in: Backend of the dense table; None for the trials alone.
        played_in: Backend that threw the balls.
        corrected: Whether the trials of `played_in` were learned upon the dense table.
        hits: Number of balls that were hit.
        balls: Number of balls.
        interval: Wilson 95 % interval of the hit rate.
        hand_error: Distance between the selected grid point and the hand when it was to be there [m].
    """

    model_config = ConfigDict(frozen=True)

    learned_in: str | None
    played_in: str
    corrected: bool
    hits: int
    balls: int
    interval: tuple[float, float]
    hand_error: Statistic

    @property
    def rate(self) -> float:
        """Hit rate [-]."""
        return self.hits / self.balls


class Transfer(BaseModel):
    """The transfer matrix.

    Attributes:
        seed: Of all chance; the dense tables were learned with `ANOTHER_DAY` more.
        motions: Number of motions of a dense table.
        trials: Number of trials on the backend that plays.
        versions: Of Python and the packages that were used.
        configs: Hash of the config by backend.
        cells: All tables on all backends.
    """

    model_config = ConfigDict(frozen=True)

    seed: int
    motions: int
    trials: int
    versions: dict[str, str]
    configs: dict[str, str]
    cells: tuple[Cell, ...]

    def cell(self, learned_in: str | None, played_in: str, corrected: bool) -> Cell | None:
        """Return one cell, or None if that was not played."""
        wanted = (learned_in, played_in, corrected)
        return next((c for c in self.cells if (c.learned_in, c.played_in, c.corrected) == wanted), None)


def transfer(
    configs: Sequence[ExperimentConfig],
    motions: int,
    folder: ResultsFolder,
    jobs: int,
    progress: Progress = lambda *_: None,
) -> Transfer:
    """Play all tables on all backends and write transfer.json.

    Args:
        configs: One per backend; their training motions are the trials on the backend that plays, their last method is
            the one that plays.
        motions: Number of motions of a dense table.
        folder: Where to write configs, logs, tables and numbers; the dense session goes to its folder "dense".
        jobs: Number of processes.
        progress: Told what is done.

    Raises:
        ConfigError: A backend is named twice.
        ImoloError: Something failed; what was recorded until then stays.
    """
    names = [config.backend.name for config in configs]
    if len(set(names)) != len(names):
        raise ConfigError(f"a backend is named twice: {', '.join(names)}")
    session = ResultsFolder(folder.path / DENSE)
    learn(
        [_dense(config, motions) for config in configs],
        session,
        jobs,
        lambda what, done, total: progress(f"{what}, {DENSE}", done, total),
    )
    priors = {name: session.table(name, DENSE) for name in names}
    trained = {
        config.backend.name: _with_methods(
            config,
            {
                ALONE: config.last_method,
                **{
                    corrected_name(name): _with_prior(config.last_method, str(path))
                    for name, path in priors.items()
                    if name != config.backend.name
                },
            },
        )
        for config in configs
    }
    learn(list(trained.values()), folder, jobs, progress)
    players = {
        name: _with_methods(
            config, {**config.methods, **{transferred_name(prior): config.methods[ALONE] for prior in names}}
        )
        for name, config in trained.items()
    }
    for config in players.values():
        folder.save_config(config)
    tables = {(name, made): folder.table(name, made) for name, config in trained.items() for made in config.methods}
    tables |= {(name, transferred_name(prior)): path for name in names for prior, path in priors.items()}
    results, _ = hit(players, tables, folder, jobs, progress)
    result = Transfer(
        seed=configs[0].seed,
        motions=motions,
        trials=len(configs[0].training.motions),
        versions=installed_versions(names),
        configs={name: config.digest() for name, config in players.items()},
        cells=tuple(
            cell
            for name in names
            for cell in (
                _cell(None, name, corrected=True, result=results[name][ALONE]),
                *(_cell(a, name, corrected=False, result=results[name][transferred_name(a)]) for a in names),
                *(_cell(a, name, corrected=True, result=results[name][corrected_name(a)]) for a in names if a != name),
            )
        ),
    )
    folder.save_json("transfer.json", result)
    return result


def transferred_name(learned_in: str) -> str:
    """Return the name of the method that plays with the dense table of a backend as it is."""
    return f"{learned_in}_as_it_is"


def corrected_name(learned_in: str) -> str:
    """Return the name of the method that plays with the dense table of a backend, corrected by the trials."""
    return f"{learned_in}_corrected"


def _dense(config: ExperimentConfig, motions: int) -> ExperimentConfig:
    other_day = config.model_copy(update={"seed": config.seed + ANOTHER_DAY})
    training = config.training.model_copy(update={"motions": spread_motions(other_day, motions)})
    return _with_methods(other_day.model_copy(update={"training": training}), {DENSE: config.last_method})


def _with_methods(config: ExperimentConfig, methods: dict[str, MethodConfig]) -> ExperimentConfig:
    return config.model_copy(update={"methods": methods})


def _with_prior(method: MethodConfig, path: str) -> MethodConfig:
    return method.model_copy(update={"forward_model": method.forward_model.model_copy(update={"prior": path})})


def _cell(learned_in: str | None, played_in: str, *, corrected: bool, result: MethodResult) -> Cell:
    return Cell(
        learned_in=learned_in,
        played_in=played_in,
        corrected=corrected,
        hits=result.hits,
        balls=result.balls,
        interval=result.interval,
        hand_error=result.hand_error,
    )
