"""lcm-spy knows our types: by its own type database, and on a screen."""

import os
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path

import pytest
from command_line import Run
from recorded_trials import Recorded
from requirements import needs

from imolo.errors import MissingToolError
from imolo.inspect import spy, types_jar
from imolo.inspect.definitions import definition_files
from imolo.messaging.channels import STREAMS
from imolo.messaging.log_file import read_events
from imolo.messaging.udpm import LOCAL_URL

JAVA_SOURCE = Path(__file__).with_name("DecodeLog.java")


@pytest.fixture(scope="module")
def jar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return types_jar.types_jar(tmp_path_factory.mktemp("cache"))


@pytest.mark.usefixtures("recorded")
class TestWithJava:
    pytestmark = needs("jdk")

    def test_every_event_decodes_and_encodes_to_the_same_bytes(
        self, recorded: Recorded, jar: Path, tmp_path: Path
    ) -> None:
        lcm_jar = types_jar.lcm_jar()
        subprocess.run(["javac", "-cp", lcm_jar, "-d", tmp_path, JAVA_SOURCE], check=True, timeout=60)
        # As lcm-spy's own class path: the jars of others are searched for types as well.
        path = os.pathsep.join(map(str, (lcm_jar, jar, tmp_path)))
        ran = subprocess.run(
            ["java", "-cp", path, "DecodeLog", recorded.first], check=True, capture_output=True, text=True, timeout=60
        )
        found = [line.split()[1:] for line in ran.stdout.splitlines() if line.startswith("RESULT")]
        assert {same for _, _, same in found} == {"true"}
        assert {channel: kind for channel, kind, _ in found} == {
            name: f"imolo_msgs.{channel.message_type.__name__}" for name, channel in STREAMS.items()
        }
        assert Counter(channel for channel, _, _ in found) == Counter(e.channel for e in read_events(recorded.first))

    def test_jar_is_built_once_for_each_version_of_the_types(
        self, jar: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        built = jar.stat().st_mtime_ns
        assert types_jar.types_jar(jar.parent) == jar
        assert jar.stat().st_mtime_ns == built
        definition = tmp_path / "extra_t.lcm"
        definition.write_text("package imolo_msgs;\nstruct extra_t { int32_t extra; }\n")
        monkeypatch.setattr(types_jar, "definition_files", lambda: [definition])
        assert types_jar.types_jar(jar.parent) != jar

    def test_definition_that_cannot_be_built_says_what_the_tool_said(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        definition = tmp_path / "bad_t.lcm"
        definition.write_text("package imolo_msgs;\nstruct bad_t { int32_t class; }\n")
        monkeypatch.setattr(types_jar, "definition_files", lambda: [definition])
        with pytest.raises(MissingToolError, match=r"javac failed: .*bad_t\.java"):
            types_jar.types_jar(tmp_path / "cache")
        assert list((tmp_path / "cache").iterdir()) == []

    @pytest.mark.parametrize("mark", [pytest.param(None, marks=needs("display"))], ids=["screen"])
    def test_window_opens_on_a_log(self, recorded: Recorded, jar: Path, mark: None, tmp_path: Path) -> None:
        command, environment = spy.spy_command(LOCAL_URL, recorded.first, 1.0)
        read, write = os.pipe()
        screen = subprocess.Popen(["Xvfb", "-displayfd", str(write)], pass_fds=[write], stderr=subprocess.DEVNULL)
        os.close(write)
        try:
            with os.fdopen(read) as told:
                environment["DISPLAY"] = f":{told.readline().strip()}"
            window = subprocess.Popen(
                command,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
                text=True,
            )
            try:
                assert _found(["xdotool", "search", "--name", recorded.first.name], environment), "no window"
            finally:
                os.killpg(window.pid, signal.SIGTERM)
                said = window.communicate(timeout=30)
            assert f"Found {len(definition_files())} LCM types" in said[0] + said[1]
        finally:
            screen.terminate()
            screen.wait(30)


def _found(command: list[str], environment: dict[str, str]) -> bool:
    """Ask again and again for up to half a minute."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        if subprocess.run(command, env=environment, capture_output=True, timeout=30).returncode == 0:
            return True
        time.sleep(0.1)
    return False


def test_without_java_one_line_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    code, _, errors = run("spy")
    assert code == 2
    assert errors == (
        "imolo: java cannot be found; install a Java development kit: apt-get install default-jdk (Debian, Ubuntu)\n"
    )


def test_bus_inside_a_process_is_refused(run: Run) -> None:
    code, _, errors = run("spy", "--bus", "memq://")
    assert (code, errors.count("\n")) == (2, 1)


def test_missing_log_is_named(run: Run) -> None:
    code, _, errors = run("spy", "gone.lcmlog")
    assert (code, errors.count("\n")) == (2, 1)
