"""Trials that are already in the results folder: what makes one complete, and what it came from.

A trial writes its log under a name of its own and renames it when it has ended, so what bears a log's name is whole.
Beside each log lies what it came from; a log that came from anything else is never taken for one of this campaign.
"""

import contextlib
import errno
import hashlib
import logging
import os
import socket
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from imolo.campaigns.results import installed_versions
from imolo.config.experiment import ExperimentConfig
from imolo.contracts.provenance import digest_of_packages, provenance
from imolo.contracts.registry import BACKENDS, PLANNERS, ROBOTS, TASKS
from imolo.contracts.trial import EventName
from imolo.errors import BusError, ResultsError
from imolo.machine.files import read_bounded, write_whole
from imolo.messaging.channels import TRIAL
from imolo.messaging.log import LOG_SUFFIX, decode
from imolo.messaging.log_file import LogReader

logger = logging.getLogger(__name__)

SOURCES = ("imolo", "imolo_backends", "imolo_drivers", "imolo_msgs", "imolo_robots")
THIS_MACHINE = "platform"
MOST_BYTES = 10_000_000  # of what stands beside a log; some 20 per decision


class TrialTiming(BaseModel):
    """How long a trial took; beside the log, since a log holds nothing that depends on the machine.

    Attributes:
        simulated: Simulated time [s].
        elapsed: Real time [s].
        decisions: Real time of each planner decision, mocap message in, command out [s].
    """

    model_config = ConfigDict(frozen=True)

    simulated: float
    elapsed: float
    decisions: tuple[float, ...]


class _Record(BaseModel):
    """Stands beside a log.

    Attributes:
        origin: All that shapes the log, by what it is.
        timing: How long the trial took.
        size: Of the log [bytes].
        digest: Hash of the log.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    origin: dict[str, str]
    timing: TrialTiming
    size: int
    digest: str


def kept(log_path: Path, origin: dict[str, str]) -> TrialTiming | None:
    """Return the timing of a complete trial of this origin, or None where there is none, or its log was damaged since.

    Raises:
        ResultsError: There is a trial of another origin.
    """
    if not log_path.is_file():
        return None
    try:
        record = _Record.model_validate_json(read_bounded(_record_path(log_path), MOST_BYTES))
    except (OSError, ValidationError):
        found: dict[str, str] = {}
    else:
        if record.origin == origin:
            if log_path.stat().st_size == record.size and file_digest(log_path) == record.digest:
                return record.timing
            logger.warning("%s is not as it was written, its trial is run again", log_path)
            return None
        found = record.origin
    different = [key for key in origin if found.get(key) != origin[key]] or sorted(set(found) - set(origin))
    what = f"of another {', '.join(different)}" if found else "of unknown origin"
    raise ResultsError(
        f"{log_path} is {what}; give another --out, or --fresh to delete the trials that are there and start anew"
    )


def partial_path(log_path: Path) -> Path:
    """Return where this process writes a log that is not complete yet; no other process writes there."""
    return log_path.with_name(f"{log_path.name}.{socket.gethostname()}-{os.getpid()}.part")


def partial_paths(log_path: Path) -> list[Path]:
    """Return what trials that were broken off have left of a log."""
    return list(log_path.parent.glob(f"{log_path.name}.*.part"))


def discard_partial(log_path: Path) -> None:
    """Delete what trials that were broken off have left of a log."""
    for path in partial_paths(log_path):
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def writing(log_path: Path) -> Iterator[None]:
    """Tell in one line what keeps a log from being written.

    Raises:
        BusError: Something does.
    """
    try:
        yield
    except OSError as error:
        raise BusError(
            f"cannot write the log {log_path}: {error.strerror or error}; make room or choose a folder you may write to"
        ) from error


def keep(partial: Path, log_path: Path, origin: dict[str, str], timing: TrialTiming) -> None:
    """Make a log complete, or another file of a trial.

    Raises:
        OSError: The log is cut off, or the folder cannot be written.
    """
    if log_path.suffix == LOG_SUFFIX:
        _check_end(partial)
    # The log comes last and from the disk's point of view whole, so that a power failure leaves no half of it.
    with partial.open("rb+") as file:
        os.fsync(file.fileno())
    record = _Record(origin=origin, timing=timing, size=partial.stat().st_size, digest=file_digest(partial))
    write_whole(_record_path(log_path), record.model_dump_json() + "\n")
    partial.replace(log_path)


def _check_end(partial: Path) -> None:
    """Refuse a log whose last bytes found no room: LCM's writer does not tell.

    Raises:
        OSError: The log does not end with the end of a trial.
    """
    last = None
    with LogReader(partial, with_data=(TRIAL,), quiet=True) as reader:
        for event in reader:
            if event.channel == TRIAL:
                last = decode(TRIAL, event.data)
    if reader.damage or last is None or last.event != EventName.END:
        raise OSError(errno.ENOSPC, "it is cut off, the disk may be full")


def set_aside(path: Path, log_path: Path) -> Path:
    """Move the log of a void trial to where nobody takes it for a whole one, and return where that is.

    Args:
        path: Where it was written.
        log_path: Where it would be if it were whole.
    """
    folder = log_path.parent / "void"
    folder.mkdir(exist_ok=True)
    numbers = [path.stem.rpartition("_")[2] for path in folder.glob(f"*{LOG_SUFFIX}")]
    there = [int(number) for number in numbers if number.isdecimal()]
    # Counted beside it, so that a number is not given again after logs were moved away from `void`.
    counter = log_path.parent / ".void_logs"
    with contextlib.suppress(OSError, ValueError):
        there.append(int(read_bounded(counter, 100)))
    number = max(there, default=-1) + 1
    with contextlib.suppress(OSError):
        write_whole(counter, f"{number}\n")
    return path.rename(folder / f"{log_path.stem}_{number}{LOG_SUFFIX}")


def _record_path(log_path: Path) -> Path:
    return log_path.with_name(f"{log_path.name}.origin.json")


@lru_cache(maxsize=1)
def environment() -> dict[str, str]:
    """Return what shapes a log besides the config: all packages, our own source, and how the processor computes."""
    versions = {name: version for name, version in installed_versions().items() if name != THIS_MACHINE}
    return versions | {"source": digest_of_packages(*SOURCES)}


def plugin_code(config: ExperimentConfig) -> dict[str, str]:
    """Return what the plug-ins are that a config names."""
    named = {
        "backend": (BACKENDS.group, [config.backend.name]),
        "robot": (ROBOTS.group, [config.robot.name]),
        "task": (TASKS.group, [config.task.name]),
        "planner": (PLANNERS.group, sorted({method.controller.name for method in config.methods.values()})),
    }
    return {
        f"{kind} code": ", ".join(str(provenance(group, name)) for name in names)
        for kind, (group, names) in named.items()
    }


def file_digest(path: Path) -> str:
    """Return a hash of a file's content; of a missing one the empty text."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12] if path.is_file() else ""
