"""Lock-step over two processes gives the bytes of one process, whatever the network does."""

from pathlib import Path

import pytest
from live_table import Learned
from programs import lab

from imolo.campaigns.campaign import TrialTask, run_task
from imolo.contracts.trial import Trial, TrialKind
from imolo.messaging import channels
from imolo.messaging.log import read_log

pytestmark = pytest.mark.usefixtures("network")

CHAOS = 0.1


def in_one_process(learned: Learned, path: Path, index: int) -> bytes:
    trial = Trial(TrialKind.HIT, index, learned.config.seed)
    run_task(TrialTask(learned.config, trial, path, "improved", learned.table_path))
    return path.read_bytes()


def assert_same_bytes(
    learned: Learned, folder: Path, balls: int, chaos: tuple[tuple[int, float], tuple[int, float]] | tuple[None, None]
) -> int:
    """Play balls over the network and compare each log with that of one process; return the number of frames."""
    with lab(learned.config_path, learned.table_path, folder / "live", "lockstep") as there:
        backend, planner = there.backend(chaos=chaos[0]), there.planner(chaos=chaos[1])
        throw = there.throw(balls)
        frames = 0
        for index in range(balls):
            backend.wait_for(rf"ball {index}: (touch|ball_landed|the ball)")
            assert there.log(index).read_bytes() == in_one_process(learned, folder / "log", index)
            frames += len(read_log(there.log(index)).messages[channels.MOCAP])
        assert throw.wait() == 0
        assert (planner.stop(), backend.stop()) == (0, 0)
        resent = int(backend.wait_for(r"stopped; .* (\d+) of \d+ questions asked again")[1])
        assert resent > (0.1 * frames if chaos[0] else -1)
    assert not (folder / "live/void").exists()
    return frames


@pytest.mark.slow
def test_network_gives_the_bytes_of_one_process(learned: Learned, tmp_path: Path) -> None:
    assert assert_same_bytes(learned, tmp_path, 2, (None, None)) > 100


def test_bad_network_gives_the_bytes_of_one_process(learned: Learned, tmp_path: Path) -> None:
    assert assert_same_bytes(learned, tmp_path, 2, ((1, CHAOS), (2, CHAOS))) > 150


@pytest.mark.slow
def test_ten_thousand_frames_on_a_bad_network_give_the_bytes_of_one_process(learned: Learned, tmp_path: Path) -> None:
    assert assert_same_bytes(learned, tmp_path, 100, ((3, CHAOS), (4, CHAOS))) >= 10_000
