"""The real lcm-spy with our types decoded."""

import os
import subprocess
from pathlib import Path

from imolo.errors import BusError, MissingToolError
from imolo.inspect.types_jar import lcm_tool, require_java, types_jar

PLAY_DELAY = 1.0  # [s] until a log starts to play, so that its first messages are seen


def open_spy(url: str, log: Path | None = None, speed: float = 1.0) -> None:
    """Open lcm-spy on a bus, or on a log that it plays itself, and wait until it is closed.

    Raises:
        BusError: The log does not exist, or the bus is one that no other process can hear.
        MissingToolError: Java is missing, or there is no display.
    """
    require_java("java")
    command, environment = spy_command(url, log, speed)
    if not environment.get("DISPLAY"):
        raise MissingToolError("lcm-spy needs a display; use `imolo top` in a terminal")
    # What it prints is what it could not load from the jars of others.
    ended = subprocess.run(command, env=environment, check=False, capture_output=True, text=True)
    if ended.returncode > 0:
        reason = next((line for line in ended.stderr.splitlines() if "Exception" in line or "Error" in line), "")
        raise MissingToolError(f"lcm-spy ended with code {ended.returncode}: {reason}")


def spy_command(url: str, log: Path | None, speed: float) -> tuple[list[str], dict[str, str]]:
    """Return the command that opens lcm-spy, and its environment.

    Raises:
        BusError: The log does not exist, or the bus is one that no other process can hear.
    """
    if log is not None:
        if not log.is_file():
            raise BusError(f"there is no log {log}")
        # lcm-spy plays logs without a network.
        url = f"file://{log.resolve()}?speed={speed}&delay={PLAY_DELAY}"
    elif url.startswith("memq:"):
        raise BusError(f"nobody outside a process can hear {url!r}; give a udpm:// URL, or a log")
    classpath = [str(types_jar()), *filter(None, [os.environ.get("CLASSPATH")])]
    environment = {**os.environ, "CLASSPATH": os.pathsep.join(classpath)}
    return [lcm_tool("lcm-spy"), f"--lcm-url={url}", "--title", str(log) if log else url], environment
