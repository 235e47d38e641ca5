"""The secret that board and clients share: whoever knows it may move the robot."""

import os
import stat
from pathlib import Path

from imolo.errors import ConfigError

SHORTEST, LONGEST = 16, 4096  # [bytes]


def read_secret(path: Path) -> bytes:
    """Return what a file holds, less the white space around it.

    Raises:
        ConfigError: It cannot be read, others may read it, or it is too short to be one.
    """
    try:
        # A pipe would block until somebody writes to it.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise ConfigError(f"cannot read the secret {path}: {error.strerror}; see docs/hardware.md") from error
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise ConfigError(f"the secret {path} is no file")
        if status.st_mode & 0o077:
            mode = stat.S_IMODE(status.st_mode)
            raise ConfigError(f"others may read the secret {path} (mode {mode:04o}); `chmod 600 {path}`")
        if status.st_uid not in (os.geteuid(), 0):
            raise ConfigError(f"the secret {path} belongs to another user; `chown` it")
        secret = file.read(LONGEST + 1).strip()
    if not SHORTEST <= len(secret) <= LONGEST:
        raise ConfigError(
            f"the secret {path} holds {len(secret)} bytes; give {SHORTEST} to {LONGEST}, see docs/hardware.md"
        )
    return secret
