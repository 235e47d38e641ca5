"""The starting files: those of `templates/`, under the name that was chosen."""

import keyword
import re
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from imolo.contracts.registry import BACKENDS, ROBOTS
from imolo.errors import ConfigError, ResultsError

PLACEHOLDERS = {"paddle": "robot", "wrapped": "engine"}
"""Names in the templates that the chosen one takes the place of, and the kind of template they are of."""


def write_files(kind: str, name: str, folder: Path) -> list[Path]:
    """Write the starting files of a robot or an engine, and return their paths.

    Args:
        kind: "robot" or "engine".
        name: Of the robot or engine, and of its package.
        folder: To make.

    Raises:
        ConfigError: The name is no Python name, or taken.
        ResultsError: The folder is there already, or cannot be written.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        raise ConfigError(f"{name!r} is no name for a Python package; give small letters, digits and _, such as my_arm")
    taken = ROBOTS.names() if kind == "robot" else BACKENDS.names()
    if name in taken:
        raise ConfigError(f"there is a {kind} {name!r} already; choose another name")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ResultsError(f"{folder} is there already; choose another --out")
    placeholder = next(word for word, of in PLACEHOLDERS.items() if of == kind)
    written: list[Path] = []
    try:
        _copy(files("imolo.scaffold") / "templates" / kind, folder, placeholder, name, written)
    except OSError as error:
        raise ResultsError(f"cannot write {folder}: {error.strerror}; choose another --out") from error
    return written


def _copy(source: Traversable, folder: Path, placeholder: str, name: str, written: list[Path]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for entry in sorted(source.iterdir(), key=lambda one: one.name):
        # What Python and the tools leave behind.
        if entry.name.startswith((".", "__pycache__")):
            continue
        target = folder / _named(entry.name, placeholder, name)
        if entry.is_dir():
            _copy(entry, target, placeholder, name, written)
        else:
            target.write_text(_named(entry.read_text(encoding="utf-8"), placeholder, name), encoding="utf-8")
            written.append(target)


def _named(text: str, placeholder: str, name: str) -> str:
    return text.replace(placeholder, name).replace(placeholder.upper(), name.upper())
