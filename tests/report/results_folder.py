"""A results folder made by hand: two backends, two methods, three balls; its trials are a second long."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import lcm
import yaml

from imolo.campaigns.comparison import Comparison, Timing, Timings
from imolo.campaigns.results import ResultsFolder
from imolo.config.experiment import PluginConfig
from imolo.config.loading import config_for
from imolo.messaging import channels
from imolo.report.page import write_report
from imolo.studies.transfer import Cell, Transfer
from imolo.trials.metrics import Statistic, TrialResult, judge_campaign, wilson_interval
from imolo_msgs import marker_t, mocap_frame_t, plan_t, trial_event_t, truth_ball_t, truth_robot_t

METHODS = ("paper", "improved")
BALLS = 3
END = 1_000_000  # [µs]


def make_results(path: Path, backends: Iterable[str] = ("alpha", "beta"), outcome: str = "hit") -> ResultsFolder:
    folder = ResultsFolder(path)
    folder.prepare()
    results: dict[str, Any] = {}
    digests = {}
    for backend in backends:
        # The page needs no backend, so theirs is none that is installed.
        config = config_for("mujoco").model_copy(update={"backend": PluginConfig(name=backend)})
        digests[backend] = config.digest()
        (path / "configs").mkdir(exist_ok=True)
        (path / "configs" / f"{backend}.yaml").write_text(yaml.safe_dump(config.model_dump(mode="json")))
        results[backend] = {
            method: judge_campaign([_trial(ball, outcome) for ball in range(BALLS)]) for method in METHODS
        }
        for method in METHODS:
            for ball in range(BALLS):
                write_log(folder.hits(backend, method) / f"hit_{ball:03d}.lcmlog", ball)
    speed = Timing(decision_median=2e-4, decision_p99=4e-4, real_time_factor=1.5)
    folder.save_json(
        "summary.json",
        Comparison(
            seed=7,
            versions={"python": "3.11"},
            configs=digests,
            results=results,
            disagreement={"alpha - beta": Statistic(mean=0.012, sd=0.003, count=15)},
        ),
    )
    folder.save_json("timing.json", Timings(timing={name: dict.fromkeys(METHODS, speed) for name in results}))
    folder.figures.mkdir(exist_ok=True)
    (folder.figures / "reach.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'/>")
    return folder


def _trial(ball: int, outcome: str) -> TrialResult:
    return TrialResult(
        trial=ball,
        hit=ball > 0,
        outcome=outcome if ball > 0 else "no motion found",
        theta=(0.1, 0.3) if ball > 0 else None,
        updates=ball,
        hand_error=0.0314 * ball if ball > 0 else None,
        prediction_error={"0.25": 0.0123 + 0.01 * ball},
    )


def write_log(path: Path, ball: int, truth: bool = True, effector: int = 0) -> None:
    """Write a trial in which the trunk rises 1 m, the ball comes 5 m nearer, and a plan is made at half the time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for utime in range(0, END + 1, 4000):
        share = utime / END
        if truth:
            robot = truth_robot_t()
            robot.utime, robot.base_position, robot.base_quaternion = utime, (0.0, 0.0, share), (1.0, 0.0, 0.0, 0.0)
            robot.effector_position = [(0.0, -0.16, share), (0.0, 0.16, share)]
            robot.num_effectors = len(robot.effector_position)
            flight = truth_ball_t()
            flight.utime, flight.true_ball_position = utime, (5.0 - 5.0 * share, 0.0, 1.5)
            log.write_event(utime, channels.TRUTH_ROBOT, robot.encode())
            log.write_event(utime, channels.TRUTH_BALL, flight.encode())
        if utime % 8000 == 0:
            log.write_event(utime, channels.MOCAP, _frame(utime, share).encode())
    log.write_event(END // 2, channels.PLAN, _plan(END // 2, effector).encode())
    for name, utime in (("start", 0), ("throw", 100_000), ("touch", 900_000), ("end", END)):
        event = trial_event_t()
        event.utime, event.event, event.robot, event.trial = utime, name, "liberobot", ball
        log.write_event(utime, channels.TRIAL, event.encode())
    log.close()


def _frame(utime: int, share: float) -> mocap_frame_t:
    frame = mocap_frame_t()
    frame.utime = utime
    for label, position in (
        (6, (0.0, -0.16, share)),
        (7, (0.0, 0.16, share)),
        (marker_t.UNLABELLED, (5.0 - 5.0 * share, 0.0, 1.5)),
    ):
        marker = marker_t()
        marker.marker_id, marker.marker_position = label, position
        frame.markers.append(marker)
    frame.num_markers = len(frame.markers)
    return frame


def _plan(utime: int, effector: int) -> plan_t:
    plan = plan_t()
    plan.utime, plan.state, plan.plan_onset_utime, plan.target_position = utime, plan_t.STARTED, utime, (1.0, -0.2, 1.6)
    plan.prediction_step, plan.effector = 0.01, effector
    # The last of these are below the floor.
    plan.predicted_position = [(2.0, 0.0, 1.5 - 0.02 * i) for i in range(90)]
    plan.num_predictions = len(plan.predicted_position)
    return plan


def study_page(path: Path) -> Path:
    """Write the report of a folder that holds a study and nothing else."""
    alone = path / "alone"
    alone.mkdir()
    cell = Cell(
        learned_in="alpha",
        played_in="alpha",
        corrected=False,
        hits=17,
        balls=20,
        interval=wilson_interval(17, 20),
        hand_error=Statistic.of([0.010, 0.014]),
    )
    result = Transfer(seed=1, motions=200, trials=15, versions={}, configs={}, cells=(cell,))
    (alone / "transfer.json").write_text(result.model_dump_json())
    return write_report(alone, path / "report.html").path
