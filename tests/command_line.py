"""What the tests of the command line share; the fixture `run` is in conftest.py."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

IMOLO = Path(sys.executable).with_name("imolo")
PATIENCE = 300.0  # [s]

Run = Callable[..., tuple[int, str, str]]  # arguments to exit code, output and errors


def is_one_line_about(errors: str, *parts: str) -> bool:
    return (
        errors.startswith("imolo: ")
        and errors.count("\n") == 1
        and errors.endswith("\n")
        and "Traceback" not in errors
        and all(part in errors for part in parts)
    )


def interrupt(folder: Path, is_time: Callable[[int], bool], *arguments: object) -> tuple[int, str]:
    """Run `imolo` in a folder and press Ctrl-C when it is time, which is asked with the process id.

    Returns:
        Exit code and errors.
    """
    process = subprocess.Popen(
        [IMOLO, *map(str, arguments)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A terminal sends Ctrl-C to the whole process group, the workers included.
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + PATIENCE
        while process.poll() is None and not is_time(process.pid) and time.monotonic() < deadline:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.02)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60.0)
    finally:
        process.kill()
    return process.returncode, errors
