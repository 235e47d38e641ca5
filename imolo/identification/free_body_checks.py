"""What recordings of a free body say about themselves, before anything is fitted: time base, scale, noise, starts.

In the air a body obeys p(t) = p0 + v0 t + g t²/2 whatever its contacts are. So free fall shows the scale of lengths
against that of times, which axis points upwards, the noise, and recordings that begin wrongly.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imolo.contracts.urdf import read_urdf
from imolo.errors import TrainingDataError
from imolo.identification.experiment import Finding
from imolo.identification.free_body import BodyConfig, Toss, rotations

Array = NDArray[np.float64]

CLEARANCE = 0.03  # of the longest side: lower than this above the floor, contact may have begun
FEWEST_IN_AIR = 5
FIRST = 8  # frames that show whether units and axes can be right
SHORTEST_FRAME, LONGEST_FRAME = 1e-5, 0.5  # [s]
LONGEST_GAP = 1.5  # frame intervals
BEGINNING = 3  # frames in which a recording may begin wrongly
SPURIOUS = 8.0  # standard deviations of a start beside its own flight
HARMFUL = 0.01  # of the size of the body: less beside its flight is a matter of noise
AT_REST = 0.003  # [m] over the last frames
REST_FRAMES = 5
RESAMPLES = 400


@dataclass(frozen=True, eq=False)
class InAir:
    """The frames of a toss before its first contact.

    Attributes:
        toss: The toss.
        frames: How many of them.
        size: Of the body [m].
    """

    toss: Toss
    frames: int
    size: float

    @property
    def time(self) -> Array:
        """Since the first frame [s]."""
        return self.toss.time[: self.frames]


def check_tosses(
    tosses: Sequence[Toss], body: BodyConfig, resting: float | None, gravity: float = 9.81
) -> list[Finding]:
    """Look at recordings of a free body.

    Args:
        tosses: The recordings.
        body: Whose clearance above the floor tells when a contact begins.
        resting: Height of the body's frame when it lies still [m]; None where that is not one number.
        gravity: Free fall where they were made [m/s²].

    Returns:
        What was found; those of `length scale` have a value.

    Raises:
        TrainingDataError: Units or axes cannot be right.
    """
    _check_units(tosses, gravity)
    flights = [in_air(toss, body) for toss in tosses]
    return [
        *_time_base(tosses),
        *_starts_in_contact(flights),
        *_fall(flights, gravity),
        *_rest(tosses, resting),
        *_noise_and_starts(flights),
    ]


def in_air(toss: Toss, body: BodyConfig) -> InAir:
    """Return the frames before the body's lowest point comes near the floor."""
    model = read_urdf(body.urdf) if body.urdf else None
    rotation = rotations(toss.rotation).as_matrix()
    if model is None:
        half = 0.5 * np.array(body.sides)
        lowest = toss.position[:, 2] - np.abs(rotation[:, 2, :]) @ half
        reach = 2.0 * float(half.max())
    else:
        shapes = model.links[model.base].collisions
        lowest = np.array(
            [
                min(shape.lowest_point(position, turn) for shape in shapes)
                for position, turn in zip(toss.position, rotation, strict=True)
            ]
        )
        reach = float(toss.position[0, 2] - lowest[0])
    near = lowest < CLEARANCE * reach
    return InAir(toss, int(near.argmax()) if near.any() else len(near), reach)


def start_from_flight(toss: Toss, body: BodyConfig) -> Toss:
    """Return a toss whose start is that of the flight which its frames in the air show, where they are enough.

    Position and velocity are those of the parabola, the angular velocity the mean turn about an axis that stays: exact
    for bodies whose moments of inertia are equal, and for short flights of others.
    """
    flight = in_air(toss, body)
    if flight.frames < FEWEST_IN_AIR:
        return toss
    time = flight.time
    start = _parabola(flight, _gravity([flight]))[:2]
    turn = rotations(toss.rotation[: flight.frames])
    steps = (turn[1:] * turn[:-1].inv()).as_rotvec()
    spin = steps.sum(axis=0) / time[-1]
    position = toss.position.copy()
    position[0] = start[0]
    return replace(toss, position=position, velocity=start[1], angular_velocity=spin)


def _check_units(tosses: Sequence[Toss], gravity: float) -> None:
    """Refuse recordings whose first frames, mostly in the air, accelerate as nothing does that is in SI with z up."""
    interval = float(np.median(np.concatenate([np.diff(toss.time) for toss in tosses])))
    if not SHORTEST_FRAME < interval < LONGEST_FRAME:
        raise TrainingDataError(f"a frame lasts {interval:g} s; are the times in ms? time_s is in seconds")
    curvatures = [
        np.polynomial.polynomial.polyfit(toss.time[:FIRST] - toss.time[0], toss.position[:FIRST], 2)[2]
        for toss in tosses
    ]
    fall = 2.0 * np.median(curvatures, axis=0)
    size = float(np.linalg.norm(fall))
    if size > 2.0 * gravity:
        raise TrainingDataError(
            f"bodies fall at {size:.4g} m/s², not at {gravity:g}; are lengths in mm or cm? x_m y_m z_m are in metres"
        )
    axis = int(np.abs(fall).argmax())
    if size > 0.5 * gravity and (axis != 2 or fall[2] > 0.0):
        down, up = ("", "-") if fall[axis] > 0.0 else ("-", "")
        name = "xyz"[axis]
        raise TrainingDataError(
            f"bodies fall along {down}{name}, not along -z; turn the recordings so that {up}{name} becomes z"
        )


def _time_base(tosses: Sequence[Toss]) -> list[Finding]:
    intervals = [np.diff(toss.time) for toss in tosses]
    usual = float(np.median(np.concatenate(intervals)))
    gaps = tuple(toss.name for toss, steps in zip(tosses, intervals, strict=True) if steps.max() > LONGEST_GAP * usual)
    found = [Finding("time base", f"{1.0 / usual:.1f} frames per second, {len(tosses)} recordings")]
    if gaps:
        found.append(Finding("gaps", f"{len(gaps)} recordings have lost frames", warning=True, recordings=gaps))
    return found


def _starts_in_contact(flights: Sequence[InAir]) -> list[Finding]:
    touching = tuple(flight.toss.name for flight in flights if flight.frames == 0)
    if not touching:
        return []
    text = f"{len(touching)} recordings begin on the floor or in contact"
    return [Finding("start in contact", text, warning=True, recordings=touching, unusable=True)]


def _long_enough(flights: Sequence[InAir]) -> list[InAir]:
    return [flight for flight in flights if flight.frames >= FEWEST_IN_AIR]


def _gravity(flights: Sequence[InAir]) -> Array:
    """Return the acceleration that flights share, each with a start of its own [m/s²], shape (3,)."""
    normal, right = 0.0, np.zeros(3)
    for flight in flights:
        basis = np.stack([np.ones(flight.frames), flight.time], axis=1)
        half = 0.5 * flight.time**2
        half = half - basis @ np.linalg.lstsq(basis, half, rcond=None)[0]
        normal += float(half @ half)
        right += half @ flight.toss.position[: flight.frames]
    return np.asarray(right / normal)


def _fall(flights: Sequence[InAir], gravity: float) -> list[Finding]:
    flying = _long_enough(flights)
    if len(flying) < 3:
        return [Finding("free fall", "too few recordings fly long enough to see gravity", warning=True)]
    found = _gravity(flying)
    chance = np.random.default_rng(0)
    drawn = [
        _gravity([flying[index] for index in chance.integers(len(flying), size=len(flying))]) for _ in range(RESAMPLES)
    ]
    deviation = np.std(drawn, axis=0)
    fall = -float(found[2])
    text = f"{fall:.3f} ± {deviation[2]:.3f} m/s² downwards"
    findings = [Finding("free fall", text, value=fall, deviation=float(deviation[2]))]
    tilt = np.degrees(np.hypot(*found[:2]) / fall)
    if tilt > max(1.0, 3.0 * np.degrees(np.hypot(*deviation[:2]) / fall)):
        findings.append(Finding("axes", f"free fall is {tilt:.1f}° off the z axis; is the frame level?", warning=True))
    scale = gravity / fall
    spread = float(scale * deviation[2] / fall)
    off = abs(scale - 1.0) > 3.0 * spread and abs(scale - 1.0) > 0.005
    text = f"lengths times {scale:.4f} ± {spread:.4f} would fall at {gravity:g} m/s²"
    findings.append(Finding("length scale", text, warning=off, value=scale, deviation=spread))
    return findings


def _rest(tosses: Sequence[Toss], resting: float | None) -> list[Finding]:
    last = [toss.position[-REST_FRAMES:] for toss in tosses]
    still = [bool(np.ptp(end, axis=0).max() < AT_REST) for end in last]
    moving = tuple(toss.name for toss, quiet in zip(tosses, still, strict=True) if not quiet)
    found = []
    if moving:
        found.append(Finding("end", f"{len(moving)} recordings end before the body is at rest", recordings=moving))
    heights = np.array([end[:, 2].mean() for end, quiet in zip(last, still, strict=True) if quiet])
    if resting is None or len(heights) < 3:
        return found
    height = float(np.median(heights))
    deviation = float(1.4826 * np.median(np.abs(heights - height)) / np.sqrt(len(heights)))
    scale = resting / height
    off = abs(scale - 1.0) > 0.005
    text = (
        f"it rests {1e3 * height:.2f} ± {1e3 * deviation:.2f} mm high, its sides say {1e3 * resting:.2f}: "
        f"lengths times {scale:.4f}"
    )
    found.append(Finding("height at rest", text, warning=off, value=scale, deviation=scale * deviation / height))
    return found


def _parabola(flight: InAir, gravity: Array) -> Array:
    """Return position and velocity at the first frame, and the residuals after them, shape (2 + N, 3)."""
    basis = np.stack([np.ones(flight.frames), flight.time], axis=1)
    fallen = flight.toss.position[: flight.frames] - 0.5 * gravity * flight.time[:, None] ** 2
    start = np.linalg.lstsq(basis, fallen, rcond=None)[0]
    return np.concatenate([start, fallen - basis @ start])


def _jump(flight: InAir, gravity: Array) -> float:
    """Return how far the first frames lie beside the parabola of the others [m]."""
    fallen = flight.toss.position[: flight.frames] - 0.5 * gravity * flight.time[:, None] ** 2
    basis = np.stack([np.ones(flight.frames), flight.time], axis=1)
    others = np.linalg.lstsq(basis[BEGINNING:], fallen[BEGINNING:], rcond=None)[0]
    return float(np.abs(fallen[:BEGINNING] - basis[:BEGINNING] @ others).max())


def _noise_and_starts(flights: Sequence[InAir]) -> list[Finding]:
    flying = _long_enough(flights)
    if len(flying) < 3:
        return []
    gravity = _gravity(flying)
    off = [_parabola(flight, gravity)[2:] for flight in flying]
    noise = float(np.median([np.sqrt(np.mean(residual**2)) for residual in off]))
    found = [Finding("noise", f"{1e3 * noise:.2f} mm rms beside free flight", value=noise)]
    speeds = np.array([np.linalg.norm(_parabola(flight, gravity)[1] - flight.toss.velocity) for flight in flying])
    usual = float(np.median(speeds))
    wrong = tuple(
        flight.toss.name
        for flight, speed in zip(flying, speeds, strict=True)
        if _jump(flight, gravity) > max(SPURIOUS * noise, HARMFUL * flight.size) or speed > SPURIOUS * max(usual, 1e-3)
    )
    if wrong:
        text = f"{len(wrong)} recordings do not begin as they fly on: position or velocity jumps"
        found.append(Finding("spurious start", text, warning=True, recordings=wrong, unusable=True))
    return found
