"""The reference of the API: a page for each package, a section for each module, from the docstrings."""

import importlib
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path

from imolo.machine.files import write_whole

PACKAGES = ("imolo", "imolo_backends", "imolo_robots", "imolo_drivers")
# What the command line's own page holds, what is compiled or copied, and what wraps one engine, which may be missing.
LEFT_OUT = re.compile(
    r"\.__main__$|\.templates|(?<!\.method)\.commands$|_kernel$|\.(dart|drake|mujoco|ode|pybullet|sapien)_\w+$"
)


def modules() -> Iterator[str]:
    """Yield the names of all public modules and packages, imported."""
    for package in PACKAGES:
        yield package
        for found in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if not LEFT_OUT.search(found.name):
                # Not left to autodoc, which imports under TYPE_CHECKING, where our imports go in a circle.
                importlib.import_module(found.name)
                yield found.name


def write(folder: Path) -> None:
    """Write the pages to a folder, which holds no others then; two sites may be built from it at once."""
    pages: dict[str, list[str]] = {}
    for name in modules():
        is_package = hasattr(importlib.import_module(name), "__path__")
        package = name if is_package else name.rpartition(".")[0]
        directive = f"```{{eval-rst}}\n.. automodule:: {name}\n```\n"
        pages.setdefault(package, []).append(f"{'#' if is_package else '##'} {name}\n\n{directive}")
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.md"):
        if old.stem not in pages:
            old.unlink(missing_ok=True)
    for package, sections in pages.items():
        write_whole(folder / f"{package}.md", "\n".join(sections))
