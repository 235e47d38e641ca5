"""Find the free flight of a recorded ball before it bounces or is hit, for any ball and any rate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imolo.ball.flight import FEWEST_SAMPLES, GRAVITY, LEAST_NOISE, Flight
from imolo.errors import TrainingDataError

Array = NDArray[np.float64]

WINDOW = 0.05  # [s] of free flight on each side of a contact, if there is as much
FEWEST_IN_WINDOW = 6  # twice the unknowns of a quadratic
AIR = 5.0  # [m/s²] standard deviation of the acceleration about gravity: lift and drag, or the hand that holds the ball
CERTAIN = 4.0  # standard deviations that noise exceeds once in 16,000; then it costs the sample at an end
LIKELY = 4.0  # twice the logarithm of a ratio of likelihoods: two standard deviations
LEAST_CHANGE = 0.5  # share of the velocity that a contact changes: towards the floor, or of the faster side
LEAST_JUMP = float(np.linalg.norm(GRAVITY)) * WINDOW  # [m/s] less is not told from what gravity does in a window
MOST_GAIN = 3.0  # times the velocity of falling; a floor gives twice of it at most, a throw from rest any
NOISE_REACH = 4  # windows on each side that tell the noise
STEPS = 4  # to try for the time of a contact in each period of the samples
LONGEST_GAP = 1.0  # [s] between two samples of one flight, assumed
SHORTEST_GAP = 1e-6  # [s] assumed: no camera takes more than a million pictures a second
FARTHEST = 1e6  # [m] assumed
MOST_SAMPLES = 100_000  # of a track, assumed: ten minutes at 160 Hz
MOST_TRIES = 1000  # for the time of a contact in one gap
AT_ONCE = 100_000  # samples about contacts, which bounds the memory
FALLING = (0.25, 3.0)  # [g] downward acceleration of a flying ball, lift and drag included; at rest it is 0


def before_bounce(time: Array, position: Array) -> Flight:
    """Cut the free flight before the first bounce out of a recorded track.

    Where a ball touches something its velocity jumps, its position does not. Two flights that meet so are compared with
    a single one at every time that a contact may have; a side may have one sample only. The track is parted where a
    jump is certain against the noise and takes at least half of a downward velocity, which is a bounce, or is half of
    the speed, as a launch or a hit. Of the parts before the first bounce the longest one that falls is the flight.

    Args:
        time: Time of the samples, increasing, gaps allowed [s], shape (N,).
        position: Measured positions, z up [m], shape (N, 3).

    Returns:
        The samples of the free flight, up to the last one before the contact.

    Raises:
        TrainingDataError: The track is too short, or nothing in it falls freely.
    """
    if len(time) < FEWEST_SAMPLES:
        raise TrainingDataError(f"it has {len(time)} samples; a flight needs {FEWEST_SAMPLES}")
    _check_scale(time, position)
    start, parts = 0, []
    for kink, bounces in _kinks(time, position):
        parts.append((start, kink))
        start = kink
        if bounces:
            break
    else:
        parts.append((start, len(time)))
    falling = [part for part in parts if part[1] - part[0] >= FEWEST_SAMPLES and _falls(time, position, *part)]
    if not falling:
        raise TrainingDataError(
            f"none of its {len(parts)} parts before a bounce has {FEWEST_SAMPLES} samples and falls like a free ball"
        )
    first, last = max(falling, key=lambda part: time[part[1] - 1] - time[part[0]])
    return Flight(time=time[first:last], position=position[first:last])


def _falls(time: Array, position: Array, first: int, last: int) -> bool:
    curvature = np.polynomial.Polynomial.fit(time[first:last], position[first:last, 2], 2).deriv(2)(time[first])
    low, high = (share * np.linalg.norm(GRAVITY) for share in FALLING)
    return bool(low <= -curvature <= high)


def _check_scale(time: Array, position: Array) -> None:
    """Refuse what no camera saw of a ball.

    Raises:
        TrainingDataError: Times or positions are too far apart, or too many.
    """
    gaps, farthest = np.diff(time), float(np.abs(position).max())
    if len(time) > MOST_SAMPLES:
        raise TrainingDataError(f"it has {len(time)} samples; give every throw a name of its own")
    if gaps.max() > LONGEST_GAP:
        raise TrainingDataError(f"two of its samples are {gaps.max():.3g} s apart; are its times in s?")
    if gaps.min() < SHORTEST_GAP:
        raise TrainingDataError(f"two of its samples are {gaps.min():.3g} s apart; are its times in s?")
    if farthest > FARTHEST:
        raise TrainingDataError(f"it is {farthest:.3g} m away; are its positions in m?")


def _kinks(time: Array, position: Array) -> list[tuple[int, bool]]:
    """Return the first sample after each jump of the velocity, and whether the jump is a bounce."""
    gaps = np.diff(time)
    period = float(np.median(gaps))
    size = min(max(FEWEST_IN_WINDOW, round(WINDOW / period)), len(time))
    tries = np.minimum(STEPS * np.ceil(gaps / period), MOST_TRIES).astype(int)
    split = np.repeat(np.arange(1, len(time)), tries)
    share = np.concatenate([(np.arange(count) + 0.5) / count for count in tries])
    contact = time[split - 1] + share * gaps[split - 1]
    noise = _noise(time, position, size)[split]
    evidence = np.zeros(len(split))
    for some in np.array_split(np.arange(len(split)), 1 + len(split) * size // AT_ONCE):
        each = _Meetings.fit(time, position, split[some], contact[some], size, noise[some])
        evidence[some] = np.where(each.bounces() | each.hits(), each.evidence(), 0.0)
    kinks = []
    while evidence.any():
        top = int(np.argmax(evidence))
        near = np.abs(split - split[top]) < size
        # Which side a sample is on is decided on the same samples for every time that the contact may have.
        same = np.full_like(split[near], split[top])
        again = _Meetings.fit(time, position, same, contact[near], size, noise[near])
        bounces = again.bounces()
        misfit = np.where(bounces | again.hits(), again.misfit, np.inf)
        best = int(np.argmin(misfit))
        if misfit[best] <= again.misfit.min() + LIKELY:  # else a slip of the cameras at an end
            kink = int(split[near][best])
            kinks.append((kink, kink > 1 and bool(bounces[best])))  # a single sample does not say that it fell
        evidence[near] = 0.0
    return sorted(kinks)


def _noise(time: Array, position: Array, size: int) -> Array:
    """Return the noise about each sample [m], shape (N, 3): the median of what quadratics through its neighbours leave.

    It changes along a flight, as with the distance from the cameras, and a kink spoils fewer than half of the fits.
    """
    size = min(size, len(time))
    rms = np.empty((len(time) - size + 1, 3))
    for start in range(len(rms)):
        elapsed = time[start : start + size] - time[start]
        squares = np.linalg.lstsq(np.vander(elapsed, 3), position[start : start + size], rcond=None)[1]
        rms[start] = np.sqrt(squares / (size - 3.0))
    reach = NOISE_REACH * size
    about = [rms[max(0, min(i, len(rms)) - reach) : i + reach] for i in range(len(time))]
    return np.array([np.median(one, axis=0) for one in about]) + LEAST_NOISE


@dataclass(frozen=True, eq=False)
class _Meetings:
    """Two flights that meet at a contact, for each of M contacts that are tried.

    Attributes:
        before: Velocity before the contact [m/s], shape (M, 3).
        jump: What it gains there [m/s], shape (M, 3).
        before_std: Standard deviations of `before`, shape (M, 3).
        jump_std: Those of `jump`, shape (M, 3).
        misfit: Sum of the squared normalised residuals, shape (M,).
    """

    before: Array
    jump: Array
    before_std: Array
    jump_std: Array
    misfit: Array

    @classmethod
    def fit(
        cls, time: Array, position: Array, split: NDArray[np.int64], contact: Array, size: int, noise: Array
    ) -> "_Meetings":
        """Fit them to at most `size` samples on each side.

        Args:
            time: [s], shape (N,).
            position: Measured [m], shape (N, 3).
            split: First sample on the other side, shape (M,).
            contact: Time of the contact [s], shape (M,).
            size: Most samples on a side.
            noise: Of each axis about each contact [m], shape (M, 3).
        """
        index = split[:, None] + np.arange(-size, size)
        there = ((index >= 0) & (index < len(time))).astype(float)[:, :, None]
        index = np.clip(index, 0, len(time) - 1)
        elapsed = time[index] - contact[:, None]
        earlier, later = np.minimum(elapsed, 0.0), np.maximum(elapsed, 0.0)
        columns = [elapsed, later, np.ones_like(elapsed), 0.5 * earlier**2, 0.5 * later**2]
        design = np.stack(columns, axis=2) * there
        above = (position[index] - 0.5 * elapsed[:, :, None] ** 2 * GRAVITY) * there
        air = np.diag([0.0, 0.0, 0.0, 1.0, 1.0]) * (noise.mean(axis=1)[:, None, None] / AIR) ** 2
        covariance = np.linalg.inv(design.transpose(0, 2, 1) @ design + air)
        found = covariance @ (design.transpose(0, 2, 1) @ above)
        std = np.sqrt(np.einsum("nii->ni", covariance)[:, :2, None]) * noise[:, None, :]
        squares = ((above - design @ found) / noise[:, None, :]) ** 2
        misfit = np.sum(squares, axis=(1, 2)) + np.sum((found[:, 3:] / AIR) ** 2, axis=(1, 2))
        return cls(found[:, 0], found[:, 1], std[:, 0], std[:, 1], misfit)

    def bounces(self) -> NDArray[np.bool_]:
        """Return where a falling ball gains what a floor gives, shape (M,)."""
        fall, gain = -self.before[:, 2], self.jump[:, 2]
        falls = fall > CERTAIN * self.before_std[:, 2]
        gains = (gain > CERTAIN * self.jump_std[:, 2]) & (gain > LEAST_JUMP)
        like_a_floor = (gain > LEAST_CHANGE * fall) & (gain < MOST_GAIN * fall)
        return np.asarray(falls & gains & like_a_floor)

    def hits(self) -> NDArray[np.bool_]:
        """Return where the velocity changes as by a launch or a hit, shape (M,)."""
        faster = np.maximum(np.linalg.norm(self.before, axis=1), np.linalg.norm(self.before + self.jump, axis=1))
        change = np.linalg.norm(self.jump, axis=1)
        certain = (np.abs(self.jump) > CERTAIN * self.jump_std).any(axis=1)
        return np.asarray(certain & (change > LEAST_CHANGE * faster) & (change > LEAST_JUMP))

    def evidence(self) -> Array:
        """Return twice the logarithm of how much likelier the samples are with a jump than without one, shape (M,)."""
        return np.asarray(np.sum((self.jump / self.jump_std) ** 2, axis=1))
