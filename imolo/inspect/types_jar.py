"""The jar of our message types that the Java tools of LCM decode with, built once for each version of the types."""

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import lcm

from imolo.errors import MissingToolError
from imolo.inspect.definitions import definition_files

INSTALL_JDK = "install a Java development kit: apt-get install default-jdk (Debian, Ubuntu)"
RELEASE = "8"  # Java version of the class files: whatever runs lcm-spy runs them
BUILD_TIMEOUT = 120.0  # [s]


def lcm_jar() -> Path:
    """Return LCM's own jar, which comes with its wheel.

    Raises:
        MissingToolError: It is not there.
    """
    for folder in Path(lcm.__file__).parents[1:3]:
        jar = folder / "share" / "java" / "lcm.jar"
        if jar.is_file():
            return jar
    raise MissingToolError("lcm.jar is not beside the lcm package; install its wheel again: pip install --force lcm")


def lcm_tool(name: str) -> str:
    """Return the path of a program of LCM, of this environment first.

    Raises:
        MissingToolError: It is not installed.
    """
    beside = Path(sys.executable).with_name(name)
    found = str(beside) if beside.is_file() else shutil.which(name)
    if found is None:
        raise MissingToolError(f"{name} is not installed; it comes with: pip install lcm")
    return found


def require_java(*programs: str) -> None:
    """Check that these programs of Java can be run.

    Raises:
        MissingToolError: One of them is missing.
    """
    missing = [name for name in programs if shutil.which(name) is None]
    if missing:
        raise MissingToolError(f"{' and '.join(missing)} cannot be found; {INSTALL_JDK}")


def types_jar(cache: Path | None = None) -> Path:
    """Return the jar of our types; built where the cache has none for these types and this LCM.

    Args:
        cache: Folder that keeps the jars; the user's cache folder by default.

    Raises:
        MissingToolError: A tool that builds it is missing, or fails.
    """
    files = definition_files()
    if not files:
        raise MissingToolError("the .lcm files of imolo's messages are not installed; install imolo again")
    content = hashlib.sha256()
    for part in (lcm_jar(), *files):
        content.update(part.read_bytes())
    folder = cache if cache is not None else _user_cache()
    jar = folder / f"imolo-types-{content.hexdigest()[:16]}.jar"
    if not jar.is_file():
        require_java("java", "javac", "jar")
        _build(files, jar)
    return jar


def _user_cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "imolo"


def _build(files: list[Path], jar: Path) -> None:
    try:
        jar.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=jar.parent) as work:
            sources, classes, packed = Path(work, "sources"), Path(work, "classes"), Path(work, "types.jar")
            classes.mkdir()
            _run(lcm_tool("lcm-gen"), "--java", "--jpath", str(sources), *map(str, files))
            written = [str(path) for path in sorted(sources.rglob("*.java"))]
            options = ("-nowarn", "-Xlint:-options", "-encoding", "UTF-8", "--release", RELEASE)
            _run("javac", *options, "-cp", str(lcm_jar()), "-d", str(classes), *written)
            _run("jar", "cf", str(packed), "-C", str(classes), ".")
            # In one step, so that two that build at once do not meet.
            packed.replace(jar)
    except OSError as error:
        raise MissingToolError(
            f"cannot build {jar}: {error}; set XDG_CACHE_HOME to a folder you may write to"
        ) from error


def _run(*command: str) -> None:
    try:
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=BUILD_TIMEOUT)
    except subprocess.CalledProcessError as error:
        said = " ".join((error.stderr or error.stdout).split())
        raise MissingToolError(f"{Path(command[0]).name} failed: {said[:300]}") from error
    except subprocess.TimeoutExpired as error:
        raise MissingToolError(f"{Path(command[0]).name} did not end within {BUILD_TIMEOUT:.0f} s") from error
