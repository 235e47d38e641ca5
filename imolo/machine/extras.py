"""Packages that only some commands need, each an extra of imolo."""

from importlib import import_module
from typing import Any

from imolo.errors import MissingToolError


def import_extra(module: str, extra: str) -> Any:
    """Import a module of an optional dependency.

    Raises:
        MissingToolError: It is not installed; the message says how to install it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingToolError(f"{error}; install it with: pip install 'imolo[{extra}]'") from error
