"""The robot as a backend, whose cameras fail as told: they stop, swap names, jump, or speak another language."""

import contextlib
import dataclasses
import logging
import math
import re
import select
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripted_robot import (
    BODY,
    NAMES,
    PATIENCE,
    Watched,
    backend,
    config,
    events,
    marker,
    memory_bus,
    play,
    player,
    scripted_robot,
    void,
)

from imolo.contracts.trial import EventName, Trial, TrialKind
from imolo.errors import BackendError, NatNetError, NatNetVersionError, TrialVoidError
from imolo.trials.trainer import START_MARGIN
from imolo_drivers import hardware_backend
from imolo_drivers.board.server import monotonic_utime
from imolo_drivers.natnet.config import NatNetConfig
from imolo_drivers.natnet.encoder import encode
from imolo_drivers.natnet.messages import Frame, LabelledMarker

Markers = list[LabelledMarker]


def test_stalled_cameras_are_reported_and_void_the_trial(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def stall(elapsed: float, markers: Markers) -> Markers | None:
        return markers if not 0.15 < elapsed < 10.0 else None

    with scripted_robot(stall) as robot, pytest.raises(TrialVoidError, match="no camera frame for "):
        play(config(robot, camera_patience=0.25), tmp_path / "log", player(), 1.0)
    assert "no camera frame for" in void(tmp_path / "log")
    # On a busy machine the robot of this test may have stalled before; that each is told once is tested below.
    reports = [record.message for record in caplog.records if "no camera frame" in record.message]
    silence = float(re.findall(r"for (\d+) ms", reports[-1])[0])
    assert silence >= round(1e3 * NatNetConfig().silence_limit)


class Cover:
    """Covers the cameras of a scripted robot, whose frames are sent by another thread."""

    def __init__(self) -> None:
        self._closed, self._withheld = threading.Event(), threading.Event()

    def __call__(self, _: float, markers: Markers) -> Markers | None:
        if not self._closed.is_set():
            return markers
        self._withheld.set()
        return None

    def close(self) -> None:
        """Return when every frame that is not withheld has been sent."""
        self._withheld.clear()
        self._closed.set()
        assert self._withheld.wait(PATIENCE)

    def open(self) -> None:
        self._closed.clear()


class VirtualTime:
    """A clock that only waiting moves, and that nothing interrupts."""

    def __init__(self) -> None:
        self.now = monotonic_utime()
        self.waits = 0

    def utime(self) -> int:
        return self.now

    def select(self, _reading: object, _writing: object, _failing: object, timeout: float) -> tuple[list[int], ...]:
        self.waits += 1
        assert self.waits < 1000, "the backend does not wait"
        self.now += math.ceil(timeout * 1e6)
        return [], [], []


@pytest.mark.parametrize("step", [1_000, 7_000, 10_000_000])
def test_lost_cameras_are_reported_at_the_limit_and_void_the_trial_at_the_end_of_patience(
    step: int, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long the backend is asked to wait: in virtual time it wakes up when it is due, to the microsecond."""
    cover = Cover()

    with scripted_robot(cover) as robot:
        one = backend(config(robot, camera_patience=0.25, exposures={"ahead": 1e6}))

        def go_on() -> None:
            while True:
                one.advance(one.utime + step)

        one.start(memory_bus(), Trial(TrialKind.THROW, 0, 1))
        cover.close()
        virtual = VirtualTime()
        virtual.now = one._begin  # however long the machine has taken since
        monkeypatch.setattr(hardware_backend, "monotonic_utime", virtual.utime)
        monkeypatch.setattr(hardware_backend, "select", virtual)
        one.advance(1000)  # what was on its way has come
        last = round(one._exposures.heard * 1e6)
        with contextlib.closing(one), pytest.raises(TrialVoidError, match="no camera frame for 250 ms"):
            go_on()
        (report,) = caplog.messages
        found = re.fullmatch(r"no camera frame for 35 ms at (\d+) us", report)
        assert found is not None
        told = one._begin + int(found[1])
        assert 0 <= told - last - 35_000 <= 2  # a rounded microsecond at each end
        assert 0 <= virtual.now - last - 250_000 <= 2


def test_every_stall_is_reported_once_and_the_trial_goes_on(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    cover = Cover()

    with scripted_robot(cover) as robot:
        one = backend(config(robot, board_silence=1e6, camera_patience=1e6, exposures={"ahead": 1e6}))
        one.start(memory_bus(), Trial(TrialKind.THROW, 0, 1))
        virtual = VirtualTime()
        virtual.now = one._begin
        monkeypatch.setattr(hardware_backend, "monotonic_utime", virtual.utime)
        monkeypatch.setattr(hardware_backend, "select", virtual)
        with contextlib.closing(one):
            for stalls in (1, 2):
                cover.close()
                for _ in range(50):
                    one.advance(one.utime + 7_000)
                assert [message.partition(" for ")[0] for message in caplog.messages] == ["no camera frame"] * stalls
                cover.open()
                last = one._exposures.heard
                while one._exposures.heard == last:
                    select.select([one._cameras.fileno()], [], [], PATIENCE)
                    one.advance(one.utime + 1_000)


class Swap:
    """Lets the two hands bear each other's name once it is told to."""

    def __init__(self) -> None:
        self.begun = threading.Event()

    def __call__(self, _: float, markers: Markers) -> Markers:
        if not self.begun.is_set():
            return markers
        other = {7: 8, 8: 7}
        return [
            dataclasses.replace(one, marker_id=other.get(one.marker_id, one.marker_id)) if one.model_id else one
            for one in markers
        ]


def test_markers_that_swap_their_names_get_them_back(caplog: pytest.LogCaptureFixture) -> None:
    assert (NAMES[6], NAMES[7]) == ("right_hand", "left_hand")
    swap = Swap()
    with scripted_robot(swap) as robot, contextlib.closing(Watched(robot)) as watched:
        watched.see(5)
        swap.begun.set()
        watched.advance_until(lambda: "their labels are corrected" in caplog.text)
        watched.see(20)
    for frame in watched.frames:
        seen = {m.marker_id: m.marker_position for m in frame.markers}
        assert np.allclose([seen[6], seen[7]], [BODY[6], BODY[7]], atol=1e-6)
    assert caplog.text.count("their labels are corrected") == 1


def test_marker_that_jumps_alone_is_left_out() -> None:
    begun, jumps = threading.Event(), iter([True])

    def jump(_: float, markers: Markers) -> Markers:
        if not (begun.is_set() and next(jumps, False)):
            return markers
        return [marker(1, 7, (1.5, 1.0, 0.3)) if (one.model_id, one.marker_id) == (1, 7) else one for one in markers]

    def hands() -> list[Any]:
        return [m.marker_position for f in watched.frames for m in f.markers if m.marker_id == 6]

    with scripted_robot(jump) as robot, contextlib.closing(Watched(robot)) as watched:
        watched.see(5)
        begun.set()
        watched.advance_until(lambda: len(hands()) < len(watched.frames))
        watched.see(20)
    assert np.allclose(hands(), BODY[6], atol=1e-6)
    assert len(hands()) == len(watched.frames) - 1


def test_a_wild_exposure_is_told_left_out_and_the_trial_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    wild = iter([1e6])  # however late it comes, that is what is told
    with scripted_robot() as robot, contextlib.closing(Watched(robot)) as watched:
        watched.see(5)
        robot.exposed = lambda due: due + next(wild, 0.0)
        watched.advance_until(lambda: "a camera frame was exposed 1e+06 s after it came, at " in caplog.text)
        watched.see(5)
    exposed = [frame.utime for frame in watched.frames]
    assert exposed == sorted(exposed)
    assert exposed[-1] < 60e6
    assert caplog.text.count("1e+06 s after it came") == 1


def test_exposures_that_stand_still_void_the_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    with scripted_robot() as robot:
        # One echo alone: the clocks of robot and backend run apart in virtual time.
        one = backend(config(robot, cameras={"echo_interval": 1e6}, board_silence=1e6))
        one.start(memory_bus(), Trial(TrialKind.THROW, 0, 1))
        still = time.monotonic()
        robot.exposed = lambda _: still

        def go_on(step: int, until: Callable[[], bool]) -> None:
            while not until():
                one.advance(one.utime + step)

        with contextlib.closing(one):
            go_on(1000, lambda: one._exposures.problem != "")
            virtual = VirtualTime()
            monkeypatch.setattr(hardware_backend, "monotonic_utime", virtual.utime)
            monkeypatch.setattr(hardware_backend, "select", virtual)
            with pytest.raises(TrialVoidError, match=r"no camera frame .* ms; a camera frame was exposed"):
                go_on(100_000_000, lambda: False)


def test_truncated_and_foreign_packets_are_passed_over(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    whole = encode(Frame(1, 0.0, 0, tuple(marker(1, n, (0, 0, 0)) for n in range(1, 5))), (4, 1))
    with scripted_robot() as robot:

        def disturb(utime: int) -> None:
            robot.packets += [whole[: utime % len(whole)], b"\x07\x00\xff\xff", bytes(5)]

        log = play(config(robot), tmp_path / "log", player(), START_MARGIN + 0.2, after_slice=disturb)
    assert events(log) == [EventName.START, EventName.ONSET, EventName.END]
    assert int(re.findall(r"(\d+) packets unreadable", caplog.text)[0]) > 0


# What does not begin.


def test_unknown_version_of_natnet_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with scripted_robot() as robot:
        info = dataclasses.replace(robot.motive._info, natnet_version=(5, 0))
        monkeypatch.setattr(robot.motive, "_info", info)
        with pytest.raises(NatNetVersionError, match=r"5\.0"):
            play(config(robot), tmp_path / "log", player())
        assert robot.server.board.state.name == "VENTED"


def test_no_cameras_are_told(tmp_path: Path) -> None:
    with scripted_robot() as robot, pytest.raises(BackendError, match=r"no frames from Motive at 127\.0\.0\.1:1 "):
        play(config(robot, patience=0.3, cameras={"command_port": 1}), tmp_path / "log", player())


def test_missing_asset_is_told(tmp_path: Path) -> None:
    with scripted_robot() as robot, pytest.raises(NatNetError, match="no asset 'robot'"):
        play(config(robot, cameras={"labels": {"asset": "robot"}}), tmp_path / "log", player())
