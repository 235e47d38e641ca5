"""Import a package that writes to standard output when it is imported."""

import ctypes
import os
import sys
from importlib import import_module
from typing import Any


def import_quietly(name: str) -> Any:
    """Return the module, and keep what its C code prints meanwhile away from standard output.

    Raises:
        ImportError: It is not installed.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        return import_module(name)
    finally:
        ctypes.CDLL(None).fflush(None)  # C buffers what it prints into a pipe
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
