"""A session over the network: how long a command takes, and whether real time keeps its pace on one core."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

from benchmarks.measurement import Measurement
from imolo.messaging import channels
from imolo.messaging.log import read_log

BALLS = 20
TIMESTEP = 2.5e-4  # [s]
MEDIAN, P99 = 0.6, 3.0  # [ms] targets
LATE = 0.1  # [%] target
PATIENCE = 300.0  # [s]
URL = "udpm://239.255.76.67:7667?ttl=0"


def obstacle() -> str:
    """Return why a session cannot be measured here; empty where it can."""
    if os.geteuid() != 0:
        return "not root, so no network namespace of its own"
    return "" if shutil.which("ip") else "no program ip (iproute2)"


def run(folder: Path, table_path: Path, method: str) -> list[Measurement]:
    """Throw balls in real time, the backend on one core, in a namespace made for it.

    Latency is taken twice. From the log of the recorder it is the time at which it heard a command less that at which
    it heard the frame that the command answers; a recorder that has to wait for a core hears both at once, so that this
    may be too short. The backend's own, from sending the frame to having the command, can only be too long: it is the
    one that must meet the target.

    All of it is measured twice as well: a virtual machine whose programs all wait gives its processors back, which come
    again late and with empty caches. With something to do that gives way to everything else they stay.
    """
    measurements = _measure(folder / "as_it_is", table_path, method, "live, two processes")
    with _awake():
        measurements += _measure(folder / "awake", table_path, method, "live, processors kept awake")
    return measurements


def _measure(folder: Path, table_path: Path, method: str, subject: str) -> list[Measurement]:
    folder.mkdir()
    config = folder / "live.yaml"
    config.write_text(yaml.safe_dump({"backend": {"name": "mujoco"}, "simulation": {"timestep": TIMESTEP}}))
    with _namespace(f"imolo-bench-{os.getpid()}") as inside:
        said = _session(inside, config, table_path, method, folder)
    latency = _latencies(folder / "session.lcmlog")
    median, p99 = np.percentile(1e3 * latency, (50.0, 99.0)).tolist()
    counts = re.search(
        r"backend: stopped.*late (\d+)/(\d+) frames, "
        r"(\d+)/(\d+) slices \(worst ([\d.]+) ms\), (\d+) heavy, busy (\d+) %",
        said,
    )
    own = re.search(r"backend: stopped.*frame to command ([\d.]+) ms median, ([\d.]+) ms p99", said)
    if counts is None or own is None:
        raise RuntimeError(f"the backend did not say how it kept its pace:\n{said}")
    late_frames, frames, late_slices, slices = (int(counts[number]) for number in range(1, 5))
    heavy, busy = int(counts[6]), int(counts[7])
    load = os.getloadavg()[0]
    return [
        Measurement(subject, "frame to command in the backend, median of the last 1000", float(own[1]), "ms", MEDIAN),
        Measurement(subject, "frame to command in the backend, 99th percentile", float(own[2]), "ms", P99),
        Measurement(subject, f"frame to command in the log, median of {len(latency)}", median, "ms"),
        Measurement(subject, "frame to command in the log, 99th percentile", p99, "ms"),
        Measurement(subject, f"late frames of {frames}, MuJoCo, one core", 100.0 * late_frames / frames, "%", LATE),
        Measurement(subject, f"late slices of {slices}", 100.0 * late_slices / slices, "%"),
        Measurement(subject, "worst delay of a slice", float(counts[5]), "ms"),
        Measurement(subject, "slices that it computed longer than they last", 100.0 * heavy / slices, "%"),
        Measurement(subject, "share of the core that it computes", float(busy), "%"),
        Measurement(subject, f"load of {os.cpu_count()} cores meanwhile", load, ""),
    ]


def _latencies(path: Path) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """Return the time from each frame to the first command that answers it [s]; trials use the same times again."""
    log = read_log(path)
    heard = [
        (when, channel, message.utime)
        for channel in (channels.MOCAP, channels.ACTUATOR_COMMAND)
        for when, message in zip(log.received[channel], log.messages[channel], strict=True)
    ]
    newest: dict[int, int] = {}
    latency = []
    for when, channel, utime in sorted(heard):
        if channel == channels.MOCAP:
            newest[utime] = when
        elif utime in newest:
            latency.append(1e-6 * (when - newest.pop(utime)))
    if not latency:
        raise RuntimeError(f"no command in {path}")
    return np.array(latency)


def _session(inside: list[str], config: Path, table_path: Path, method: str, out: Path) -> str:
    """Run backend (on the last core), planner and recorder, throw the balls; return what they printed."""
    imolo = [*inside, sys.executable, "-m", "imolo.command_line.main"]
    core = str(max(os.sched_getaffinity(0)))
    commands = (
        [*imolo, "record", "--out", out / "session.lcmlog", "--bus", URL],
        [*imolo, "planner", config, "--table", table_path, "--method", method, "--bus", URL],
        ["taskset", "-c", core, *imolo, "backend", config, "--clock", "realtime", "--out", out, "--bus", URL],
    )
    printed = out.with_suffix(".txt")
    with printed.open("w") as said:
        programs = [subprocess.Popen(list(map(str, command)), stderr=said) for command in commands]
        try:
            throw = [*imolo, "throw", BALLS, "--bus", URL]
            subprocess.run(list(map(str, throw)), stderr=subprocess.DEVNULL, timeout=PATIENCE, check=True)
        finally:
            for program in reversed(programs):
                program.send_signal(signal.SIGTERM)
                program.wait(30.0)
    return printed.read_text()


@contextlib.contextmanager
def _awake() -> Iterator[None]:
    """Keep every processor busy with what gives way to all other programs."""
    idle = "import os\nos.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\nwhile True: pass"
    programs = [subprocess.Popen([sys.executable, "-c", idle]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


@contextlib.contextmanager
def _namespace(name: str) -> Iterator[list[str]]:
    """Make a network that nothing leaves; yields what to put before a command to run it there."""
    subprocess.run(["ip", "netns", "add", name], check=True)
    inside = ["ip", "netns", "exec", name]
    try:
        recipe = "ip link set lo up; ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo"
        subprocess.run([*inside, "sh", "-c", recipe], check=True)
        yield inside
    finally:
        subprocess.run(["ip", "netns", "del", name], check=True)
