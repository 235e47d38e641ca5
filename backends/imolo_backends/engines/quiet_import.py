"""Import packages whose C code writes to standard error when they are imported."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

STANDARD_ERROR = 2  # file descriptor; C code does not know `sys.stderr`


@contextmanager
def quiet_imports() -> Iterator[None]:
    """Keep what is printed meanwhile off the terminal."""
    sys.stderr.flush()
    kept = os.dup(STANDARD_ERROR)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, STANDARD_ERROR)
        yield
    finally:
        os.dup2(kept, STANDARD_ERROR)
        os.close(kept)
        os.close(nowhere)
