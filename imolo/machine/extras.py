"""Packages that only some commands and plug-ins need, each in an extra of its distribution, and how to get them."""

import platform
import re
from collections.abc import Iterable
from importlib import import_module
from importlib.metadata import requires
from typing import Any

from packaging.requirements import Requirement

from imolo.errors import MissingToolError


def import_extra(module: str, extra: str) -> Any:
    """Import a module of an optional dependency.

    Raises:
        MissingToolError: It is not installed; the message says how to install it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingToolError(f"{error}; {how_to_install(extra, requires('imolo') or ())}") from error


def how_to_install(extra: str, requirements: Iterable[str]) -> str:
    """Return the command that brings the packages of an extra, wherever its distribution itself came from.

    Args:
        extra: Its name.
        requirements: Those of the distribution, as its metadata have them.

    Returns:
        The command; what the packages need, where none is for this Python or system; empty if there is no such extra.
    """
    conditions: list[str] = []
    packages: list[str] = []
    asked = f'extra == "{extra}"'
    for requirement in map(Requirement, requirements):
        marker, requirement.marker = requirement.marker, None
        if marker is None or asked not in str(marker):
            continue
        if marker.evaluate({"extra": extra}):
            packages.append(f'"{requirement}"')
        else:
            needed = re.sub(f"{asked} and | and {asked}", "", str(marker)).strip("()")
            needed = needed.replace("python_version", "Python").replace('"', "")
            conditions.append(f"{requirement.name} needs {needed}")
    if packages:
        return f"install it with: pip install {' '.join(packages)}"
    here = f"this is Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    return f"{', '.join(conditions)}; {here}" if conditions else ""
