"""The cameras: as noisy, late and forgetful as the config says, and no fault changes the chance of the rest."""

from itertools import pairwise
from math import sqrt
from typing import Any

import numpy as np
import pytest
from liberobot import BODY
from numpy.typing import NDArray

from imolo.config.simulation import MocapConfig
from imolo.contracts.engine import EngineState
from imolo_backends.simulation.mocap import Mocap
from imolo_msgs import marker_t, mocap_frame_t

Array = NDArray[np.float64]

FRAMES = 3000
PERIOD = 8333  # [µs]
MARKERS = BODY.markers
LINKS = len(BODY.link_names)
BALL = np.array([4.0, 0.1, 2.0])
FAULTS = ("marker_noise", "ball_noise", "marker_dropout", "ball_dropout", "frame_dropout", "unlabelled", "ghost")
PERFECT = dict.fromkeys(FAULTS, 0.0)
STATE = EngineState(
    time=0.0,
    joint_angle=np.zeros(8),
    joint_velocity=np.zeros(8),
    link_position=np.random.default_rng(1).uniform(-1.0, 1.0, (LINKS, 3)),
    # A quarter turn about y takes z to x.
    link_rotation=np.tile([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]], (LINKS, 1, 1)),
    base_quaternion=np.array([1.0, 0.0, 0.0, 0.0]),
    ball_position=BALL,
    ball_velocity=np.zeros(3),
)


def record(seed: int = 0, frames: int = FRAMES, **faults: Any) -> list[mocap_frame_t]:
    """Return what cameras deliver that are perfect but for the faults."""
    mocap = Mocap(MocapConfig(**{**PERFECT, **faults}), BODY, np.random.default_rng(seed))
    for number in range(frames):
        mocap.expose(PERIOD * number, STATE)
    return [mocap_frame_t.decode(frame) for frame in mocap.deliver(2**62)]


def labelled(frame: mocap_frame_t) -> dict[int, tuple[float, ...]]:
    return {m.marker_id: tuple(m.marker_position) for m in frame.markers if m.marker_id != marker_t.UNLABELLED}


def unlabelled(frame: mocap_frame_t) -> list[tuple[float, ...]]:
    return [tuple(m.marker_position) for m in frame.markers if m.marker_id == marker_t.UNLABELLED]


def is_share(count: int, total: int, probability: float) -> bool:
    """Return whether a binomial count is within five standard deviations, a chance of 6e-7 to be wrong."""
    return abs(count - total * probability) <= 5 * sqrt(total * probability * (1 - probability))


def test_perfect_cameras_see_every_marker_where_it_is() -> None:
    (frame,) = record(frames=1)
    expected = {
        marker.marker_id: STATE.link_position[BODY.link_of(marker)] + STATE.link_rotation[0] @ np.array(marker.offset)
        for marker in MARKERS
    }
    assert labelled(frame).keys() == expected.keys()
    for label, position in labelled(frame).items():
        assert position == pytest.approx(expected[label], abs=1e-15)
    assert unlabelled(frame) == [tuple(BALL)]
    assert frame.num_markers == len(frame.markers) == len(MARKERS) + 1


def test_noise_is_as_configured() -> None:
    frames = record(marker_noise=0.0003, ball_noise=0.001)
    (truth,) = record(frames=1)
    marker = np.array([[labelled(frame)[m.marker_id] for m in MARKERS] for frame in frames])
    ball = np.array([unlabelled(frame)[0] for frame in frames])
    for error, sd in (
        (marker - [labelled(truth)[m.marker_id] for m in MARKERS], 0.0003),
        (ball - BALL, 0.001),
    ):
        # Five standard errors of a mean and of a standard deviation of normal samples.
        assert abs(error.mean()) < 5 * sd / sqrt(error.size)
        assert abs(error.std() / sd - 1.0) < 5 / sqrt(2 * error.size)


def test_frame_is_delivered_when_its_latency_is_over_and_not_before() -> None:
    mocap = Mocap(MocapConfig(**PERFECT, latency=0.005), BODY, np.random.default_rng(0))
    mocap.expose(1000, STATE)
    assert mocap.deliver(5999) == []
    assert [mocap_frame_t.decode(frame).utime for frame in mocap.deliver(6000)] == [1000]
    assert mocap.deliver(2**62) == []


def test_frames_are_delivered_in_order() -> None:
    frames = record(frames=10)
    assert [frame.utime for frame in frames] == [PERIOD * number for number in range(10)]


def test_frame_numbers_skip_lost_frames_and_nothing_else() -> None:
    frames = record(frame_dropout=0.1)
    assert is_share(FRAMES - len(frames), FRAMES, 0.1)
    for before, after in pairwise(frames):
        assert after.utime - before.utime == PERIOD * (after.frame_number - before.frame_number)
    complete = [frame.frame_number for frame in record(marker_dropout=0.5, ball_dropout=0.5, unlabelled=0.5, ghost=0.5)]
    assert complete == list(range(1, FRAMES + 1))


def test_share_of_missing_markers_is_as_configured() -> None:
    frames = record(marker_dropout=0.02)
    missing = sum(len(MARKERS) - len(labelled(frame)) for frame in frames)
    assert is_share(missing, FRAMES * len(MARKERS), 0.02)
    assert all(len(unlabelled(frame)) == 1 for frame in frames)


def test_share_of_frames_without_the_ball_is_as_configured() -> None:
    frames = record(ball_dropout=0.02)
    assert is_share(sum(not unlabelled(frame) for frame in frames), FRAMES, 0.02)
    assert all(len(labelled(frame)) == len(MARKERS) for frame in frames)


def test_marker_without_a_label_is_still_seen() -> None:
    frames = record(unlabelled=0.05)
    assert is_share(sum(len(MARKERS) - len(labelled(frame)) for frame in frames), FRAMES * len(MARKERS), 0.05)
    assert all(frame.num_markers == len(MARKERS) + 1 for frame in frames)
    assert marker_t.UNLABELLED == -1


def test_share_of_frames_with_a_ghost_is_as_configured() -> None:
    frames = record(ghost=0.05)
    assert is_share(sum(len(unlabelled(frame)) == 2 for frame in frames), FRAMES, 0.05)
    ghosts = np.array([unlabelled(frame)[1] for frame in frames if len(unlabelled(frame)) == 2])
    assert np.abs(ghosts - STATE.link_position[0]).max() <= 3.0


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_does_not_change_the_chance_of_anything_else(fault: str) -> None:
    noise = {"marker_noise": 0.001, "ball_noise": 0.001}
    healthy = {frame.frame_number: frame for frame in record(frames=300, **noise)}
    faulty = record(frames=300, **{**noise, fault: 0.3})
    shared = 0
    for frame in faulty:
        reference = healthy[frame.frame_number]
        if fault != "marker_noise":
            assert labelled(frame).items() <= labelled(reference).items()
            shared += len(labelled(frame))
        if fault not in ("ball_noise", "unlabelled", "ghost", "ball_dropout"):
            assert unlabelled(frame) == unlabelled(reference)
            shared += 1
    assert shared > 200


def test_same_seed_gives_the_same_frames() -> None:
    faults = MocapConfig().model_dump(include=set(FAULTS))
    one, same, other = (record(seed, 100, **faults) for seed in (1, 1, 2))
    assert [frame.encode() for frame in one] == [frame.encode() for frame in same]
    assert [frame.encode() for frame in one] != [frame.encode() for frame in other]
