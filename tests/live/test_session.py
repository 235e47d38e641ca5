"""Programs that come, go and are killed: the others say so, vent or wait, and go on; logs are whole to the end."""

import contextlib
import random
import re
import signal
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from live_table import Learned
from network import URL
from programs import Lab, lab

from imolo.contracts.trial import EventName
from imolo.live.backend_program import _next_index
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import Recorder, read_log
from imolo_msgs import trial_event_t

pytestmark = pytest.mark.usefixtures("network")

MANY = 100_000  # balls, more than a test waits for
LONGEST_LOSS = 0.5  # [s] before a kill that may be missing in a log: one heartbeat and the time to hear it


@pytest.fixture
def realtime(learned: Learned, tmp_path: Path) -> Iterator[Lab]:
    with lab(learned.config_path, learned.table_path, tmp_path, "realtime") as opened:
        yield opened


@pytest.fixture
def lockstep(learned: Learned, tmp_path: Path) -> Iterator[Lab]:
    with lab(learned.config_path, learned.table_path, tmp_path, "lockstep") as opened:
        yield opened


def write_ball(path: Path, *names: EventName) -> None:
    bus = Bus()
    with Recorder(bus, path, lambda: 0):
        for name in names:
            event = trial_event_t()
            event.event = name.value
            bus.publish(channels.TRIAL, event)
        bus.drain()


def test_session_goes_on_after_the_highest_number_of_whole_balls(tmp_path: Path) -> None:
    """By number, not by name: 1000 comes before 999 there; what somebody else put into the folder has no number."""
    assert _next_index(tmp_path) == 0
    for name in ("hit_009", "hit_999", "hit_1000", "hit_mine", "throw_2000"):
        write_ball(tmp_path / f"{name}.lcmlog", EventName.START, EventName.END)
    assert _next_index(tmp_path) == 1001
    write_ball(tmp_path / "hit_1001.lcmlog", EventName.START)
    assert _next_index(tmp_path) == 1001
    assert [path.name for path in (tmp_path / "void").iterdir()] == ["hit_1001_0.lcmlog"]
    assert _next_index(tmp_path) == 1001


def wait_for_event(bus: Bus, name: EventName) -> trial_event_t:
    found: list[trial_event_t] = []

    def hear(_: str, data: bytes) -> None:
        with contextlib.suppress(ValueError, struct.error):  # nonsense
            event = trial_event_t.decode(data)
            found.extend([event] if event.event == name else [])

    bus.subscribe_raw(hear, channels.TRIAL)
    deadline = time.monotonic() + 60.0
    while not found:
        assert time.monotonic() < deadline, f"no {name} on the bus"
        bus.wait(0.5)
    return found[0]


def test_robot_vents_when_its_planner_is_killed_in_motion(realtime: Lab) -> None:
    bus = Bus(URL)
    backend, planner = realtime.backend(), realtime.planner()
    throw = realtime.throw(1)
    wait_for_event(bus, EventName.ONSET)
    planner.kill()
    backend.wait_for(r"the planner has not answered a frame for 0\.\d s at [\d.]+ s; all channels are released")
    backend.wait_for(r"ball 0 is void, to be repeated: the planner has not answered")
    void = read_log(realtime.folder / "void/hit_000_0.lcmlog")
    vent = void.messages[channels.ACTUATOR_COMMAND][-1]
    assert np.array_equal(vent.target, np.zeros((1, 8)))
    assert vent.switch_utime[0] == vent.utime
    # The muscle that swings the arm was full; air needs a few 10 ms to leave.
    pressure = {message.utime: max(message.measured) for message in void.messages[channels.ACTUATOR_STATE]}
    before = max(value for utime, value in pressure.items() if utime <= vent.utime)
    assert pressure[max(pressure)] < 0.5 * before
    successor = realtime.planner()
    backend.wait_for(rf"planner {successor.pid} is here")
    backend.wait_for(r"ball 0: (touch|ball_landed)")
    assert throw.wait() == 0


@pytest.mark.slow
def test_planner_that_was_restarted_voids_the_trial_in_lock_step(lockstep: Lab) -> None:
    bus = Bus(URL)
    backend, planner = lockstep.backend(), lockstep.planner()
    throw = lockstep.throw(1)
    wait_for_event(bus, EventName.THROW)
    planner.kill()
    backend.wait_for(r"ball 0 is void, to be repeated: the planner was lost")
    (end,) = (
        event
        for event in read_log(lockstep.folder / "void/hit_000_0.lcmlog").messages[channels.TRIAL]
        if event.event == EventName.END
    )
    assert end.detail.endswith("; void: the planner was lost")
    lockstep.planner()
    backend.wait_for(r"ball 0: (touch|ball_landed)")
    assert throw.wait() == 0


@pytest.mark.slow
def test_mismatch_is_told_on_both_sides_and_nothing_moves(realtime: Lab, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(realtime.config.read_text() + "tracker: {detection_distance: 2.5}\n", encoding="utf-8")
    throw, planner = realtime.throw(1), realtime.planner()
    backend = realtime.start("backend", other, "--out", realtime.folder, "--bus", URL)
    why = r"is refused, nothing will move: its config differs in tracker; start both with the same config"
    backend.wait_for(rf"planner {planner.pid} {why}")
    planner.wait_for(rf"backend {backend.pid} {why}")
    throw.wait_for("waiting for a planner")
    assert (backend.stop(), planner.stop(), throw.stop()) == (0, 0, 1)
    assert not list(realtime.folder.rglob("hit*.lcmlog"))


@pytest.mark.slow
def test_second_planner_gives_way_in_one_line(lockstep: Lab) -> None:
    first = lockstep.planner()
    first.wait_for("method 'improved'")
    second = lockstep.planner()
    assert second.wait() == 2
    assert second.lines[-1].startswith(f"imolo: another planner {first.pid} is on this bus already; stop it")


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_session_of_one_command_stops_cleanly(realtime: Lab, number: signal.Signals) -> None:
    up = realtime.start(
        "up", realtime.config, "--table", realtime.table, "--balls", MANY, "--out", realtime.folder, "--bus", URL
    )
    children = [int(up.wait_for(rf"up: {role} (\d+) is here")[1]) for role in ("recorder", "backend")]
    up.wait_for(r"up: ball 0: ")
    up.wait_for(r"up: ball 1 is on its way")
    assert up.stop(number) == (130 if number == signal.SIGINT else 1)
    assert not any(Path(f"/proc/{pid}").exists() for pid in children)
    assert re.search(r"record: stopped; \d+ messages in \S+session.lcmlog", "".join(up.lines))
    ends = [event for event in read_log(realtime.session_log).messages[channels.TRIAL] if event.event == EventName.END]
    assert ends[-1].detail.endswith("void: stopped by the user")
    assert read_log(realtime.log(0)).messages[channels.PLAN]


@pytest.mark.slow
def test_programs_of_a_killed_session_end_by_themselves(lockstep: Lab) -> None:
    up = lockstep.start(
        "up",
        lockstep.config,
        "--table",
        lockstep.table,
        "--balls",
        MANY,
        "--clock",
        "lockstep",
        "--out",
        lockstep.folder,
        "--bus",
        URL,
    )
    up.wait_for(r"up: ball 0: ")
    # Its programs keep the pipe open, so what they say is still heard.
    up.process.kill()
    for _ in range(3):
        up.wait_for("imolo (planner|backend|record): stopped")
    assert {line.split(":")[0] for line in up.lines if ": stopped" in line} == {
        "imolo planner",
        "imolo backend",
        "imolo record",
    }


@pytest.mark.slow
def test_nonsense_on_the_bus_moves_nothing_and_stops_nobody(realtime: Lab) -> None:
    bus = Bus(URL)
    backend, planner = realtime.backend(), realtime.planner()
    throw = realtime.throw(1)
    for moment in (EventName.START, EventName.THROW, EventName.ONSET):
        wait_for_event(bus, moment)
        for channel in CHANNELS:
            bus.publish_raw(channel, b"nonsense")
            bus.publish_raw(channel, bytes(200))
    backend.wait_for(r"ball 0: (touch|ball_landed)")
    assert (throw.wait(), planner.stop(), backend.stop()) == (0, 0, 0)
    assert re.search(r"[1-9]\d* unreadable", planner.lines[-1])
    assert read_log(realtime.log(0)).messages[channels.ACTUATOR_COMMAND]


def whole_until(path: Path, moment: float) -> None:
    """Assert that a session log can be read, and holds what was heard before `moment` [s since the epoch]."""
    log = read_log(path)
    newest = max(max(times) for times in log.received.values() if times)
    assert moment - newest * 1e-6 < LONGEST_LOSS


def kill_at_random(lab: Lab, kills: int, rng: random.Random) -> None:
    """Kill any program at any moment, see that the others say so, and that the balls go on when it returns."""
    starters = {"backend": lab.backend, "planner": lab.planner, "recorder": lab.record}
    programs = {role: start() for role, start in starters.items()}
    throw = lab.throw(MANY)
    for number in range(kills):
        throw.wait_for(r"ball \d+: (touch|ball_landed)")
        role = list(starters)[number % 3] if kills <= 3 else rng.choice(list(starters))
        # A random moment of a trial of about a second.
        time.sleep(rng.uniform(0.0, 1.2))
        victim = programs[role]
        moment = time.time()
        victim.kill()
        for other, program in programs.items():
            if other != role:
                program.wait_for(rf"{role} {victim.pid} is lost: silent for \d\.\d s")
        if role == "recorder":
            whole_until(session_logs(lab)[-1], moment)
        returned = programs[role] = starters[role]()
        for other, program in programs.items():
            if other != role:
                program.wait_for(rf"{role} {returned.pid} is here")
    throw.wait_for(r"ball \d+: (touch|ball_landed)")
    assert throw.process.poll() is None
    for role in ("planner", "backend", "recorder"):
        assert programs[role].stop() == 0
    for path in session_logs(lab):
        assert read_log(path).messages[channels.HEARTBEAT]
    whole = sorted(lab.folder.glob("hit_*.lcmlog"))
    assert [path.name for path in whole] == [f"hit_{index:03d}.lcmlog" for index in range(len(whole))]
    for path in whole:
        assert [event.event for event in read_log(path).messages[channels.TRIAL]][-1] == EventName.END
    for path in (lab.folder / "void").glob("*.lcmlog"):
        read_log(path)


def session_logs(lab: Lab) -> list[Path]:
    return sorted(lab.folder.glob("session*.lcmlog"), key=lambda path: path.stat().st_mtime_ns)


def test_each_program_may_be_killed_and_return(realtime: Lab) -> None:
    kill_at_random(realtime, 3, random.Random(1))


@pytest.mark.slow
@pytest.mark.parametrize("clock", ["realtime", "lockstep"])
def test_any_program_may_be_killed_at_any_moment(learned: Learned, tmp_path: Path, clock: str) -> None:
    with lab(learned.config_path, learned.table_path, tmp_path, clock) as opened:
        kill_at_random(opened, 25, random.Random(2))
