"""Where `imolo` begins: what takes most of a second to import comes after Ctrl-C has been provided for."""

import os
import signal
from types import FrameType


def main() -> None:
    """Run the command line."""
    # Not an exception: whoever is being imported might swallow or print it.
    signal.signal(signal.SIGINT, _end)
    from imolo.command_line.main import main as run

    signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


def _end(number: int, frame: FrameType | None) -> None:
    os._exit(130)  # as of a shell
