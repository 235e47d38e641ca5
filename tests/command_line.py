"""What the tests of the command line share; the fixture `run` is in conftest.py."""

from collections.abc import Callable

Run = Callable[..., tuple[int, str, str]]  # arguments to exit code, output and errors
