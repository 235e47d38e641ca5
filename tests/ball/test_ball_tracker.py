import logging

import numpy as np
import pytest
from aerodynamic_flights import known
from ball_flights import RATE, drag, fly, make_frame, record, release
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from imolo.ball.fit import fit_ball_model
from imolo.ball.model import BallModelConfig, chi_square_quantile
from imolo.ball.tracker import BallTracker, BallTrackerConfig
from imolo_msgs import ball_state_t

NOISE = 0.002  # [m]
REST = 20  # frames before the release
START = 1_000_000  # [µs]


@pytest.fixture(scope="module")
def model():
    flights = record(np.random.default_rng(0), count=10, noise=NOISE)
    return fit_ball_model(flights, BallModelConfig(structure="diagonal", density_grid=(1e-3, 3e-3, 1e-2)))


def scene(rng, swing=0.0, duration=1.0):
    """True states, shape (N, 6), of a ball at rest, swung for `swing` [s] and thrown; index of the release."""
    start = release(rng)
    before = -np.arange(round(swing * RATE), 0, -1)[:, None] / RATE
    pull = start[3:] / swing if swing else np.zeros(3)
    swung = np.hstack([start[:3] + before * start[3:] + 0.5 * before**2 * pull, start[3:] + before * pull])
    hand = np.concatenate([swung[0, :3] if swing else start[:3], np.zeros(3)])
    flight = fly(start, np.arange(0.0, duration, 1.0 / RATE))
    return np.concatenate([np.tile(hand, (REST, 1)), swung, flight]), REST + len(before)


@pytest.mark.parametrize("freedom", [3, 6, 12])
def test_gates_are_quantiles_of_chi_square(freedom):
    # scipy works out both by the same function.
    assert chi_square_quantile(0.999, freedom) == chi2.ppf(0.999, freedom)


def utime(index):
    return START + round(index * 1e6 / RATE)


def frames(states, rng, noise=NOISE):
    return [make_frame(utime(i), [x[:3] + noise * rng.standard_normal(3)]) for i, x in enumerate(states)]


def position_error(estimate, state):
    return np.linalg.norm(estimate.state[:3] - state[:3])


def test_ball_at_rest_is_seen_but_does_not_fly(model):
    rng, tracker = np.random.default_rng(1), BallTracker(model)
    estimates = [tracker.update(frame) for frame in frames(np.tile([5.0, 0.0, 1.1, 0, 0, 0], (500, 1)), rng)]
    assert all(e is None for e in estimates[: tracker.config.launch_frames - 1])
    assert all(not e.in_flight for e in estimates[tracker.config.launch_frames - 1 :])
    assert position_error(estimates[-1], np.array([5.0, 0.0, 1.1])) < 5 * NOISE * np.sqrt(3)
    np.testing.assert_array_equal(estimates[-1].covariance[3:, 3:], 10.0**2 * np.eye(3))  # faster than any throw


def test_flight_is_reported_from_the_release_on(model):
    for seed in range(10):
        rng, tracker = np.random.default_rng(seed), BallTracker(model)
        states, released = scene(rng)
        estimates = [tracker.update(frame) for frame in frames(states, rng)]
        flying = [i for i, e in enumerate(estimates) if e is not None and e.in_flight]
        assert released <= flying[0] < released + tracker.config.launch_frames
        assert flying == list(range(flying[0], len(states)))
        speed_noise = np.sqrt(np.trace(estimates[flying[0]].covariance[3:, 3:]))
        assert np.linalg.norm((estimates[flying[0]].state - states[flying[0]])[3:]) < 4 * speed_noise
        assert np.linalg.norm(states[-1, :3] - [0.0, 0.0, 0.7]) < tracker.config.detection_distance


def test_swing_of_the_thrower_does_not_spoil_the_track(model):
    # At release the arm stops pushing with 35 m/s² or more, which a filter that began in the swing must forget.
    for seed in range(10):
        for swing in (0.1, 0.2):
            rng, tracker = np.random.default_rng(seed), BallTracker(model)
            states, released = scene(rng, swing)
            estimates = [tracker.update(frame) for frame in frames(states, rng)]
            for i in range(released + 12, len(states)):
                assert estimates[i].in_flight
                assert position_error(estimates[i], states[i]) < 0.02
            # Six samples alone leave 4 σ sqrt(3) sqrt(12 / 6³) / Δt = 0.4 m/s; nine frames after release it is half.
            i = released + 9
            assert np.linalg.norm((estimates[i].state - states[i])[3:]) < 0.2


def test_near_marker_and_labelled_marker_are_not_the_ball(model):
    tracker = BallTracker(model)
    flight = fly(np.array([1.5, 0.0, 1.0, -3.0, 0.0, 3.0]), np.arange(0.0, 0.4, 1 / RATE))
    far = fly(release(np.random.default_rng(2)), np.arange(0.0, 0.4, 1 / RATE))
    for i, (near, labelled) in enumerate(zip(flight, far, strict=True)):
        robot = [(0.0, 0.1 * k, 0.7) for k in range(30)]
        assert tracker.update(make_frame(utime(i), [near[:3]], [*robot, labelled[:3]])) is None


@pytest.mark.parametrize("place", [1e4, 1e8, 1e100, 1e160, 1.7e308])
@pytest.mark.parametrize("kind", ["linear", "spin"])
def test_marker_beyond_all_measure_spoils_no_flight(model, kind, place):
    """What a camera, or another program on its bus, may send; finite, but its square is not."""
    chosen = model if kind == "linear" else known(kind)
    rng, tracker, alone = np.random.default_rng(1), BallTracker(chosen), BallTracker(chosen)
    states, _ = scene(rng)
    for i, frame in enumerate(frames(states, rng)):
        ball = frame.markers[-1].marker_position
        estimate, expected = tracker.update(make_frame(utime(i), [(place, 0.0, 1.0), ball])), alone.update(frame)
        flies = expected is not None and expected.in_flight
        assert flies == (estimate is not None and estimate.in_flight)
        if flies:
            assert np.array_equal(estimate.state, expected.state)


def test_ghosts_do_not_capture_the_track(model):
    for seed in range(10):
        rng, tracker = np.random.default_rng(seed), BallTracker(model)
        states, released = scene(rng)
        for i, x in enumerate(states):
            ghosts = rng.uniform([0.0, -2.0, 0.0], [6.0, 2.0, 3.0], (rng.integers(0, 4), 3))
            markers = rng.permutation(np.vstack([ghosts, x[:3] + NOISE * rng.standard_normal(3)]))
            estimate = tracker.update(make_frame(utime(i), markers))
            if i < released:
                assert estimate is None or not estimate.in_flight
            elif i >= released + 12:
                assert position_error(estimate, x) < 0.02
        assert tracker.counters.dropouts == 0
        assert tracker.counters.ghosts > 50


def test_track_survives_dropouts_and_lost_frames(model):
    rng, tracker = np.random.default_rng(3), BallTracker(model)
    states, released = scene(rng)
    blind, lost = range(released + 40, released + 60), range(released + 80, released + 100)
    for i, frame in enumerate(frames(states, rng)):
        if i in lost:
            continue
        estimate = tracker.update(make_frame(utime(i), []) if i in blind else frame)
        if i >= released + 12:
            assert estimate.in_flight
            # Blind for 0.17 s the misfit of the linear model, up to 2 m/s², adds 30 mm.
            assert position_error(estimate, states[i]) < 0.02 + 0.03 * (i in blind or i == lost[-1] + 1)
    assert tracker.counters.dropouts == len(blind)


def test_track_without_markers_is_dropped_after_the_coast_time(model):
    rng, tracker = np.random.default_rng(4), BallTracker(model)
    states, _ = scene(rng, duration=0.5)
    for frame in frames(states, rng):
        tracker.update(frame)
    last, coast = len(states) - 1, tracker.config.coast_time
    known = [tracker.update(make_frame(utime(last + k), [])) is not None for k in range(1, 60)]
    assert known == [k / RATE <= coast + 1e-6 for k in range(1, 60)]


@given(order=st.permutations(range(8)))
@settings(max_examples=20, deadline=None)
def test_late_frames_change_nothing(model, order):
    rng = np.random.default_rng(5)
    states, released = scene(rng, duration=0.4)
    in_order = frames(states, rng)
    window = range(released + 20, released + 28)
    arrival = [window[k] for k in order]
    newest = [i for k, i in enumerate(arrival) if i == max(arrival[: k + 1])]
    shuffled, filtered = BallTracker(model), BallTracker(model)
    before, after = [*range(window[0])], [*range(window[-1] + 1, len(states))]
    with_late = [shuffled.update(in_order[i]) for i in [*before, *arrival, *after]]
    without = [filtered.update(in_order[i]) for i in [*before, *newest, *after]]
    np.testing.assert_array_equal(with_late[-1].state, without[-1].state)
    np.testing.assert_array_equal(with_late[-1].covariance, without[-1].covariance)
    assert sum(e is None for e in with_late) - sum(e is None for e in without) == len(arrival) - len(newest)
    assert shuffled.counters.late_frames == len(arrival) - len(newest)


def test_frame_that_comes_twice_counts_once(model):
    rng = np.random.default_rng(5)
    seen = frames(scene(rng, duration=0.4)[0], rng)
    once, twice = BallTracker(model), BallTracker(model)
    for frame in seen:
        expected, found = once.update(frame), twice.update(frame)
        assert twice.update(frame) is None
        assert (found is None) == (expected is None)
    np.testing.assert_array_equal(found.covariance, expected.covariance)
    assert twice.counters.late_frames == len(seen)


def test_marker_that_is_not_finite_is_ignored_counted_and_warned_of_once(model, caplog):
    rng, tracker, clean = np.random.default_rng(6), BallTracker(model), BallTracker(model)
    states, _ = scene(rng)
    with caplog.at_level(logging.WARNING):
        for i, x in enumerate(states):
            spoilt = make_frame(utime(i), [[np.nan, 0.0, 1.0], x[:3]], [(0.0, 0.0, 0.7), (np.inf, 0.0, 0.7)])
            estimate, expected = tracker.update(spoilt), clean.update(make_frame(utime(i), [x[:3]], [(0.0, 0.0, 0.7)]))
            assert (estimate is None) == (expected is None)
    np.testing.assert_array_equal(estimate.state, expected.state)
    assert tracker.counters.invalid_markers == 2 * len(states)
    assert len(caplog.records) == 1


def test_frames_at_any_time_are_followed_exactly(model):
    # The model's own ball, without noise, at intervals from 1 to 40 ms: only the 1 µs of utime and R remain.
    rng, tracker = np.random.default_rng(7), BallTracker(model)
    start = release(rng)
    instants = START + np.cumsum(rng.integers(1_000, 9_000, 8).tolist() + rng.integers(1_000, 40_000, 25).tolist())
    for time in instants:
        A, B, _ = model.transition((time - START) * 1e-6)
        truth = A @ start + B
        estimate = tracker.update(make_frame(time, [truth[:3]]))
    np.testing.assert_allclose(estimate.state, truth, rtol=0, atol=1e-6)


def test_filter_is_consistent_in_its_own_world(model):
    # NEES of independent runs is χ² with 6 degrees of freedom each; the sum lies outside the bounds once in 10,000.
    rng, runs, total = np.random.default_rng(8), 60, 0.0
    A, B, Q = model.transition(1.0 / RATE)
    for _ in range(runs):
        tracker, x = BallTracker(model), release(rng)
        for i in range(60):
            estimate = tracker.update(
                make_frame(START + i * 1e6 / RATE, [x[:3] + model.measurement_std * rng.normal(size=3)])
            )
            truth, x = x, A @ x + B + rng.multivariate_normal(np.zeros(6), Q)
        error = estimate.state - truth
        total += error @ np.linalg.solve(estimate.covariance, error)
    assert chi2.ppf(0.5e-4, 6 * runs) < total < chi2.ppf(1 - 0.5e-4, 6 * runs)


def test_prediction_of_the_drag_ball_beats_a_drag_free_one(model):
    errors, without_drag = [], []
    ahead = round(0.5 * RATE)
    for seed in range(10):
        rng, tracker = np.random.default_rng(100 + seed), BallTracker(model)
        states, released = scene(rng)
        for i, frame in enumerate(frames(states, rng)):
            estimate = tracker.update(frame)
            if released + 12 <= i < len(states) - ahead:
                A, B, _ = model.transition(ahead / RATE)
                errors.append(np.linalg.norm((A @ estimate.state + B - states[i + ahead])[:3]))
                fall = estimate.state[:3] + 0.5 * estimate.state[3:] - [0.0, 0.0, 0.5 * 9.81 * 0.25]
                without_drag.append(np.linalg.norm(fall - states[i + ahead, :3]))
    assert np.mean(errors) < 0.1 * np.mean(without_drag)
    assert np.mean(errors) < 0.03


def test_robot_is_remembered_and_nothing_is_detected_before_it_is_known(model, caplog):
    rng, tracker = np.random.default_rng(9), BallTracker(model)
    states, _ = scene(rng)
    for i in range(10):
        assert tracker.update(make_frame(utime(i), [states[i, :3]], labelled=[])) is None
    assert len(caplog.records) == 1
    tracker.update(make_frame(utime(10), []))
    estimates = [tracker.update(make_frame(utime(i), [states[i, :3]], labelled=[])) for i in range(11, len(states))]
    assert estimates[-1].in_flight


def test_reset_tracker_is_as_new(model):
    rng, tracker = np.random.default_rng(10), BallTracker(model)
    states, _ = scene(rng)
    stream = frames(states, rng)
    first = [tracker.update(frame) for frame in stream]
    assert tracker.update(stream[0]) is None
    tracker.reset()
    again = [tracker.update(frame) for frame in stream]
    assert tracker.counters.late_frames == 0
    np.testing.assert_array_equal(first[-1].state, again[-1].state)


def test_next_throw_is_found_after_the_ball_was_hit(model):
    rng, tracker = np.random.default_rng(11), BallTracker(model, BallTrackerConfig(coast_time=0.1))
    first, _ = scene(rng)
    hit = fly(first[-1] * [1, 1, 1, -0.5, 0.8, -0.3], np.arange(0.0, 0.4, 1 / RATE), drag)
    second, released = scene(rng)
    estimates = [tracker.update(frame) for frame in frames(np.concatenate([first, hit, second]), rng)]
    offset = len(first) + len(hit)
    assert not estimates[offset + released - 1].in_flight
    assert position_error(estimates[-1], second[-1]) < 0.02


def test_estimate_survives_the_message(model):
    rng, tracker = np.random.default_rng(12), BallTracker(model)
    states, _ = scene(rng)
    for frame in frames(states, rng):
        estimate = tracker.update(frame)
    received = ball_state_t.decode(estimate.to_message().encode())
    assert received.utime == utime(len(states) - 1)
    np.testing.assert_array_equal([*received.ball_position, *received.ball_velocity], estimate.state)
    np.testing.assert_array_equal(received.covariance, estimate.covariance)
