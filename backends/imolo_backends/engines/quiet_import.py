"""Import a package whose C code writes to standard error when it is imported."""

import os
import sys
from importlib import import_module
from typing import Any

STANDARD_ERROR = 2  # file descriptor; C code does not know `sys.stderr`


def import_quietly(name: str) -> Any:
    """Return the module, and keep what is printed meanwhile off the terminal.

    Raises:
        ImportError: It is not installed.
    """
    sys.stderr.flush()
    kept = os.dup(STANDARD_ERROR)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, STANDARD_ERROR)
        return import_module(name)
    finally:
        os.dup2(kept, STANDARD_ERROR)
        os.close(kept)
        os.close(nowhere)
