"""Files that are read within bounds, and written whole or not at all."""

import atexit
import contextlib
import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import BinaryIO

TEMPORARY = ".*.tmp"
"""What a process that was killed leaves of a file it wrote."""


@cache
def process_folder() -> Path:
    """Return a folder that is gone when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="imolo-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def open_bounded(path: Path, most: int) -> BinaryIO:
    """Open a file that may be anything: a pipe, a device and too large a file are refused.

    Args:
        path: The file.
        most: Largest size [bytes].

    Raises:
        OSError: It cannot be read, is no regular file, or is larger; `strerror` says what is wrong.
    """
    # Without a writer the opening of a pipe would wait for ever.
    file = open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb")  # noqa: SIM115 (who calls it closes it)
    status = os.fstat(file.fileno())
    if not stat.S_ISREG(status.st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is a pipe or a device; give a file")
    if status.st_size > most:
        file.close()
        raise OSError(errno.EFBIG, f"it is larger than the {most / 1e6:g} MB that are read")
    return file


def read_bounded(path: Path, most: int) -> bytes:
    """Return the content of a file, see `open_bounded`.

    Raises:
        OSError: It cannot be read, is no regular file, or is larger.
    """
    with open_bounded(path, most) as file:
        return file.read(most)


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that takes its name when the block ends without an error and it is on the disk; until then what bore
    the name stays as it was.

    Args:
        path: Where to.

    Raises:
        OSError: It cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


def write_whole(path: Path, text: str) -> None:
    """Write a text as UTF-8, whole or not at all.

    Raises:
        OSError: It cannot be written.
    """
    with whole_file(path) as file:
        file.write(text.encode())
