"""What tests need that `make test` does not install: where it is missing they are skipped, saying how to get it.

`IMOLO_REQUIRE`, a comma-separated list of such things, makes them fail instead; `.ci/run` sets it. What is not listed
in `OPTIONAL` is always required, so that the matrix cannot shrink unseen.
"""

import os
import shutil
from ctypes.util import find_library
from importlib.util import find_spec

import pytest

from imolo.contracts.registry import BACKENDS


def _programs(package: str, *names: str) -> str:
    missing = [name for name in names if shutil.which(name) is None]
    return f"{', '.join(missing)} not found; apt-get install {package}" if missing else ""


def _libiio() -> str:
    if find_library("iio") is None:
        return "libiio not found; apt-get install libiio0"
    return "" if os.geteuid() == 0 else "to show devices that are not there needs root, for a mount namespace"


OPTIONAL = {
    "chromium": lambda: _programs("chromium", "chromium"),
    "ode": lambda: BACKENDS.status("ode").problem,
    "drake": lambda: BACKENDS.status("drake").problem,
    "sapien": lambda: BACKENDS.status("sapien").problem,
    "axe": lambda: "" if find_spec("axe_core_python") else "axe-core not found; pip install axe-core-python",
    "cc": lambda: _programs("gcc libc6-dev make", "gcc", "make"),
    "glib": lambda: "" if find_library("glib-2.0") else "libglib-2.0 not found; apt-get install libglib2.0-0",
    "jdk": lambda: _programs("default-jdk", "java", "javac", "jar"),
    "iio": _libiio,
    "display": lambda: _programs("xvfb xdotool", "Xvfb", "xdotool"),
    "netns": lambda: _programs("iproute2", "ip") or ("" if os.geteuid() == 0 else "network namespaces need root"),
}
"""By name: a function that says what is missing and how to get it; an empty text where nothing is."""

REQUIRED = {name.strip() for name in os.environ.get("IMOLO_REQUIRE", "").split(",")} - {""}
if unknown := REQUIRED - set(OPTIONAL):
    raise pytest.UsageError(f"IMOLO_REQUIRE names {sorted(unknown)}; known: {sorted(OPTIONAL)}")


def needs(*names: str) -> list[pytest.MarkDecorator]:
    """Return the marks of a test that needs these."""
    problems = [problem for name in names if name in OPTIONAL and name not in REQUIRED if (problem := OPTIONAL[name]())]
    return [pytest.mark.skip(reason="; ".join(problems))] if problems else []


BACKEND_NAMES = ("mujoco", "pybullet", "dart", "ode", "drake", "sapien")
BACKEND_PARAMS = [pytest.param(name, marks=needs(name)) for name in BACKEND_NAMES]
AVAILABLE = tuple(name for name in BACKEND_NAMES if not needs(name))
"""The backends of a test that runs several of them at once."""
