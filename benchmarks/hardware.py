"""The hardware side on loopback: how soon the board follows, switches and vents, and a campaign on the emulator."""

import contextlib
import logging
import multiprocessing
import re
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measurement import Measurement
from imolo.campaigns.campaign import TrialTask, hit_tasks, run_task
from imolo.config.loading import body_of, config_for, make_config
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.errors import TrialVoidError
from imolo.machine.priority import BACKEND_PRIORITY, claimed_priority
from imolo.messaging import channels
from imolo.messaging.log import Log, read_log
from imolo.trials.trial import Bystander, run_trial
from imolo_drivers import hardware_backend
from imolo_drivers.board.board import BoardState
from imolo_drivers.board.client import BoardClient
from imolo_drivers.board.command import make_command
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.handshake import ClientRole
from imolo_drivers.board.server import monotonic_utime
from imolo_drivers.emulator import MODEL_ID, definitions_of
from imolo_drivers.natnet.config import NatNetServerConfig
from imolo_drivers.natnet.messages import Frame, LabelledMarker
from imolo_drivers.natnet.server import NatNetServer
from imolo_msgs import board_state_t

NUM_VALVES = 8  # of the default robot

RATE = 120.0  # [Hz] of the commands, one per camera frame
PHASES = 40  # in a motion; each one has another pressure
PHASE = 20_000  # [µs]
ASKED_EVERY = 0.005  # [s]
MOTIONS = 10
IMOLO = (sys.executable, "-m", "imolo.command_line.main")
BALLS, MISSES = 20, 4
OLDEST = 0.05  # [s] frames come every 8.3 ms, 5 ms after their exposure
MOST_TRIALS = 3  # for each ball, on average
PATIENCE = 300.0  # [s]
STALLS, SEEN, STALLED = 50, 0.2, 0.15  # of the cameras: how many, and how long frames come and do not come [s]
MEDIAN, P99, SWITCH, LOST = 0.5, 2.0, 1.0, 50.0  # [ms] targets


@dataclass(frozen=True)
class Campaign:
    """What came of balls on the emulator.

    Attributes:
        balls: How many count.
        hits: Of these, by the cameras.
        hits_in_truth: Of these, by the emulator's own contacts.
        void: How many trials did not count.
    """

    balls: int
    hits: int
    hits_in_truth: int
    void: int


def play_campaign(folder: Path, table_path: Path, method: str, balls: int = BALLS) -> Campaign:
    """Hit balls as `backend: hardware`, through TCP and UDP, with MuJoCo behind `imolo emulate`.

    A machine that is busy with something else holds up emulator and planner, which no robot does. So a trial counts
    only if the newest frame that the planner knew was never exposed longer than `OLDEST` ago, whatever came of the
    ball; otherwise, or if the backend broke it off, it is void, and the ball is thrown again.
    """
    tasks: list[TrialTask] = []
    hits, trials = 0, 0
    with _emulator() as (options, said):
        config = make_config({"backend": {"name": "hardware", **options}})
        for task in hit_tasks(config, folder / "hardware", method, table_path)[:balls]:
            while trials < MOST_TRIALS * balls and task not in tasks:
                trials += 1
                with contextlib.suppress(TrialVoidError):
                    run_task(task)
                    log = read_log(task.log_path)
                    if _oldest_knowledge(log) <= OLDEST:
                        tasks.append(task)
                        hits += any(event.event == EventName.TOUCH for event in log.messages[channels.TRIAL])
    # A trial begins with its announcement; the last one of a ball is the one that counts.
    in_truth: dict[str, bool] = {}
    for line in said:
        if announced := re.search(r": (hit trial \d+),", line):
            trial = announced[1]
            in_truth[trial] = False
        elif f"in truth: {EventName.TOUCH}" in line:
            in_truth[trial] = True
    hits_in_truth = sum(in_truth[f"hit trial {task.trial.index}"] for task in tasks)
    return Campaign(len(tasks), hits, hits_in_truth, trials - len(tasks))


def run_campaign(folder: Path, table_path: Path, method: str) -> list[Measurement]:
    """Measure hits and misses of the planner on the emulator."""
    result = play_campaign(folder, table_path, method)
    subject = "robot emulated by MuJoCo"
    return [
        Measurement(subject, f"balls missed of {result.balls}", result.balls - result.hits, "", MISSES),
        Measurement(subject, "hits by the cameras less hits in truth", abs(result.hits - result.hits_in_truth), "", 0),
        Measurement(subject, "trials that were void, the machine having been busy", result.void, ""),
    ]


@contextlib.contextmanager
def _emulator() -> Iterator[tuple[dict[str, Any], list[str]]]:
    """Run `imolo emulate`; yields the options of the backend that reach it, and what it prints, whole at the end."""
    emulate = [*IMOLO, "emulate", "mujoco", "--armed", "--listen", "127.0.0.1:0", "--motive", "127.0.0.1:0"]
    said: list[str] = []
    with subprocess.Popen(emulate, stderr=subprocess.PIPE, text=True) as emulator:
        assert emulator.stderr is not None
        ports = re.findall(r"127\.0\.0\.1:(\d+)", emulator.stderr.readline())
        listener = threading.Thread(target=lambda: said.extend(emulator.stderr or ()))
        listener.start()
        try:
            yield {"board": f"127.0.0.1:{ports[0]}", "cameras": {"command_port": int(ports[1])}}, said
        finally:
            emulator.terminate()
            emulator.wait(PATIENCE)
            listener.join()


def _oldest_knowledge(log: Log) -> float:
    """Return how long ago the newest frame known was exposed, at the worst until the ball was hit or had landed [s]."""
    exposed = np.array([frame.utime for frame in log.messages[channels.MOCAP]])
    heard = np.array(log.received[channels.MOCAP])
    ends = [e.utime for e in log.messages[channels.TRIAL] if e.event in (EventName.TOUCH, EventName.BALL_LANDED)]
    age = (heard[1:] - exposed[:-1])[exposed[:-1] < min(ends, default=heard[-1])]
    return 1e-6 * float(age.max())


def run() -> list[Measurement]:
    """Run `imolo board` with simulated valves as a process of its own, and play motions at the rate of the cameras."""
    command = [*IMOLO, "board", "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as board:
        try:
            assert board.stderr is not None
            port = int(board.stderr.readline().partition("127.0.0.1:")[2].partition(",")[0])
            client = _armed(("127.0.0.1", port))
            accepted: list[float] = []
            switched: list[float] = []
            for number in range(MOTIONS):
                _play(client, 1000 * number, accepted, switched)
            vented = _stop_commanding(client, 1000 * MOTIONS)
        finally:
            board.terminate()
    median, p99 = np.percentile(accepted, (50.0, 99.0)).tolist()
    watchdog = 1e3 * BoardConfig().watchdog
    subject = "valve board, loopback"
    return [
        Measurement(subject, f"command sent to accepted, median of {len(accepted)}", median, "ms", MEDIAN),
        Measurement(subject, "command sent to accepted, 99th percentile", p99, "ms", P99),
        Measurement(
            subject, f"phase switched after its time, 99th percentile of {len(switched)}", _p99(switched), "ms"
        ),
        Measurement(subject, "phase switched after its time, worst", max(switched), "ms", SWITCH),
        Measurement(subject, "last command to vented, watchdog", vented, "ms", watchdog),
        Measurement(subject, "uncertainty of the clocks in these", 1e-3 * client.offset.uncertainty, "ms"),
    ]


def run_cameras(folder: Path) -> list[Measurement]:
    """Let the cameras stop again and again, and measure from the exposure of the last frame to the backend's report."""
    ours, theirs = multiprocessing.Pipe()
    cameras = multiprocessing.get_context("spawn").Process(target=_stalling_cameras, args=(theirs,))
    reports = _Reports()
    path = folder / "cameras.lcmlog"
    with subprocess.Popen([*IMOLO, "board", "--listen", "127.0.0.1:0"], stderr=subprocess.PIPE, text=True) as board:
        cameras.start()
        hardware_backend.logger.addHandler(reports)
        try:
            assert board.stderr is not None
            address = f"127.0.0.1:{board.stderr.readline().partition('127.0.0.1:')[2].partition(',')[0]}"
            options = {"board": address, "cameras": {"command_port": ours.recv()}, "camera_patience": 10.0}
            config = make_config({"backend": {"name": "hardware", **options}})
            with claimed_priority(BACKEND_PRIORITY):
                run_trial(config, Trial(TrialKind.THROW, 0, 1), Bystander(), path, STALLS * (SEEN + STALLED))
        finally:
            hardware_backend.logger.removeHandler(reports)
            cameras.terminate()
            board.terminate()
    frames = np.array([frame.utime for frame in read_log(path).messages[channels.MOCAP]])
    late = [1e-3 * (utime - frames[frames < utime].max()) for utime in reports.utimes if utime > frames[0]]
    subject = "lost camera stream"
    return [
        Measurement(subject, f"last exposure to report, median of {len(late)}", float(np.median(late)), "ms"),
        Measurement(subject, "last exposure to report, worst", max(late), "ms", LOST),
    ]


class _Reports(logging.Handler):
    """Keeps when the backend said that no frames come [µs]."""

    def __init__(self) -> None:
        super().__init__()
        self.utimes: list[int] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.getMessage().startswith("no camera frame"):
            self.utimes.append(record.args[-1])  # type: ignore[index, arg-type]


def _stalling_cameras(port: Connection) -> None:
    """Be a Motive that sends frames for a while, then none, and so on."""
    markers = tuple(LabelledMarker(MODEL_ID, number, (0.0, 0.5, 0.0)) for number in range(1, 13))
    with NatNetServer(
        NatNetServerConfig(command_port=0), definitions=definitions_of(body_of(config_for("mujoco").robot))
    ) as motive:
        port.send(motive.port)
        number, due = 0, time.monotonic()
        while True:
            select.select((motive,), (), (), max(due - time.monotonic(), 0.0))
            now = time.monotonic()
            motive.poll(now)
            if now >= due:
                number, due = number + 1, due + 1.0 / RATE
                if now % (SEEN + STALLED) < SEEN:
                    motive.send(Frame(number, now, motive.ticks(now), markers))


def _p99(values: list[float]) -> float:
    return float(np.percentile(values, 99.0))


def _armed(address: tuple[str, int]) -> BoardClient:
    client = BoardClient(address, ClientRole.CONTROLLER, "benchmark")
    operator = BoardClient(address, ClientRole.OPERATOR, "benchmark")
    operator.arm(operator.welcome.controller_session, "benchmark")
    client.synchronise(64)
    if client.state.board_state != BoardState.ARMED:
        raise RuntimeError("the board is not armed")
    operator.close()
    return client


def _play(client: BoardClient, sequence: int, accepted: list[float], switched: list[float]) -> None:
    """Play a motion, and note how late each command was accepted and each phase was switched [ms]."""
    onset = monotonic_utime() + client.offset.utime + 20_000
    switches = tuple(onset + PHASE * (phase + 1) for phase in range(PHASES))
    target = np.outer(np.arange(PHASES) % 2 + 1, np.full(NUM_VALVES, 1e5))
    sent: dict[int, int] = {}
    late: dict[int, int] = {}

    def note(state: board_state_t) -> None:
        if state.accepted_sequence in sent:
            accepted.append(1e-3 * (state.accepted_utime - client.offset.utime - sent.pop(state.accepted_sequence)))
        if state.phase_in_force:
            begin = (onset, *switches)[state.phase_in_force - 1]
            late[state.phase_in_force] = state.switched_utime - begin

    while monotonic_utime() + client.offset.utime < switches[-1]:
        sequence += 1
        message = make_command(sequence, onset, switches, target)
        sent[sequence] = monotonic_utime()
        client.command(message)
        end = time.monotonic() + 1.0 / RATE
        while (left := end - time.monotonic()) > 0.0:
            select.select((client.fileno(),), (), (), left)
            for state in client.poll():
                note(state)
    switched += [1e-3 * value for value in late.values()]


def _stop_commanding(client: BoardClient, sequence: int) -> float:
    """Command once, keep the link alive, and return how long the board took to vent [ms]."""
    onset = monotonic_utime() + client.offset.utime
    client.command(make_command(sequence + 1, onset, (onset + 1_000_000,), np.full((1, NUM_VALVES), 1e5)))
    accepted = 0
    while True:
        client.ask_time()
        end = time.monotonic() + ASKED_EVERY  # the board drops a link that asks as fast as it is answered
        while (left := end - time.monotonic()) > 0.0:
            select.select((client.fileno(),), (), (), left)
            for state in client.poll():
                if state.board_state != BoardState.ARMED:
                    return 1e-3 * (state.entered_utime - accepted)
                accepted = state.accepted_utime
