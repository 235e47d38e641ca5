"""The recorder's file holds whole events at any moment, and never replaces another."""

import resource
import subprocess
import sys
from pathlib import Path

import lcm
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imolo.errors import BusError
from imolo.live.recorder_program import CHUNK, EventFile, free_path

ENDLESS = """
import sys
from pathlib import Path
from imolo.live.recorder_program import EventFile
file = EventFile(Path(sys.argv[1]))
number = 0
while True:
    file.add(number, "MOCAP", number.to_bytes(8, "big") * 30)
    number += 1
    if number % 7 == 0:
        file.flush()
    if number == 1000:
        print("many", flush=True)
"""


def events(path: Path) -> list[tuple[int, int, str, bytes]]:
    log = lcm.EventLog(str(path), "r")
    try:
        return [(event.eventnum, event.timestamp, event.channel, event.data) for event in log]
    finally:
        log.close()


@settings(max_examples=30)
@given(
    st.lists(
        st.tuples(st.integers(0, 2**62), st.sampled_from(("MOCAP", "TRIAL", "X" * 63)), st.binary(max_size=200)),
        max_size=20,
    )
)
def test_lcm_reads_what_was_written(
    tmp_path_factory: pytest.TempPathFactory, sent: list[tuple[int, str, bytes]]
) -> None:
    path = tmp_path_factory.mktemp("log") / "log"
    file = EventFile(path)
    for one in sent:
        file.add(*one)
    file.flush()
    # Before it is closed.
    assert events(path) == [(number, *one) for number, one in enumerate(sent)]
    file.close()


def test_file_of_a_killed_program_ends_with_a_whole_event(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with subprocess.Popen([sys.executable, "-c", ENDLESS, path], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"many\n"
        process.kill()
    found = events(path)
    size = sum(28 + len(channel) + len(data) for _, _, channel, data in found)
    assert [time for _, time, _, _ in found] == list(range(len(found)))
    assert len(found) >= 994
    assert path.stat().st_size == size


def test_full_disk_is_told_and_leaves_whole_events(tmp_path: Path) -> None:
    path = tmp_path / "log"
    file = EventFile(path)
    file.add(1, "MOCAP", b"whole")
    file.flush()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (file.size + 10, hard))
    try:
        file.add(2, "MOCAP", b"too much")
        with pytest.raises(BusError, match=r"cannot write the log .*; make room, what was recorded before is kept"):
            file.flush()
        file.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert file.events == 1
    assert events(path) == [(0, 1, "MOCAP", b"whole")]


def test_messages_without_a_pause_are_written_in_chunks(tmp_path: Path) -> None:
    file = EventFile(tmp_path / "log")
    while not file.size:
        file.add(0, "MOCAP", b"\x00" * 1000)
    assert CHUNK <= file.size <= CHUNK + 2000
    file.close()


def test_log_in_a_folder_is_a_session(tmp_path: Path) -> None:
    for name in ("session.lcmlog", "session_1.lcmlog"):
        free = free_path(tmp_path)
        assert free == tmp_path / name
        EventFile(free).close()


def test_folder_that_is_not_there_yet_ends_with_a_slash(tmp_path: Path) -> None:
    assert free_path(f"{tmp_path}/monday/") == tmp_path / "monday/session.lcmlog"
    assert free_path(f"{tmp_path}/monday") == tmp_path / "monday"


def test_older_log_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "session.lcmlog"
    for name in ("session.lcmlog", "session_1.lcmlog", "session_2.lcmlog"):
        free = free_path(path)
        assert free == tmp_path / name
        EventFile(free).close()
    with pytest.raises(BusError, match=r"cannot write the log .*exists; choose another --out"):
        EventFile(path)
