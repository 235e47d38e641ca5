"""Where `imolo` begins: what takes most of a second to import comes after Ctrl-C has been provided for."""

import os
import signal
import sys
from types import FrameType

SOON = 0.05  # [s]


def main() -> None:
    """Run the command line."""
    # Not an exception: whoever is being imported might swallow or print it.
    signal.signal(signal.SIGINT, _end)
    from imolo.command_line.main import main as run

    sys.unraisablehook = _interrupt_again
    signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


def _end(number: int, frame: FrameType | None) -> None:
    os._exit(130)  # as of a shell


def _interrupt_again(dropped: "sys.UnraisableHookArgs") -> None:
    """Repeat a Ctrl-C that came where Python drops what is raised, such as in a callback while it imports."""
    import threading

    main_thread = threading.main_thread().ident
    if not issubclass(dropped.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(dropped)
    elif main_thread is not None:
        threading.Timer(SOON, signal.pthread_kill, (main_thread, signal.SIGINT)).start()
