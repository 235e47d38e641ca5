"""Trials that are already in the results folder: what makes one complete, and what it came from.

A trial writes its log under a name of its own and renames it when it has ended, so what bears a log's name is whole.
Beside each log lies what it came from; a log that came from anything else is never taken for one of this campaign.
"""

import hashlib
import os
import socket
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from imolo.campaigns.results import installed_versions
from imolo.errors import BusError, ResultsError
from imolo.messaging.log import LOG_SUFFIX

SOURCES = ("imolo", "imolo_backends", "imolo_drivers", "imolo_msgs")
THIS_MACHINE = "platform"


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
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    origin: dict[str, str]
    timing: TrialTiming


def kept(log_path: Path, origin: dict[str, str]) -> TrialTiming | None:
    """Return the timing of a complete trial of this origin, or None where there is none.

    Raises:
        ResultsError: There is a trial of another origin.
    """
    if not log_path.is_file():
        return None
    try:
        record = _Record.model_validate_json(_record_path(log_path).read_bytes())
    except (OSError, ValidationError):
        found: dict[str, str] = {}
    else:
        if record.origin == origin:
            return record.timing
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


def keep(partial: Path, log_path: Path, origin: dict[str, str], timing: TrialTiming) -> None:
    """Make a log complete.

    Raises:
        BusError: The folder cannot be written.
    """
    record = partial.with_suffix(".json.part")
    try:
        record.write_text(_Record(origin=origin, timing=timing).model_dump_json() + "\n", encoding="utf-8")
        # The log comes last and from the disk's point of view whole, so that a power failure leaves no half of it.
        for path, final in ((record, _record_path(log_path)), (partial, log_path)):
            with path.open("rb+") as file:
                os.fsync(file.fileno())
            path.replace(final)
    except OSError as error:
        raise BusError(f"cannot write the log {log_path}: {error}; choose a folder you may write to") from error


def set_aside(path: Path, log_path: Path) -> Path:
    """Move the log of a void trial to where nobody takes it for a whole one, and return where that is.

    Args:
        path: Where it was written.
        log_path: Where it would be if it were whole.
    """
    folder = log_path.parent / "void"
    folder.mkdir(exist_ok=True)
    number = len(list(folder.iterdir()))
    return path.rename(folder / f"{log_path.stem}_{number}{LOG_SUFFIX}")


def _record_path(log_path: Path) -> Path:
    return log_path.with_name(f"{log_path.name}.origin.json")


@lru_cache(maxsize=1)
def environment() -> dict[str, str]:
    """Return what shapes a log besides the config: the versions of all packages, and our own source."""
    versions = {name: version for name, version in installed_versions().items() if name != THIS_MACHINE}
    return versions | {"source": _digest_of_source()}


def _digest_of_source() -> str:
    """Return a hash of the code, which changes more often than the version does."""
    digest = hashlib.sha256()
    for package in SOURCES:
        spec = find_spec(package)
        for folder in spec.submodule_search_locations or () if spec else ():
            for path in sorted(path for kind in ("*.py", "*.urdf") for path in Path(folder).rglob(kind)):
                digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def file_digest(path: Path) -> str:
    """Return a hash of a file's content; of a missing one the empty text."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12] if path.is_file() else ""
