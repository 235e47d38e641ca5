"""Runs checks in child processes: an engine that crashes or hangs costs the check under way and no other."""

import contextlib
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from imolo.conformance.check import Outcome, Verdict
from imolo.conformance.suite import Suite

TIME_LIMIT = 120.0  # [s] of one check; the longest of ours takes seconds
START_LIMIT = 120.0  # [s] until a child has loaded its engine and compiled the plant
CONTEXT = multiprocessing.get_context("spawn")

OnDone = Callable[[Suite, str], None]


def run_suites(
    suites: Sequence[Suite],
    only: Sequence[str] = (),
    jobs: int = 1,
    on_done: OnDone = lambda *_: None,
    time_limit: float = TIME_LIMIT,
) -> dict[str, list[Outcome]]:
    """Run the checks of several backends.

    Args:
        suites: What to check.
        only: Names of checks or groups; none for all.
        jobs: Number of child processes.
        on_done: Called after each check.
        time_limit: Of one check [s]; one that takes longer fails.

    Returns:
        The outcomes by the label of the suite, in the order of its checks.
    """
    schedule = _Schedule({suite.label: suite.select(only) for suite in suites})
    results: dict[str, dict[str, list[Outcome]]] = {suite.label: {} for suite in suites}
    by_label = {suite.label: suite for suite in suites}
    children: list[_Child] = []
    with tempfile.TemporaryDirectory(prefix="imolo-check-") as folder:
        try:
            while True:
                while len(children) < jobs and (label := schedule.next_suite([c.suite.label for c in children])):
                    children.append(_Child(by_label[label], Path(folder)))
                for child in [child for child in children if child.ready and not child.check]:
                    name = schedule.next_check(child.suite.label)
                    if name is None:
                        child.close()
                        children.remove(child)
                    else:
                        child.begin(name, time_limit)
                if not children and not schedule.left():
                    break
                _attend(children, schedule, results, on_done)
        finally:
            for child in children:
                child.kill()
    return {
        suite.label: [
            *(outcome for name in suite.select(only) for outcome in results[suite.label][name]),
            *(() if only else suite.misplaced()),
        ]
        for suite in suites
    }


def _attend(
    children: "list[_Child]",
    schedule: "_Schedule",
    results: dict[str, dict[str, list[Outcome]]],
    on_done: OnDone,
) -> None:
    """Wait until a child says something, dies or is late, and take note of it."""
    if not children:
        return
    first = max(min(child.deadline for child in children) - time.monotonic(), 0.0)
    talking = wait([child.connection for child in children], first)
    for child in list(children):
        label = child.suite.label
        problem = ""
        if child.connection in talking:
            try:
                outcomes = child.hear()
            except (EOFError, OSError):
                problem = child.death()
        elif time.monotonic() >= child.deadline:
            problem = f"took longer than {child.limit:g} s"
        else:
            continue
        if problem:
            child.kill()
            children.remove(child)
            # What cannot even be loaded is not tried again.
            failed = [child.check] if child.check else schedule.give_up(label)
            problem = problem if child.check else f"cannot be loaded: {problem}"
        elif outcomes is None:
            continue  # the child is ready
        else:
            failed = []
            results[label][child.check] = outcomes
            on_done(child.suite, child.check)
            child.check = ""
        for name in failed:
            check = child.suite.checks[name]
            results[label][name] = [Outcome(name, check.group, check.title, Verdict.FAIL, None, problem)]
            on_done(child.suite, name)


@dataclass
class _Schedule:
    """The checks that are still to run, by suite."""

    waiting: dict[str, list[str]]

    def left(self) -> bool:
        return any(self.waiting.values())

    def next_suite(self, busy: Sequence[str]) -> str | None:
        """Return the suite that a new child is for, one that no child works at before others."""
        # A child takes seconds to start; where it would be one more for a few checks, it is not worth it.
        open_ones = [label for label, names in self.waiting.items() if len(names) > (4 if label in busy else 0)]
        return min(open_ones, key=busy.count, default=None)

    def next_check(self, label: str) -> str | None:
        return self.waiting[label].pop(0) if self.waiting[label] else None

    def give_up(self, label: str) -> list[str]:
        given_up, self.waiting[label] = self.waiting[label], []
        return given_up


class _Child:
    """A process that runs checks of one suite, one after the other."""

    def __init__(self, suite: Suite, folder: Path) -> None:
        self.suite = suite
        self.check = ""  # under way
        self.ready = False
        self.limit = START_LIMIT
        self.deadline = time.monotonic() + self.limit
        handle, name = tempfile.mkstemp(dir=folder)
        os.close(handle)
        self._output = Path(name)
        self.connection, theirs = CONTEXT.Pipe()
        # The suite without what it has cached, which does not travel.
        plain = replace(suite)
        self._process: BaseProcess = CONTEXT.Process(target=_serve, args=(theirs, plain, self._output), daemon=True)
        with _interrupts_deferred():
            self._process.start()
        theirs.close()

    def begin(self, check: str, limit: float) -> None:
        self.check = check
        self.limit = limit
        self.deadline = time.monotonic() + limit
        with contextlib.suppress(OSError):  # a death is found out at the next wait
            self.connection.send(check)

    def hear(self) -> list[Outcome] | None:
        """Return the outcomes of the check under way, or None where the child has just become ready."""
        outcomes: list[Outcome] | None = self.connection.recv()
        self.ready = True
        # An idle child is given its next check before anything else is waited for.
        self.deadline = time.monotonic() + self.limit
        return outcomes

    def death(self) -> str:
        """Say how the process died, and what it said last."""
        self._process.join(10.0)
        code = self._process.exitcode
        if code is not None and code < 0:
            how = f"the process died with signal {-code} ({signal.Signals(-code).name})"
        else:
            how = f"the process ended with exit code {code}"
        said = self._output.read_text(errors="replace").strip()
        return f"{how}, after saying: {said.splitlines()[-1][:200]}" if said else how

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.connection.send(None)
        self._process.join(10.0)
        self.kill()

    def kill(self) -> None:
        self._process.kill()
        self._process.join()
        self.connection.close()


@contextlib.contextmanager
def _interrupts_deferred() -> Iterator[None]:
    """Start a child whole: Ctrl-C ends the parent afterwards, which then ends its children; these do not hear it."""
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield  # which is never interrupted
        return
    # The children inherit the mask. Python interrupts this thread also for a signal that another one has taken.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    if came:
        raise KeyboardInterrupt


def _serve(connection: Connection, suite: Suite, output: Path) -> None:
    said = os.open(output, os.O_WRONLY | os.O_APPEND)
    # What native code says would tear the report; its last line is shown where the process dies.
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
        os.dup2(said, stream.fileno())
    _ = suite.checks
    connection.send(None)
    while (name := connection.recv()) is not None:
        os.ftruncate(said, 0)
        connection.send(suite.run(name))
