"""Where a flight begins and ends does not depend on how much of the contact its track shows."""

from pathlib import Path

import numpy as np
import pytest
from test_flight_file import bouncing

from imolo.ball.bounce import _Meetings, before_bounce
from imolo.ball.evaluation import leave_one_out
from imolo.ball.flight_file import read_tracks
from imolo.ball.model import BallModelConfig

REAL = Path(__file__).parents[1] / "data" / "ball_flights"
MANY, FEW = (read_tracks(REAL / name) for name in ("aimy_robot_simple_0-23.csv", "aimy_mn5008_no_spin_0-4.csv"))
SEEN = range(13)  # samples of what follows or precedes the flight


def ends(flight, time):
    """Indices of the first and the last sample of a flight in its track."""
    return np.searchsorted(time, flight.time[[0, -1]])


@pytest.mark.parametrize("tracks", [MANY, FEW], ids=["many", "few"])
def test_real_flight_is_the_same_however_soon_its_track_ends_after_the_bounce(tracks):
    for label, track in tracks.items():
        whole = before_bounce(track.time, track.position)
        for seen in SEEN:
            count = len(whole.time) + seen
            cut = before_bounce(track.time[:count], track.position[:count])
            assert cut.time[0] == whole.time[0]
            assert abs(len(cut.time) - len(whole.time)) <= 1, (label, seen)


@pytest.mark.parametrize("tracks", [MANY, FEW], ids=["many", "few"])
def test_real_flight_begins_with_its_track_wherever_that_begins(tracks):
    # A few samples at an end may show a slip of the cameras as half of the speed; more of them do not.
    for label, track in tracks.items():
        last = ends(before_bounce(track.time, track.position), track.time)[1]
        for start in range(2 * len(SEEN)):
            cut = before_bounce(track.time[start:], track.position[start:])
            first, end = ends(cut, track.time)
            assert max(abs(first - start), abs(end - last)) <= 1, (label, start)


@pytest.mark.parametrize("restitution", [0.9, 0.5, 0.0])
@pytest.mark.parametrize("noise", [0.0, 0.002])
@pytest.mark.parametrize(("rate", "lost"), [(60.0, 0), (180.0, 0), (120.0, 3), (120.0, 10)])
def test_flight_ends_at_the_bounce_however_little_of_it_is_seen(rate, lost, noise, restitution):
    # 2 mm of noise hide the contact for 4 sd / 3 m/s, 3 ms: less than a sample.
    for seed in range(2):
        time, position, _, contact = bouncing(np.random.default_rng(seed), rate, restitution, noise)
        middle = np.searchsorted(time, contact)
        seen = np.ones(len(time), dtype=bool)
        seen[middle - lost // 2 : middle - lost // 2 + lost] = False
        time, position = time[seen], position[seen]
        last = np.searchsorted(time, contact) - 1
        for after in SEEN:
            cut = slice(0, last + 1 + after)
            first, end = ends(before_bounce(time[cut], position[cut]), time)
            assert (first, abs(end - last) <= 1) == (0, True), (seed, after)


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.002])
@pytest.mark.parametrize("rate", [60.0, 180.0])
def test_flight_begins_at_the_launch_however_little_is_seen_before(rate, noise):
    for seed in range(2):
        time, position, released, contact = bouncing(np.random.default_rng(seed), rate, 0.8, noise, rest=0.3)
        launch, last = np.searchsorted(time, released - 1e-9), np.searchsorted(time, contact) - 1
        for before in SEEN:
            cut = slice(launch - before, None)
            first, end = ends(before_bounce(time[cut], position[cut]), time)
            assert abs(first - launch) <= 1, (seed, before)
            assert abs(end - last) <= 1, (seed, before)


def test_ball_that_is_thrown_up_from_rest_does_not_bounce_there():
    # The hand gives it all of its velocity; a floor gives back twice of what fell at most.
    time, position, released, _ = bouncing(np.random.default_rng(0), 180.0, 0.8, 0.0005, rest=0.1)
    assert before_bounce(time, position).time[0] == pytest.approx(released, abs=1.0 / 180.0)


def test_evidence_of_a_jump_is_its_squares_over_their_variances():
    none, std = np.zeros((2, 3)), np.array([[1.0, 2.0, 0.5]] * 2)
    jump = np.array([[0.0, -4.0, 1.0], [3.0, 0.0, -0.5]])
    assert _Meetings(none, jump, none, std, none[:, 0]).evidence().tolist() == [8.0, 10.0]


def test_noise_is_that_of_the_place():
    # A third of a second is six times as noisy as what follows; judged by that, samples would be cut off.
    rng = np.random.default_rng(1)
    time, position, _, _ = bouncing(rng, 180.0, 0.8, 0.0005)
    position[:60] += 0.003 * rng.standard_normal((60, 3))
    assert before_bounce(time, position).time[0] == time[0]


@pytest.mark.parametrize("seen", [0, 1, 2, 5, 12])
def test_predictions_are_as_good_and_honest_however_the_tracks_are_cut(seen):
    # The targets: the last point from what was seen 0.1 s before, 1 is a right covariance.
    flights = {}
    for label, track in FEW.items():
        count = len(before_bounce(track.time, track.position).time) + seen
        flights[label] = before_bounce(track.time[:count], track.position[:count])
    result = leave_one_out("cut", flights, {}, [BallModelConfig(kind="spin")], (0.1,))
    (last,) = (rating for rating in result.ratings if rating.protocol == "last point")
    assert last.mean <= 0.006
    assert 0.5 <= last.nees <= 1.5
