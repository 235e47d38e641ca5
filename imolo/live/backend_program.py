"""`imolo backend`: a body as a program of its own, which plays the trials it is asked for and is the clock of all."""

import contextlib
import gc
import tempfile
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from imolo.campaigns.campaign import log_name
from imolo.campaigns.kept_trials import set_aside
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import backend_plugin
from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.errors import BackendError, BusError, ConfigError, ResultsError, TrialVoidError
from imolo.live.identity import ClockMode, Identity, Role, shared_sections
from imolo.live.node import Node
from imolo.live.program import Console, Stop, run_node
from imolo.live.remote_planner import LockstepPlanner, RealtimePlanner
from imolo.machine.priority import BACKEND_PRIORITY, claim_priority
from imolo.messaging import channels
from imolo.messaging.bus import UNREADABLE, Bus
from imolo.messaging.log import read_log
from imolo.trials.trial import Bystander, run_trial
from imolo_msgs import throw_report_t, throw_request_t

WARM_UP = 0.02  # [s] of a trial in which everything is loaded and compiled


@dataclass
class _Request:
    """Throws that somebody asked for."""

    requester: int
    asked: int
    done: int = 0


class BackendProgram:
    """Plays trials on demand, each with a log of its own."""

    def __init__(
        self, config: ExperimentConfig, bus: Bus, clock: ClockMode, folder: Path, stop: Stop, console: Console
    ) -> None:
        """Load everything, then join the network.

        Raises:
            BackendError: The backend refuses the scene.
            ConfigError: A robot is to run in lock-step.
            ResultsError: The folder cannot be written.
        """
        # A trial has a bus of its own; the network hears what passes on it.
        self._config = config.model_copy(update={"bus": "memq://"})
        self._bus, self._folder, self._stop, self._console = bus, folder, stop, console
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResultsError(f"cannot write logs to {folder}: {error.strerror}; choose another --out") from error
        self._index = _next_index(folder)
        if self._simulated():
            self._warm_up()
        elif clock is ClockMode.LOCKSTEP:
            raise ConfigError(f"{config.backend.name!r} is a robot and waits for nobody; give --clock realtime")
        identity = Identity(Role.BACKEND, config.robot.name, clock.value, shared_sections(config))
        self._node = Node(bus, identity, console.say)
        planner = RealtimePlanner if clock is ClockMode.REALTIME else LockstepPlanner
        self._planner = planner(config, bus, self._node, stop, console)
        self._requests: dict[int, _Request] = {}
        self._open: deque[_Request] = deque()
        bus.subscribe_raw(self._on_request, channels.THROW_REQUEST)

    def run(self) -> None:
        """Play trials until stopped."""
        clock = claim_priority(BACKEND_PRIORITY) if self._planner.paced else "lock-step"
        self._console.say(f"{self._config.backend.name}, {clock}, logs in {self._folder}, next is ball {self._index}")
        run_node(self._node, self._bus.wait, self._stop, self._turn)
        self._console.say(f"stopped; {self._status()}")

    def _turn(self) -> None:
        planner = self._node.peer(Role.PLANNER)
        activity = "waiting for a planner" if planner is None else "ready"
        if activity != self._node.activity:
            self._node.activity = activity
            for request in self._open:
                self._report(request, activity)
        if self._open and planner is not None:
            self._play(self._open[0])
        self._console.status(self._status)

    def _status(self) -> str:
        planner = self._planner
        return (
            f"{self._node.activity} | {planner.describe()} | {planner.streams.describe()} | "
            f"frame to command {planner.latency}"
        )

    def _play(self, request: _Request) -> None:
        """Play the next trial, and keep it for later if it was broken off."""
        trial = Trial(TrialKind.HIT, self._index, self._config.seed)
        path = self._folder / log_name(trial)
        self._node.activity = f"ball {trial.index}"
        self._report(request, f"ball {trial.index} is on its way")
        try:
            with self._trial():
                run_trial(self._config, trial, self._planner, path, self._config.campaign.duration, self._after_slice)
                if self._planner.lost:
                    raise TrialVoidError(self._planner.lost)
        except TrialVoidError as void:
            kept = set_aside(path, path)
            repeated = "" if self._stop else ", to be repeated"
            self._tell(request, f"ball {trial.index} is void{repeated}: {void} (log: {kept})")
            return
        except BackendError as error:
            outcome = f"failed: {error}"
        else:
            outcome = self._planner.outcome or "the ball has not landed"
        self._index += 1
        request.done += 1
        if request.done == request.asked:
            self._open.popleft()
        self._tell(request, f"ball {trial.index}: {outcome}")

    @contextlib.contextmanager
    def _trial(self) -> Iterator[None]:
        self._planner.begin()
        # A collection takes longer than a slice; it can wait until the trial is over.
        gc.collect()
        gc.disable()
        try:
            yield
        finally:
            gc.enable()
            self._planner.leave()

    def _after_slice(self, utime: int) -> None:
        self._planner.after_slice(utime)
        self._console.status(self._status)

    def _tell(self, request: _Request, text: str) -> None:
        self._console.say(text)
        self._report(request, text)

    def _on_request(self, _: str, data: bytes) -> None:
        try:
            message = throw_request_t.decode(data)
        except UNREADABLE:
            self._bus.pass_over(channels.THROW_REQUEST)
            return
        request = self._requests.get(message.requester)
        if request is None:
            request = _Request(message.requester, max(message.num_throws, 0))
            self._requests[message.requester] = request
            if request.asked:
                self._open.append(request)
            self._console.say(f"asked for {request.asked} balls; {self._node.activity}")
        self._report(request, self._node.activity)

    def _report(self, request: _Request, text: str) -> None:
        report = throw_report_t()
        report.reporting_backend = self._node.instance
        report.reported_requester = request.requester
        report.throws_done, report.throws_asked = request.done, request.asked
        report.report = text
        self._bus.publish(channels.THROW_REPORT, report)

    def _simulated(self) -> bool:
        return backend_plugin(self._config).simulated

    def _warm_up(self) -> None:
        """Load and compile, so that neither the first heartbeats nor the first trial are late."""
        with tempfile.TemporaryDirectory() as folder:
            trial = Trial(TrialKind.HIT, 0, self._config.seed)
            run_trial(self._config, trial, Bystander(), Path(folder) / "warm_up.lcmlog", WARM_UP)
        gc.collect()
        gc.freeze()


def run_backend(
    config: ExperimentConfig, url: str, clock: ClockMode, folder: Path, stop: Stop, console: Console
) -> None:
    """Run the program.

    Raises:
        BackendError: The backend refuses the scene.
        BusError: The bus cannot be opened, or carries another backend.
        ResultsError: The folder cannot be written.
    """
    BackendProgram(config, Bus(url), clock, folder, stop, console).run()


def _next_index(folder: Path) -> int:
    """Return the index of the first ball after those that the folder holds, so that a restart continues.

    A log without an end is of a backend that was killed: it is set aside, and its ball thrown again.
    """
    logs = {
        int(number): path
        for path in folder.glob(f"{TrialKind.HIT.value}_*.lcmlog")
        if (number := path.stem.rpartition("_")[2]).isdecimal()
    }
    if logs and not _is_whole(logs[max(logs)]):
        last = logs.pop(max(logs))
        set_aside(last, last)
    return max(logs, default=-1) + 1


def _is_whole(path: Path) -> bool:
    try:
        events = read_log(path).messages[channels.TRIAL]
    except BusError:
        return False
    return any(event.event == EventName.END for event in events)
