"""How well a robot is found again: `python -m benchmarks.twins FOLDER [ROBOTS] [PAIR ...]`, such as `mujoco-dart`.

Settings are drawn in one engine, hidden, and its training motions recorded by the ordinary program with noise and
disturbance; another engine is fitted to these logs, and both play motions that no fit has seen. What was done is kept
in FOLDER, so that the same command goes on where it stopped.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import permutations, product
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from imolo.config.experiment import ExperimentConfig, ParallelConfig
from imolo.config.loading import body_of, make_config
from imolo.contracts.trial import Trial, TrialKind
from imolo.identification.evaluation import Bench
from imolo.identification.facts import ONSET, Motion, unseen_motions
from imolo.identification.facts_study import FactsStudy
from imolo.identification.parameters import ParameterConfig, apply, read_setting
from imolo.identification.robot_log_study import RobotLogStudy
from imolo.identification.robot_logs import repeatable
from imolo.identification.solve import interval
from imolo.identification.study import fit_parameters
from imolo.identification.study_file import load_study
from imolo.messaging.log import LOG_SUFFIX
from imolo.trials.trainer import START_MARGIN, MotionPlayer
from imolo.trials.trial import run_trial

ENGINES = ("mujoco", "pybullet", "dart")
STUDY = load_study(Path(__file__).parents[1] / "configs" / "studies" / "liberobot_paper.yaml")
assert isinstance(STUDY, FactsStudy)
ASSUMED = {key: STUDY.config[key] for key in ("robot", "simulation")}
"""Liberobot as it was first assumed, for truth and fit alike."""
UNSEEN = 40
AIR = (
    "tube_length",
    "supply_conductance",
    "exhaust_conductance",
    "valve_time_constant",
    "valve_dead_time",
    "dead_volume",
    "full_opening_error",
    "leg_coulomb_friction",
    "leg_viscous_friction",
    "arm_coulomb_friction",
    "arm_viscous_friction",
    "rest_pressure.7",
)
# By path: hidden values are drawn up to this factor above or below the default, evenly on a log scale.
HIDDEN = {f"simulation.actuators.{name}": 1.6 for name in AIR} | {
    "simulation.contact.friction": 1.3,
    "robot.links.trunk.mass": 1.15,
    "robot.links.trunk.center_of_mass.2": 1.15,
}
RANGES = {
    "robot.links.trunk.mass": ParameterConfig(range=(2.5, 5.0), scale="log"),
    "robot.links.trunk.center_of_mass.2": ParameterConfig(range=(0.1, 0.28)),
}


@dataclass(frozen=True)
class Found:
    """One setting: its hidden value, the one found, its 90 % interval, and what is said of it."""

    hidden: float
    value: float
    low: float
    high: float
    flags: Sequence[str]

    @property
    def covered(self) -> bool:
        """Whether the interval holds the hidden value."""
        return self.low <= self.hidden <= self.high

    @property
    def identified(self) -> bool:
        """Whether the fit claims to know it."""
        return "not identified" not in self.flags


@dataclass(frozen=True)
class Twin:
    """One hidden robot and its fit: distance of the hands on unseen motions before and after [m], and the settings."""

    truth: str
    fitted: str
    robot: int
    before: float
    after: float
    worst: float
    evaluations: int
    settings: Mapping[str, Found]


def hide(engine: str, robot: int, hidden: Mapping[str, float] = HIDDEN) -> tuple[ExperimentConfig, dict[str, float]]:
    """Return a config of an engine whose settings are drawn, and the settings."""
    config = make_config({**ASSUMED, "backend": {"name": engine}})
    chance = np.random.default_rng([robot, ENGINES.index(engine)])
    settings = {
        path: read_setting(config, path) * factor ** chance.uniform(-1.0, 1.0) for path, factor in hidden.items()
    }
    return apply(config, settings), settings


def record(config: ExperimentConfig, folder: Path, motions: int, seed: int) -> None:
    """Record training motions as `imolo learn` does."""
    for index, theta in enumerate(config.training.motions[:motions]):
        path = folder / f"training_{index:03d}{LOG_SUFFIX}"
        if not path.exists():
            duration = START_MARGIN + config.motion.swing_of(theta) + config.training.sampled_to
            trial = Trial(TrialKind.TRAINING, index, seed)
            run_trial(config, trial, MotionPlayer(config.motion, theta), path, duration)


def hands_apart(first: ExperimentConfig, second: ExperimentConfig, count: int) -> np.ndarray:
    """Return how far the hands are apart in the window in which they may hit, by unseen motion [m], shape (count,)."""
    apart = []
    label = body_of(first.robot).learning_marker
    times = next(iter(first.methods.values())).grid.time_since_swing.values()[::4]
    for theta in unseen_motions(first, count, seed=11):
        at = ONSET + first.motion.swing_of(theta) + times
        hands = []
        for config in (first, second):
            played = Motion(repeatable(config), theta).play()
            hands.append(CubicSpline(played.time, played.markers[label])(at))
        apart.append(float(np.linalg.norm(hands[0] - hands[1], axis=1).mean()))
    return np.array(apart)


def fit_twin(
    truth: str,
    fitted: str,
    robot: int,
    folder: Path,
    hidden: Mapping[str, float] = HIDDEN,
    motions: int = 15,
    unseen: int = UNSEEN,
    evaluations: int = 150,
    jobs: int = -1,
) -> Twin:
    """Hide a robot in one engine, and find it in another."""
    config, settings = hide(truth, robot, hidden)
    logs = folder / f"{truth}_{robot}"
    record(config, logs, motions, seed=robot)
    study = RobotLogStudy(
        kind="robot_logs",
        data=logs,
        engines=(fitted,),
        config=ASSUMED,
        parameters={path: RANGES.get(path, ParameterConfig()) for path in hidden},
        evaluations=evaluations,
        halve_timestep=False,
    )
    experiment = study.experiment(Path())
    start = experiment.configs[fitted]
    bench = Bench(experiment, folder / "evaluations", jobs, ParallelConfig(), lambda *_: None)
    _, parameters = study.parameters_of(start)
    fit = fit_parameters(study, bench, fitted, parameters, list(range(len(experiment.recordings))), "twin")
    before, after = (hands_apart(config, one, unseen) for one in (start, apply(start, fit.settings)))
    found = {
        one.path: Found(settings[one.path], fit.settings[one.path], *interval(one, fit), fit.flags[one.path])
        for one in parameters
    }
    worst = float(after.max())
    return Twin(truth, fitted, robot, float(before.mean()), float(after.mean()), worst, fit.evaluations, found)


def line(twin: Twin) -> str:
    """Return what is printed of a twin."""
    known = [one for one in twin.settings.values() if one.identified]
    return (
        f"{twin.truth:9}{twin.fitted:9}{twin.robot:6}{1e3 * twin.before:9.1f}{1e3 * twin.after:8.1f}"
        f"{1e3 * twin.worst:8.1f}{sum(one.covered for one in known):5}/{len(known):<3}"
        f"{sum(one.covered for one in twin.settings.values()):4}/{len(twin.settings):<4}{twin.evaluations:5}"
    )


def load(path: Path) -> Twin:
    """Read a twin that was kept."""
    content = json.loads(path.read_text())
    return Twin(**{**content, "settings": {path: Found(**one) for path, one in content["settings"].items()}})


def main(folder: Path, robots: int, pairs: Sequence[tuple[str, str]]) -> None:
    """Fit twins and print a table: hands apart on unseen motions [mm], and intervals that hold the hidden value."""
    print("truth    fitted    robot   before   after   worst  in/known   in/all  tried")
    twins = []
    for robot, (truth, fitted) in product(range(1, robots + 1), pairs):
        path = folder / f"{truth}_{fitted}_{robot}.json"
        if not path.exists():
            twin = fit_twin(truth, fitted, robot, folder)
            path.write_text(json.dumps(asdict(twin), indent=1))
        twins.append(load(path))
        print(line(twins[-1]), flush=True)
    every = [one for twin in twins for one in twin.settings.values()]
    known = [one for one in every if one.identified]
    print(
        f"{len(twins)} twins: hand {1e3 * np.mean([t.before for t in twins]):.1f} mm before, "
        f"{1e3 * np.mean([t.after for t in twins]):.1f} after; 90 % intervals hold {sum(o.covered for o in known)} of "
        f"{len(known)} values that are called identified, {sum(o.covered for o in every)} of all {len(every)}"
    )


if __name__ == "__main__":
    asked = [tuple(pair.split("-")) for pair in sys.argv[3:]] or list(permutations(ENGINES, 2))
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 5, asked)  # type: ignore[arg-type]
