"""The check of the data, before anything is fitted, against flights whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_tosses import CUBE, RATE, SIDE, cube_config, parabolas, thrown

from imolo.errors import TrainingDataError
from imolo.identification.experiment import Finding
from imolo.identification.free_body import Toss, as_metres
from imolo.identification.free_body_checks import check_tosses, start_from_flight

NOISE = 1e-4  # [m]


def found(tosses: list[Toss], gravity: float = 9.81, resting: float | None = None) -> dict[str, Finding]:
    return {one.what: one for one in check_tosses(tosses, CUBE, resting, gravity)}


def test_free_fall_noise_and_time_base_are_found() -> None:
    findings = found(parabolas(number=20, noise=NOISE))
    fall = findings["free fall"]
    assert fall.value == pytest.approx(9.81, abs=4.0 * (fall.deviation or 0.0))
    # An acceleration from N samples over T: sd 12 sqrt(5) noise / (T² sqrt(N)), here of 20 flights of 30 frames.
    assert fall.deviation == pytest.approx(12.0 * 5**0.5 * NOISE / (30 / RATE) ** 2 / 600**0.5, rel=0.5)
    # Two of 30 numbers per axis are those of the start.
    assert findings["noise"].value == pytest.approx(NOISE * (28 / 30) ** 0.5, rel=0.1)
    assert findings["time base"].text.startswith("148.0 frames per second")
    assert not any(one.warning for one in findings.values())


@pytest.mark.parametrize("factor", [0.97, 1.022, 1.05])
def test_the_length_scale_is_found(factor: float) -> None:
    tosses = [as_metres(toss, 1.0 / factor) for toss in parabolas(number=20, noise=NOISE)]
    scale = found(tosses)["length scale"]
    assert scale.value == pytest.approx(factor, abs=4.0 * (scale.deviation or 0.0))
    assert scale.deviation is not None
    assert scale.deviation < 0.003
    assert scale.warning


def test_the_height_at_rest_shows_the_scale_as_well() -> None:
    tosses = [as_metres(toss, 1.0 / 1.022) for toss in thrown(cube_config(), number=6, duration=2.0)]
    rest = found(tosses, resting=0.5 * SIDE)["height at rest"]
    # MuJoCo's contacts give way by some hundredths of a millimetre.
    assert rest.value == pytest.approx(1.022, abs=0.001)


def test_another_gravity_is_no_other_scale() -> None:
    findings = found(parabolas(gravity=1.62, noise=NOISE), gravity=1.62)
    assert not findings["length scale"].warning


def test_bodies_that_fall_straight_down_are_checked() -> None:
    straight = [0.0, 0.0, 1.0]
    tosses = [replace(one, position=one.position * straight, velocity=one.velocity * straight) for one in parabolas()]
    assert found(tosses)["free fall"].value == pytest.approx(9.81, abs=1e-6)


def test_a_recording_that_begins_wrongly_is_left_out() -> None:
    tosses = parabolas(number=20, noise=NOISE)
    jumped = tosses[3].position.copy()
    jumped[0] += [0.0, 0.002, 0.0]
    tosses[3] = replace(tosses[3], position=jumped)
    tosses[5] = replace(tosses[5], velocity=tosses[5].velocity + np.array([0.0, 2.0, 0.0]))
    spurious = found(tosses)["spurious start"]
    assert spurious.recordings == ("3", "5")
    assert spurious.unusable


def test_a_recording_that_starts_in_contact_is_left_out() -> None:
    tosses = parabolas(number=20)
    tosses[4] = replace(
        tosses[4], position=tosses[4].position - np.array([0.0, 0.0, tosses[4].position[0, 2] - 0.5 * SIDE])
    )
    contact = found(tosses)["start in contact"]
    assert contact.recordings == ("4",)
    assert contact.unusable


def test_lost_frames_are_told() -> None:
    tosses = parabolas()
    keep = np.r_[0:10, 13:30]
    changes = {name: getattr(tosses[2], name)[keep] for name in ("time", "position", "rotation")}
    tosses[2] = replace(tosses[2], **changes)
    assert found(tosses)["gaps"].recordings == ("2",)


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "mm or cm"), (1e2, "mm or cm")])
def test_lengths_that_are_no_metres_are_refused(factor: float, unit: str) -> None:
    with pytest.raises(TrainingDataError, match=f"are lengths in {unit}"):
        found([as_metres(toss, factor) for toss in parabolas(noise=NOISE)])


def test_times_that_are_no_seconds_are_refused() -> None:
    with pytest.raises(TrainingDataError, match="are the times in ms"):
        found([replace(toss, time=1e3 * toss.time) for toss in parabolas()])


@pytest.mark.parametrize(("axes", "up"), [((0, 2, 1), "y"), ((2, 1, 0), "x")])
def test_another_axis_that_points_up_is_refused(axes: tuple[int, int, int], up: str) -> None:
    with pytest.raises(TrainingDataError, match=f"so that {up} becomes z"):
        found(parabolas(noise=NOISE, axes=axes))


def test_a_z_axis_that_points_down_is_refused() -> None:
    with pytest.raises(TrainingDataError, match="so that -z becomes z"):
        found([replace(toss, position=-toss.position) for toss in parabolas()])


def test_the_start_of_the_flight_is_nearer_the_truth_than_the_first_frames() -> None:
    for noisy, exact in zip(parabolas(noise=NOISE), parabolas(), strict=True):
        guessed = replace(noisy, velocity=(noisy.position[1] - noisy.position[0]) * RATE)
        start = start_from_flight(guessed, CUBE)
        # The slope at the start of a parabola through 30 samples over .2 s: sd sqrt(192) noise / (T sqrt(N)); five.
        np.testing.assert_allclose(start.velocity, exact.velocity, atol=5 * 192**0.5 * NOISE / (0.2 * 30**0.5))
        assert np.linalg.norm(start.velocity - exact.velocity) < np.linalg.norm(guessed.velocity - exact.velocity)
