"""Recorded flights: the CSV reader, and the cut at the bounce."""

import csv
import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from ball_flights import fly
from hypothesis import given
from hypothesis import strategies as st

from imolo.ball.bounce import before_bounce
from imolo.ball.flight_file import read_flights, read_tracks
from imolo.errors import TrainingDataError

REAL = Path(__file__).parents[1] / "data" / "ball_flights"
HEADER = "flight,time_s,x_m,y_m,z_m\n"


def bouncing(rng, rate, restitution, noise, height=1.0, missing=0.0, rest=0.0):
    """A ball that is perhaps held, launched, and bounces at z = 0; time of the contact, None if it is not reached."""
    start = np.array([0.0, 0.0, height, 4.0, 0.3, 1.5])
    time = np.arange(0.0, 1.2, 1.0 / rate)
    fine = np.linspace(0.0, 1.2, 24001)
    down = fly(start, fine)
    contact = fine[np.flatnonzero(down[:, 2] <= 0.0)[0]]
    at_contact = fly(start, np.array([0.0, contact]))[-1]
    after = at_contact * [1, 1, 1, 0.8, 0.8, -restitution]
    path = fly(start, np.append(time[time < contact], contact))[:-1, :3]
    later = fly(after, np.append(contact, time[time >= contact]))[1:, :3]
    later[:, 2] = np.abs(later[:, 2]) if restitution else 0.0
    position = np.concatenate([np.tile(start[:3], (round(rest * rate), 1)), path, later])
    times = np.arange(len(position)) / rate
    released = round(rest * rate) / rate
    seen = rng.random(len(times)) >= missing
    return times[seen], (position + noise * rng.standard_normal(position.shape))[seen], released, released + contact


@pytest.mark.parametrize("rate", [60.0, 120.0, 180.0, 500.0])
@pytest.mark.parametrize("restitution", [0.9, 0.5, 0.0])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_flight_ends_with_the_last_sample_before_the_bounce(rate, restitution, noise):
    for seed in range(5):
        time, position, _, contact = bouncing(np.random.default_rng(seed), rate, restitution, noise)
        flight = before_bounce(time, position)
        assert flight.time[0] == time[0]
        # Noise of 2 mm hides the contact for 2 mm over the jump of the velocity, one sample at 500 Hz.
        assert abs(flight.time[-1] - (contact - 0.5 / rate)) <= (0.5 + 1.0) / rate + 0.001


def test_bounce_is_found_through_dropouts():
    for seed in range(10):
        time, position, _, contact = bouncing(np.random.default_rng(seed), 180.0, 0.8, 0.001, missing=0.3)
        flight = before_bounce(time, position)
        last = time[time < contact][-1]
        assert abs(np.searchsorted(time, flight.time[-1]) - np.searchsorted(time, last)) <= 1


def test_ball_held_before_the_launch_is_cut_off():
    time, position, released, contact = bouncing(np.random.default_rng(0), 180.0, 0.8, 0.001, rest=0.3)
    flight = before_bounce(time, position)
    assert abs(flight.time[0] - released) < 0.012
    assert abs(flight.time[-1] - contact) < 0.012


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_flight_without_a_bounce_is_kept_whole(noise):
    time = np.arange(0.0, 0.7, 1 / 180.0)
    path = fly(np.array([0.0, 0.0, 1.0, 4.0, 0.0, 3.0]), time)[:, :3]
    for seed in range(10):
        flight = before_bounce(time, path + noise * np.random.default_rng(seed).standard_normal(path.shape))
        np.testing.assert_array_equal(flight.time, time)


@pytest.mark.parametrize(("count", "message"), [(5, "5 samples"), (100, "falls like a free ball")])
def test_track_that_does_not_fly_is_refused(count, message):
    position = 1.0 + 0.001 * np.random.default_rng(0).standard_normal((count, 3))
    with pytest.raises(TrainingDataError, match=message):
        before_bounce(np.arange(count) / 180.0, position)


@pytest.mark.parametrize(
    ("times", "metres", "message"),
    [
        (1e-12, 1.0, "two of its samples are 5.56e-15 s apart; are its times in s"),
        (1e-6, 1.0, "two of its samples are 5.56e-09 s apart; are its times in s"),
        (1e3, 1.0, "two of its samples are 5.56 s apart; are its times in s"),
        (1e300, 1.0, "two of its samples are 5.56e+297 s apart; are its times in s"),
        (1.0, 1e9, "m away; are its positions in m"),
        (1.0, 1e300, "m away; are its positions in m"),
    ],
)
def test_track_whose_units_are_none_of_a_ball_is_refused_in_little_memory(times, metres, message):
    time = np.arange(60) / 180.0
    path = fly(np.array([0.0, 0.0, 1.0, 4.0, 0.0, 3.0]), time)[:, :3]
    tracemalloc.start()
    try:
        with pytest.raises(TrainingDataError, match=re.escape(message)):
            before_bounce(times * time, metres * path)
        assert tracemalloc.get_traced_memory()[1] < 10e6  # [bytes]
    finally:
        tracemalloc.stop()


def test_ball_at_rest_and_a_gap_of_many_samples_are_no_trouble():
    time = np.arange(60) / 180.0
    with pytest.raises(TrainingDataError, match="falls like a free ball"):
        before_bounce(time, np.zeros((60, 3)))
    time[30:] += 0.99
    with pytest.raises(TrainingDataError, match="falls like a free ball"):
        before_bounce(time, np.ones((60, 3)))
    time[30] = time[29] + 1e-12
    with pytest.raises(TrainingDataError, match="are its times in s"):
        before_bounce(time, np.ones((60, 3)))


def test_long_track_is_searched_in_memory_that_grows_with_its_length_alone():
    def peak(count: int) -> int:
        time = np.arange(count) / 1000.0
        path = 1.0 + 1e-3 * np.random.default_rng(0).standard_normal((count, 3))
        tracemalloc.start()
        try:
            with pytest.raises(TrainingDataError, match="falls like a free ball"):
                before_bounce(time, path)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    # What is tried at once is bounded; what stays for each sample is some 60 numbers.
    assert peak(4000) - peak(2000) < 2000 * 100 * 8


@pytest.mark.parametrize(("name", "count"), [("aimy_robot_simple_0-23.csv", 24), ("aimy_mn5008_no_spin_0-4.csv", 5)])
def test_real_flights_end_at_their_lowest_point(name, count):
    recorded = read_flights(REAL / name, 0.3)
    assert (len(recorded.flights), recorded.left_out) == (count, {})
    for label, track in read_tracks(REAL / name).items():
        flight = recorded.flights[label]
        assert flight.time[0] == track.time[0]
        assert abs(len(flight.time) - 1 - int(np.argmin(track.position[:, 2]))) <= 1


def test_flights_that_cannot_be_used_are_named_with_the_reason(tmp_path):
    time = np.arange(0.0, 0.6, 1 / 180.0)
    path = fly(np.array([0.0, 0.0, 1.0, 4.0, 0.0, 3.0]), time)[:, :3]
    tracks = {"good": path, "short": path[:8], "held": np.ones((60, 3)), "brief": path[:30]}
    rows = [[name, t, *p] for name, track in tracks.items() for t, p in zip(time, track, strict=False)]
    write(tmp_path / "f.csv", rows)
    recorded = read_flights(tmp_path / "f.csv", 0.3)
    assert list(recorded.flights) == ["good"]
    assert {name: reason.split()[1] for name, reason in recorded.left_out.items()}.keys() == {"short", "held", "brief"}
    assert "8 samples" in recorded.left_out["short"]
    assert "falls" in recorded.left_out["held"]
    assert "needed are 0.3 s" in recorded.left_out["brief"]


def write(path, rows, header=("flight", "time_s", "x_m", "y_m", "z_m")):
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerows([header, *rows])


NUMBER = st.floats(-1e6, 1e6)
NAME = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1)
TRACKS = st.dictionaries(NAME, st.lists(st.tuples(NUMBER, NUMBER, NUMBER), min_size=1, max_size=5), min_size=1)


@given(tracks=TRACKS, order=st.permutations(range(6)))
def test_written_flights_are_read_whatever_the_order_of_the_columns(tmp_path_factory, tracks, order):
    path = tmp_path_factory.mktemp("csv") / "flights.csv"
    header = ("flight", "time_s", "x_m", "y_m", "z_m", "remark")
    rows = [(name, 0.1 * i, *place, "a, b") for name, places in tracks.items() for i, place in enumerate(places)]
    write(path, [[row[i] for i in order] for row in rows], [header[i] for i in order])
    read = read_tracks(path)
    assert list(read) == list(tracks)
    for name, places in tracks.items():
        np.testing.assert_array_equal(read[name].position, places)
        np.testing.assert_array_equal(read[name].time, [0.1 * i for i in range(len(places))])


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        ("", ["'flight' is missing", "flight, time_s, x_m, y_m, z_m"]),
        ("flight,time_s,x_m,y_m,zm\n", ["'z_m' is missing", "did you mean 'zm'"]),
        ("flight,time_s,x_m,x_m,y_m,z_m\n", ["'x_m' is there twice"]),
        (HEADER, ["holds no samples"]),
        (HEADER + "0,0.0,1,2\n", ["line 2", "4 values for 5 columns"]),
        (HEADER + "0,0.0,1,2,3\n0,0.1,1,two,3\n", ["line 3", "y_m is 'two'", "decimal point"]),
        (HEADER + "0,0.0,1,2,nan\n", ["line 2", "z_m is 'nan'", "leave samples out"]),
        (HEADER + "0,inf,1,2,3\n", ["line 2", "time_s is 'inf'"]),
        (HEADER + "0,0.1,1,2,\n", ["line 2", "z_m is ''"]),
        (HEADER + "0,0.2,1,2,3\n0,0.1,1,2,3\n", ["line 3", "time_s 0.1 of flight '0'", "after 0.2"]),
        (HEADER + "0,0.2,1,2,3\n0,0.2,1,2,3\n", ["line 3", "drop repeated"]),
        (HEADER + ",0.2,1,2,3\n", ["line 2", "flight has no name"]),
        (HEADER + '0,"0.2,1,2,3\n', ["is no CSV"]),
    ],
)
def test_mistakes_in_a_file_are_named_with_line_and_fix(tmp_path, content, parts):
    path = tmp_path / "flights.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(TrainingDataError) as caught:
        read_tracks(path)
    assert all(part in str(caught.value) for part in [str(path), *parts]), caught.value


def test_binary_and_missing_files_are_refused(tmp_path):
    path = tmp_path / "flights.csv"
    with pytest.raises(TrainingDataError, match="cannot read the flights"):
        read_tracks(path)
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(TrainingDataError, match="is no CSV text"):
        read_tracks(path)
