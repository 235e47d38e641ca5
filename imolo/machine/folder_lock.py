"""One program at a time in a folder."""

import fcntl
import os
import socket
from pathlib import Path

LOCK = ".lock"
_held: dict[Path, int] = {}


def claim_folder(path: Path) -> str:
    """Keep other programs out of a folder until this process ends, however it ends; claiming it again changes nothing.

    The kernel holds the lock and drops it with the process, on a file system that machines share too; the file only
    says who has it.

    Args:
        path: A folder that is there.

    Returns:
        Who has it, such as `process 12 on lab`; empty if it is this process.

    Raises:
        OSError: The folder cannot be written.
    """
    lock = path.resolve() / LOCK
    if lock in _held and lock.exists() and os.path.samestat(os.fstat(_held[lock]), lock.stat()):
        return ""
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        owner = os.read(descriptor, 200).decode(errors="replace").strip()
        os.close(descriptor)
        return owner or "another process"
    except OSError:
        # A file system without locks: this program is not kept from its work.
        os.close(descriptor)
        return ""
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
    _held[lock] = descriptor
    return ""
