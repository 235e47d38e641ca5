"""Where results come from: the code of a plug-in, the packages, and how the processor computes."""

import hashlib
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import Distribution, entry_points
from importlib.util import find_spec
from pathlib import Path

import llvmlite.binding
import numba.core.config
import scipy.linalg  # noqa: F401 (loads the libraries that are looked at)
from threadpoolctl import threadpool_info

DIGITS = 12  # of a hash


@dataclass(frozen=True)
class Provenance:
    """What a plug-in was.

    Attributes:
        distribution: Name of the distribution that brings it; empty where none says so.
        version: Of the distribution.
        source: Hash of all files of its package, and of the other packages of its distribution.
    """

    distribution: str
    version: str
    source: str

    def __str__(self) -> str:
        return f"{self.distribution or 'no distribution'} {self.version} source {self.source}"


@lru_cache
def provenance(group: str, name: str) -> Provenance:
    """Return where a plug-in comes from.

    Args:
        group: Of entry points, such as `imolo.backends`.
        name: Of the entry point.

    Raises:
        KeyError: There is no such entry point.
    """
    entry_point = entry_points(group=group)[name]
    distribution = entry_point.dist
    return Provenance(
        distribution=distribution.name if distribution else "",
        version=distribution.version if distribution else "",
        source=digest_of_packages(*sorted({_package(entry_point.module), *_packages(distribution)})),
    )


@lru_cache
def digest_of_packages(*names: str) -> str:
    """Return a hash of all files of some packages or modules, which change more often than versions do."""
    digest = hashlib.sha256()
    for name in names:
        spec = find_spec(name)
        folders = [Path(folder) for folder in spec.submodule_search_locations or ()] if spec else []
        files = [(path.relative_to(folder), path) for folder in folders for path in folder.rglob("*")]
        if spec and spec.origin and not folders:
            files = [(Path(spec.origin).name, Path(spec.origin))]  # type: ignore[list-item]
        for label, path in sorted(files):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(f"{label}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:DIGITS]


def _package(module: str) -> str:
    """Return the outermost package of a module that is not spread over several distributions."""
    parts = module.split(".")
    for count in range(1, len(parts)):
        spec = find_spec(".".join(parts[:count]))
        if spec is None or spec.origin is not None:
            return ".".join(parts[:count])
    return module


def _packages(distribution: Distribution | None) -> Iterator[str]:
    """Yield the outermost packages and modules that a distribution says it installs."""
    if distribution is None:
        return
    # An editable installation lists no files of its packages.
    listed = (distribution.read_text("top_level.txt") or "").split()
    for name in (*listed, *(file.parts[0].partition(".")[0] for file in distribution.files or ())):
        if name.isidentifier() and not name.startswith("__"):
            yield name


def commit() -> str:
    """Return which commit our code is, with `-dirty` where it was changed since; empty where it is in no repository."""
    command = ("git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


@lru_cache
def arithmetic() -> dict[str, str]:
    """Return what decides the last digits: the kernel of the linear algebra, and what the compiler compiles for."""
    return {"blas": _blas(), "processor": numba.core.config.CPU_NAME or llvmlite.binding.get_host_cpu_name()}


def _blas() -> str:
    libraries = [library for library in threadpool_info() if library["user_api"] == "blas"]
    # An engine may bring its own, which is part of that engine; the numpy of a system brings none.
    ours = [one for one in libraries if {"numpy.libs", "scipy.libs"} & set(Path(one["filepath"]).parts)]
    kernels = {f"{one['internal_api']} {one['version']} {one.get('architecture', '')}" for one in ours or libraries}
    return ", ".join(sorted(kernels))
