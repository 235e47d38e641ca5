"""Faults of disks, programs and logs: nothing that was whole is lost, and a campaign goes on as if unhurt.

A trial is played by a runner that writes a log in a millisecond, so that every write can fail once.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from instant_trials import CONFIG, TRIALS, play_at_once, tasks
from matplotlib.figure import Figure
from requirements import needs
from tries import tries

from imolo.campaigns import campaign
from imolo.campaigns.campaign import TrialTask, run_tasks
from imolo.campaigns.kept_trials import TrialTiming, partial_path, set_aside
from imolo.campaigns.results import ResultsFolder
from imolo.errors import BusError, ImoloError, ResultsError
from imolo.machine.files import whole_file, write_whole


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "run_task", play_at_once)


def play_campaign(path: Path) -> None:
    """Do what a study does: trials, config, numbers and a figure."""
    folder = ResultsFolder(path)
    folder.prepare()
    timings = run_tasks(tasks(folder.learning("mujoco")), jobs=1)
    folder.save_config(CONFIG)
    figure = Figure()
    figure.subplots().plot([timing.decisions[0] for timing in timings])
    folder.save_figure("decisions.png", figure)
    folder.save_json("summary.json", timings[-1])


def results(path: Path) -> dict[str, bytes]:
    files = [file for file in path.rglob("*") if file.is_file() and not file.name.startswith(".")]
    return {str(file.relative_to(path)): file.read_bytes() for file in files if file.suffix != ".part"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "run_task", play_at_once)
        play_campaign(path)
    written = results(path)
    assert len(written) == 2 * TRIALS + 3
    return written


def assert_nothing_is_half(path: Path, whole: dict[str, bytes]) -> None:
    """A file under its own name is as it should be, or not there."""
    for name, content in results(path).items():
        assert content == whole[name], name


class Fails:
    """Raises at the n-th call for a folder, and at all later ones: a disk that is full stays full."""

    def __init__(self, original: Callable[..., object], folder: Path, number: int) -> None:
        self.original, self.folder, self.left = original, folder, number

    def __call__(self, *arguments: object, **named: object) -> object:
        if not (isinstance(arguments[0], int) or Path(str(arguments[0])).is_relative_to(self.folder)):
            return self.original(*arguments, **named)
        self.left -= 1
        if self.left < 0:
            raise OSError(28, "No space left on device")
        return self.original(*arguments, **named)


@pytest.mark.parametrize("name", ["os.fsync", "pathlib.Path.replace", "pathlib.Path.open"])
def test_every_call_may_fail_and_the_campaign_goes_on_bit_for_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: dict[str, bytes], name: str
) -> None:
    module, _, attribute = name.rpartition(".")
    owner = {"os": os, "pathlib.Path": Path}[module]
    original = getattr(owner, attribute)
    for number in range(100):
        path = tmp_path / str(number)
        path.mkdir()
        fails = Fails(original, path, number)
        call = fails if owner is os else lambda *a, _fails=fails, **n: _fails(*a, **n)
        said = ""
        with monkeypatch.context() as patch:
            patch.setattr(owner, attribute, call)
            try:
                play_campaign(path)
            except ImoloError as error:
                said = str(error)
        assert "\n" not in said
        assert_nothing_is_half(path, whole)
        play_campaign(path)
        assert results(path) == whole
        assert not list(path.rglob(".*.tmp"))
        if fails.left >= 0:
            break
    assert 3 <= number < 99


FULL = """
import sys
from pathlib import Path
from test_campaign_faults import campaign, play_at_once, play_campaign
from imolo.errors import ImoloError
campaign.run_task = play_at_once
try:
    play_campaign(Path(sys.argv[1]))
except ImoloError as error:
    print("imolo:", error, file=sys.stderr)
    sys.exit(2)
"""


def in_program(*arguments: object, program: str = FULL) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def mounted(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    place = tmp_path / "disk"
    place.mkdir()

    def mount(size: int) -> Path:
        unmount()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", place], check=True)
        return place

    def unmount() -> None:
        # Lazily, since the lock of the results folder stays open until the process ends.
        subprocess.run(["umount", "--lazy", place], check=False, stderr=subprocess.DEVNULL)

    yield mount
    unmount()


SIZES = range(1, 60)  # [pages of 4096 bytes]; the results need some 45
SOME = [size for size in SIZES if size % 8 == 1]


@pytest.mark.parametrize("sizes", [SOME, pytest.param(SIZES, marks=pytest.mark.slow)], ids=["some", "all"])
@pytest.mark.parametrize("_", [pytest.param(None, marks=needs("netns"), id="")])  # root, to mount
def test_full_disk_of_any_size_ends_in_one_line_and_leaves_what_is_whole(
    mounted: Callable[[int], Path], whole: dict[str, bytes], sizes: range, _: None
) -> None:
    ended = []
    for size in sizes:
        path = mounted(4096 * size) / "out"
        try:
            play_campaign(path)
        except ImoloError as error:
            ended.append(str(error))
        assert_nothing_is_half(path, whole)
        subprocess.run(["mount", "-o", "remount,size=10m", path.parent], check=True)
        play_campaign(path)
        assert results(path) == whole
    assert ended
    assert len(ended) < len(sizes)
    assert all("\n" not in line and "choose a" in line for line in ended)


# Killed at any write.

KILL = """
import os, signal
from pathlib import Path
left = {number}
def killing(original):
    def call(*arguments, **named):
        global left
        left -= 1
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return original(*arguments, **named)
    return call
os.fsync, Path.replace = killing(os.fsync), killing(Path.replace)
"""
CALLS = 2 * (2 * TRIALS + 3)  # fsync and rename of each log and record, and of config, figure and numbers


@pytest.mark.parametrize("numbers", [(1, 7), pytest.param(range(CALLS), marks=pytest.mark.slow)], ids=["some", "all"])
def test_campaign_killed_at_any_write_goes_on_bit_for_bit(
    tmp_path: Path, whole: dict[str, bytes], numbers: range
) -> None:
    for number in numbers:
        path = tmp_path / str(number)
        ended = in_program(path, program=KILL.format(number=number) + FULL)
        assert ended.returncode == -signal.SIGKILL, ended.stderr
        assert_nothing_is_half(path, whole)
        play_campaign(path)
        assert results(path) == whole
        assert not [file for file in path.rglob("*") if file.suffix in (".tmp", ".part")]


AGAIN = """
import os, random, signal, sys
from pathlib import Path
from test_campaign_faults import campaign, play_at_once, play_campaign
campaign.run_task = play_at_once
folder, wanted, chance, took, kills, number = Path(sys.argv[1]), int(sys.argv[2]), random.Random(1), 0.0, 0, 0
while kills < wanted:
    child = os.fork()
    if not child:
        signal.setitimer(signal.ITIMER_PROF, chance.uniform(0.0, took))
        play_campaign(folder / str(number))
        os._exit(0)
    _, status, used = os.wait4(child, 0)
    ended = os.waitstatus_to_exitcode(status)
    assert ended in (0, -signal.SIGPROF), ended
    kills, number, took = kills + bool(ended), number + (not ended), took or used.ru_utime + used.ru_stime
"""


def test_campaign_killed_again_and_again_goes_on_bit_for_bit(tmp_path: Path, whole: dict[str, bytes]) -> None:
    """After a share of its time on the processor that chance chooses, each time in what the killed one left."""
    ended = in_program(tmp_path, tries(5), program=AGAIN)
    assert ended.returncode == 0, ended.stderr
    folders = list(tmp_path.iterdir())
    assert len(folders) > 1
    for path in folders:
        assert_nothing_is_half(path, whole)
        play_campaign(path)
        assert results(path) == whole


# Files of results.


def test_file_that_cannot_be_written_whole_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "f"
    write_whole(path, "old")

    def break_off() -> None:
        with whole_file(path) as file:
            file.write(b"new")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        break_off()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_results_folder_that_was_removed_meanwhile_ends_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ResultsError, match=r"cannot write .*file/summary.json"):
        ResultsFolder(tmp_path / "file").save_json("summary.json", TrialTiming(simulated=1, elapsed=1, decisions=()))


# Two programs, one folder.

HOLD = """
import sys
from pathlib import Path
from imolo.campaigns.results import ResultsFolder
from imolo.errors import ResultsError
try:
    ResultsFolder(Path(sys.argv[1])).prepare()
    print("held", flush=True)
    sys.stdin.read()
except ResultsError as error:
    print(error)
"""


def hold(path: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", HOLD, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def test_second_program_in_a_folder_ends_in_one_line_until_the_first_is_dead(tmp_path: Path) -> None:
    with hold(tmp_path) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        with hold(tmp_path) as second:
            said = second.communicate()[0]
        assert f"in use by process {first.pid} on" in said
        assert "choose another --out" in said
        assert said.count("\n") == 1
        first.kill()
    # Nobody has to delete what the dead one left.
    with hold(tmp_path) as third:
        assert third.communicate()[0] == "held\n"


# Logs that are not as they were.


@pytest.mark.parametrize("damage", [lambda data: data[:1000], lambda data: data[:-1] + b"x", lambda data: b""])
def test_damaged_log_under_a_good_origin_is_run_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: Callable[[bytes], bytes]
) -> None:
    run_tasks(tasks(tmp_path), jobs=1)
    before = results(tmp_path)
    log = tmp_path / "throw_001.lcmlog"
    log.write_bytes(damage(log.read_bytes()))
    run_tasks(tasks(tmp_path), jobs=1)
    assert results(tmp_path) == before
    assert "throw_001.lcmlog is not as it was written" in caplog.text


def test_log_whose_end_found_no_room_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def cut(task: TrialTask) -> TrialTiming:
        timing = play_at_once(task)
        # LCM's writer loses what it had in memory without a word.
        os.truncate(task.log_path, task.log_path.stat().st_size // 4096 * 4096)
        return timing

    monkeypatch.setattr(campaign, "run_task", cut)
    with pytest.raises(BusError, match=r"cannot write the log .*throw_000.lcmlog: it is cut off"):
        run_tasks(tasks(tmp_path), jobs=1)
    assert not list(tmp_path.glob("*.lcmlog"))


def test_number_of_a_void_log_comes_once(tmp_path: Path) -> None:
    log_path = tmp_path / "hit_001.lcmlog"
    names = []
    for number in range(4):
        partial_path(log_path).write_text(str(number))
        names.append(set_aside(partial_path(log_path), log_path))
        if number in (0, 2):
            names[-1].unlink()
    assert len(set(names)) == 4
    assert [path.read_text() for path in names if path.exists()] == ["1", "3"]
