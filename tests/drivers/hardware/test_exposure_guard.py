"""Frames whose exposure cannot be true, told by hand-made clocks."""

import numpy as np
import pytest

from imolo_drivers.exposure_guard import ExposureGuard, ExposureLimits

LIMITS = ExposureLimits()
BEGIN, FRAME, LATENCY, ERROR = 1000.0, 1 / 120, 0.004, 1e-4  # [s]


def heard(guard: ExposureGuard, exposures: list[float]) -> list[bool]:
    """Give frames that come once a period; return which are accepted. Exposures count from `BEGIN`."""
    return [
        guard.accept(BEGIN + exposed, ERROR, BEGIN + i * FRAME + LATENCY)
        for i, exposed in enumerate(exposures, start=1)
    ]


def exposures(count: int) -> list[float]:
    return [i * FRAME for i in range(1, count + 1)]


@pytest.mark.parametrize("wild", [60.0, 1.0, -1.0, -60.0, 1e9, -1e9])
def test_one_wild_exposure_is_left_out_and_nothing_else(wild: float) -> None:
    guard = ExposureGuard(LIMITS, BEGIN)
    told = exposures(20)
    told[7] += wild
    assert heard(guard, told) == [i != 7 for i in range(20)]
    assert guard.refused.total() == (BEGIN + told[7] > BEGIN)
    assert guard.problem == ""


def test_a_stamp_that_is_early_within_the_margin_costs_one_frame_at_most() -> None:
    guard = ExposureGuard(LIMITS, BEGIN)
    told = exposures(20)
    told[7] += LATENCY + LIMITS.ahead  # the latest that may be true
    accepted = heard(guard, told)
    assert accepted[:8] + accepted[9:] == [True] * 19


@pytest.mark.parametrize("jitter", [0.0, ERROR])
def test_exposures_that_stand_still_are_no_sign_of_life(jitter: float) -> None:
    """The clocks may place one and the same stamp anywhere within their error."""
    guard = ExposureGuard(LIMITS, BEGIN)
    places = np.random.default_rng(1).uniform(-jitter, jitter, 60)
    accepted = heard(guard, [5 * FRAME + place for place in places])
    assert accepted.index(True) == 4  # before that it lies ahead
    assert sum(accepted) == 1
    assert guard.heard == BEGIN + 5 * FRAME + LATENCY
    assert "exposed" in guard.problem


@pytest.mark.parametrize("rate", [0.0, 0.5, -1.0, 3.0])
def test_exposures_at_a_wrong_pace_end_as_silence(rate: float) -> None:
    guard = ExposureGuard(LIMITS, BEGIN)
    accepted = heard(guard, [0.1 + rate * exposed for exposed in exposures(240)])
    assert not any(accepted[120:])
    assert guard.problem


def test_frames_of_before_the_beginning_are_left_out_and_not_counted() -> None:
    guard = ExposureGuard(LIMITS, BEGIN)
    assert heard(guard, [-0.01, 0.0]) == [False, False]
    assert guard.refused.total() == 0
    assert not guard.is_news
    assert guard.heard == BEGIN


def test_each_kind_of_false_exposure_is_news_once() -> None:
    guard = ExposureGuard(LIMITS, BEGIN)
    told = exposures(60)
    for place, wild in ((5, 60.0), (6, 70.0), (46, 60.0), (50, -0.3)):
        told[place] += wild
    told[12] = told[11]  # two of one moment
    news = []
    for i, exposed in enumerate(told, start=1):
        accepted = guard.accept(BEGIN + exposed, ERROR, BEGIN + i * FRAME + LATENCY)
        news += [i - 1] if guard.is_news and not accepted else []
    assert news == [5, 12, 50]
    assert guard.refused.total() == 5


def test_the_oldest_and_the_newest_exposure_that_can_be_true() -> None:
    now = BEGIN + 1.0
    for exposed, true in (
        (now - LIMITS.oldest - ERROR + 1e-6, True),
        (now - LIMITS.oldest - ERROR - 1e-6, False),
        (now + LIMITS.ahead + ERROR - 1e-6, True),
        (now + LIMITS.ahead + ERROR + 1e-6, False),
    ):
        assert ExposureGuard(LIMITS, BEGIN).accept(exposed, ERROR, now) is true
