"""The planner in C of examples/ hits balls through `imolo backend`, as docs/wire.md says that a foreign program can."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from live_table import Learned
from network import URL
from programs import PATIENCE, lab
from requirements import needs

from imolo.messaging import channels
from imolo.messaging.log import read_log
from imolo.trials.metrics import judge_trial
from imolo_msgs import plan_t

ROOT = Path(__file__).parents[2]
BALLS = 4
pytestmark = needs("cc", "glib")


@pytest.fixture(scope="module")
def c_planner(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("c_planner")
    tools = f"BIN={Path(sys.executable).parent}"
    make = ["make", "--assume-old=.venv/.ready", "c-planner", f"C_PLANNER={folder}", tools]
    made = subprocess.run(make, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE)
    assert made.returncode == 0, made.stderr
    assert "warning" not in made.stderr
    return folder / "planner"


@pytest.fixture(scope="module")
def motions(learned: Learned, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("motions") / "motions.txt"
    writer = ROOT / "examples/c_planner/write_motions.py"
    subprocess.run([sys.executable, writer, learned.table_path, path], check=True, timeout=PATIENCE)
    return path


@contextlib.contextmanager
def running(c_planner: Path, motions: Path) -> Iterator[None]:
    with subprocess.Popen([c_planner, motions, URL]) as process:
        try:
            yield
            assert process.poll() is None
        finally:
            process.kill()


@pytest.mark.usefixtures("network")
def test_it_hits_balls_and_its_logs_are_judged(
    c_planner: Path, motions: Path, learned: Learned, tmp_path: Path
) -> None:
    with (
        lab(learned.config_path, learned.table_path, tmp_path / "live", "lockstep") as there,
        running(c_planner, motions),
    ):
        backend, throw = there.backend(), there.throw(BALLS)
        for index in range(BALLS):
            backend.wait_for(rf"ball {index}: (touch|ball_landed|the ball)")
        assert throw.wait() == 0
        logs = [read_log(there.log(index)) for index in range(BALLS)]
    assert not (tmp_path / "live/void").exists()
    results = [judge_trial(log, learned.config) for log in logs]
    # A coarse table of few samples: not every ball, but none by chance.
    assert sum(result.hit for result in results) > BALLS // 2, results
    for log in logs:
        frames, plans = log.messages[channels.MOCAP], log.messages[channels.PLAN]
        assert [plan.answered_frame for plan in plans] == [frame.frame_number for frame in frames]
        assert sum(plan.state == plan_t.STARTED for plan in plans) <= 1


@pytest.mark.usefixtures("network")
def test_a_table_of_another_robot_moves_nothing(
    c_planner: Path, motions: Path, learned: Learned, tmp_path: Path
) -> None:
    other = tmp_path / "other.txt"
    other.write_text(motions.read_text(encoding="ascii").replace("liberobot", "octopus", 1), encoding="ascii")
    with (
        lab(learned.config_path, learned.table_path, tmp_path / "live", "lockstep") as there,
        running(c_planner, other),
    ):
        there.backend().wait_for("planner .* is refused, nothing will move: it is for robot 'octopus'")


@pytest.mark.parametrize(
    "spoil",
    [
        lambda text: "",
        lambda text: "liberobot 1 3\n",
        lambda text: text[: len(text) // 2],
        lambda text: text.replace(" 3 8 ", " 300 8 ", 1),
        lambda text: text.replace(" 3 8 ", " 3 -8 ", 1),
        lambda text: text.rsplit("\n", 2)[0] + "\n99999 350000 1 0 1\n",
        None,
    ],
    ids=["empty", "no header", "cut off", "many phases", "negative", "unknown motion", "missing"],
)
def test_bad_motions_are_refused_in_one_line(c_planner: Path, motions: Path, tmp_path: Path, spoil: object) -> None:
    bad = tmp_path / "bad.txt"
    if callable(spoil):
        bad.write_text(spoil(motions.read_text(encoding="ascii")), encoding="ascii")
    done = subprocess.run([c_planner, bad], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert str(bad) in done.stderr
