"""Any valid U is executed on every backend with the same switch times, and one planner with one table plays on each."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from liberobot import AIR, CHANNELS
from played_trials import COARSE, Commander, events, play, quiet
from requirements import AVAILABLE

from imolo.contracts.trial import EventName
from imolo.messaging.log import Log
from imolo.method.commands import Commands
from imolo_backends.actuators.pneumatics import Pneumatics

STEP = round(COARSE * 1e6)  # [µs]
DURATION = 0.06  # [s]
REST, RELEASED = (np.array(values) for values in zip(*((c.rest, c.released) for c in CHANNELS), strict=True))
# A command that answers the first frame, which is exposed after 8.3 ms, is received 5 ms of latency and a slice later.
EARLIEST = 15_000  # [µs]

pressures = st.lists(st.floats(0.0, AIR.supply_pressure), min_size=len(CHANNELS), max_size=len(CHANNELS))


@st.composite
def valid_commands(draw: st.DrawFn) -> Commands:
    """Draw a U of one to four phases, the shortest of a microsecond, that begins within the trial."""
    onset = draw(st.integers(EARLIEST, 30_000))
    lengths = draw(st.lists(st.integers(1, 15_000), min_size=1, max_size=4))
    switches = np.cumsum([onset, *lengths])[1:]
    return Commands(onset, tuple(switches.tolist()), np.array([draw(pressures) for _ in lengths]))


def executed(backend: str, commands: Commands) -> tuple[np.ndarray, Log]:
    """Run a trial under commands; return the valves' targets in each step [Pa], shape (N, 8), and the log."""
    targets: list[np.ndarray] = []

    class Watched(Pneumatics):
        def step(self, *motion: Any) -> None:
            targets.append(self.target.copy())
            super().step(*motion)

    message = commands.to_message(0, 1)
    with TemporaryDirectory() as folder, mock.patch("imolo_backends.actuators.pneumatics.Pneumatics", Watched):
        log = play(quiet(backend), Path(folder) / "log", Commander(lambda _: message), DURATION)
    return np.array(targets), log


@settings(max_examples=12, deadline=None)
@given(valid_commands())
def test_any_valid_commands_switch_at_the_same_times_on_every_backend(commands: Commands) -> None:
    """In the step from t on, every backend has the target of U at t, and it tells the onset on the first such step."""
    times = STEP * np.arange(round(DURATION / COARSE))
    in_motion = (times >= commands.onset_utime) & (times < commands.end_utime)
    expected = np.where((times < commands.onset_utime)[:, np.newaxis], REST, RELEASED)
    for step in np.flatnonzero(in_motion):
        expected[step] = commands.target(int(times[step]))
    for backend in AVAILABLE:
        targets, log = executed(backend, commands)
        assert np.array_equal(targets, expected), backend
        (onset,) = events(log, EventName.ONSET)
        assert onset.utime == times[times >= commands.onset_utime][0], backend
