"""The choice of the hit by its probability, beside the first tuple that is close enough (Sec. IV-A)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from imolo.config.model import Fraction, Model, NonNegative, Positive
from imolo.method.hit_kernel import BallPath, Extent, Found, Swings, Underway, most_probable, most_probable_of
from imolo.method.motion import MotionTemplate, Theta, to_microseconds

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

VELOCITY_SPAN = 0.012  # [s] over which the velocity of the hand is taken: the grid's 3 mm of rounding are then 0.2 m/s


class HitConfig(Model):
    """What a hit is and when it is likely enough, for the choice by probability."""

    plate_width: Positive = Field(0.080, description="short side of the plate [m], Sec. V-A")
    ball_radius: Positive = Field(0.045, description="[m], Sec. VII-A")
    timing_std: NonNegative = Field(
        0.002, description="of the swing against its commands [s], assumed: 1 ms of delivery and as much of valves"
    )
    start_probability: Fraction = Field(
        0.999, description="a motion that hits with this probability is started without waiting for a better one [-]"
    )
    farthest: Positive = Field(
        0.30,
        description="ball and hand farther apart than this are not considered to meet [m]: the length of the plate",
    )
    look_ahead: tuple[Positive, ...] = Field(
        (0.0083, 0.05, 0.1, 0.15, 0.2),
        description="later onsets whose best motion may be worth waiting for [s], assumed",
    )


@dataclass(frozen=True, slots=True, eq=False)
class ProbableHit:
    """A motion and how likely it hits.

    Attributes:
        theta: Parameter of the motion.
        time: Time since the onset at which the hand is nearest to the ball [s].
        position: Where the hand is then [m], shape (3,).
        probability: That either hand meets the ball [-].
        side: 1 for the hand that was learned, -1 for the other one.
    """

    theta: Theta
    time: float
    position: Array
    probability: float
    side: int


def group_by_motion(theta: Array, time: Array, position: Array, hand_std: Array, spacing: float) -> Swings:
    """Order the tuples of a table by motion and give them velocities.

    Args:
        theta: Of the tuples, shape (M, 2): k [-], t_w [s].
        time: [s], shape (M,).
        position: Grid points [m], shape (M, 3).
        hand_std: Of the hand about its prediction [m], one row per distinct theta in ascending order, shape (T, 3).
        spacing: d_grid [m].
    """
    order = np.lexsort((time, theta[:, 1], theta[:, 0]))
    theta = theta[order]
    # Side by side in memory: the search looks at few tuples of many motions.
    tuples = np.column_stack((time[order], position[order], np.zeros_like(position)))
    time, position, velocity = tuples[:, 0], tuples[:, 1:4], tuples[:, 4:7]
    fresh = np.ones(len(theta), dtype=bool)
    fresh[1:] = (theta[1:] != theta[:-1]).any(axis=1)
    start = np.append(np.flatnonzero(fresh), len(theta)).astype(np.int64)
    motions = theta[fresh]
    k, row = np.unique(motions[:, 0], return_inverse=True)
    t_w, column = np.unique(motions[:, 1], return_inverse=True)
    lattice = np.full((len(k), len(t_w)), -1, dtype=np.int64)
    lattice[row, column] = np.arange(len(motions))
    # The grid of k need not be symmetric: the stored k nearest to -k mirrors it, to half a step.
    opposite = np.abs(k[:, np.newaxis] + k).argmin(axis=1)
    step = np.diff(k).max() if len(k) > 1 else 0.0
    opposite = np.where(np.abs(k[opposite] + k) <= 0.5 * step + 1e-9, opposite, -1)
    mirror = np.where(opposite[row] >= 0, lattice[opposite[row], column], -1)
    velocity[:] = _velocities(time, position, start)
    return Swings(
        lattice=lattice,
        place=np.column_stack((row, column)).astype(np.int64),
        mirror=mirror.astype(np.int64),
        theta=np.column_stack((motions[:, 0], np.rint(motions[:, 1] * 1e6))),
        # A grid point stands for a cell in which the hand may be anywhere.
        variance=np.ascontiguousarray(hand_std**2 + spacing**2 / 12.0),
        start=start,
        span=np.column_stack((time[start[:-1]], time[start[1:] - 1])),
        time=time,
        position=position,
        velocity=velocity,
    )


def _velocities(time: Array, position: Array, start: Indices) -> Array:
    """Return the velocity of each tuple from those of the same motion around it; 0 where there are none."""
    index = np.arange(len(time))
    counts = np.diff(start)
    first, last = np.repeat(start[:-1], counts), np.repeat(start[1:] - 1, counts)
    steps = np.diff(time)
    steps = steps[steps > 0.0]
    reach = max(1, round(0.5 * VELOCITY_SPAN / float(np.median(steps)))) if len(steps) else 1
    before, after = np.maximum(index - reach, first), np.minimum(index + reach, last)
    elapsed = time[after] - time[before]
    known = elapsed > 0.0
    velocity = np.zeros_like(position)
    velocity[known] = (position[after[known]] - position[before[known]]) / elapsed[known, np.newaxis]
    return velocity


class HitChooser:
    """Chooses motions by the probability that a hand meets the ball."""

    def __init__(self, swings: Swings, template: MotionTemplate, config: HitConfig, time_step: float) -> None:
        """Prepare, and compile the search.

        Args:
            swings: The table.
            template: What theta changes.
            config: What a hit is.
            time_step: Between two points of a predicted path [s].
        """
        self._swings, self._template, self._config = swings, template, config
        self._extent = Extent(
            0.5 * config.plate_width + config.ball_radius,
            config.timing_std**2,
            0.5 * time_step + 1e-6,
            config.farthest,
        )
        self._awaited = 0.0
        self._low = swings.position.min(axis=0) - config.farthest
        self._high = swings.position.max(axis=0) + config.farthest
        mirrored = max(abs(self._low[1]), abs(self._high[1]))
        self._low[1], self._high[1] = -mirrored, mirrored
        nowhere = BallPath(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3, 3)))
        most_probable(nowhere, _FREE, True, swings, self._extent)
        most_probable_of(np.zeros(1, dtype=np.int64), nowhere, swings, self._extent)

    def reachable(self, position: Array) -> slice:
        """Return the part of a path, shape (N, 3), outside which no hand comes near; it may be empty."""
        inside = np.flatnonzero(((position > self._low) & (position < self._high)).all(axis=1))
        return slice(int(inside[0]), int(inside[-1]) + 1) if len(inside) else slice(0, 0)

    def start(self, ball: BallPath) -> ProbableHit | None:
        """Return the motion to start now; None if there is none, or a later start is likelier to hit.

        Args:
            ball: Its path as far as it is `reachable`, with times since an onset now.
        """
        now = most_probable(ball, _FREE, False, self._swings, self._extent)
        if now.motion < 0:
            return None
        if now.probability < self._config.start_probability:
            # What was worth waiting for a frame ago probably still is.
            for delay in sorted(self._config.look_ahead, key=lambda delay: abs(delay - self._awaited)):
                later = ball._replace(time=ball.time - delay)
                if most_probable(later, _FREE, False, self._swings, self._extent).probability > now.probability:
                    self._awaited = delay
                    return None
        return self._hit(most_probable(ball, _FREE, True, self._swings, self._extent))

    def update(self, ball: BallPath, theta: Theta, elapsed: float) -> ProbableHit | None:
        """Return the motion to go on with; None if none that can still be commanded comes near,
        or the motion cannot be changed any more.

        Args:
            ball: Its path as far as it is `reachable`, with times since the onset.
            theta: Of the motion under way.
            elapsed: Time since its onset at which new commands can take effect [s]; negative before the onset.
        """
        switch, elapsed_us = to_microseconds(theta.t_w), to_microseconds(elapsed)
        begun = elapsed_us > to_microseconds(self._template.changed_phase_start(theta.t_w))
        if begun and elapsed_us > switch:
            return None
        underway = Underway(theta.k if begun else math.nan, float(switch), float(elapsed_us))
        best = most_probable(ball, underway, True, self._swings, self._extent)
        if best.motion < 0:
            return None
        current = self._motion(theta)
        if current >= 0:
            kept = most_probable_of(np.array([current]), ball, self._swings, self._extent)
            if kept.probability >= best.probability:
                best = kept
        return self._hit(best)

    def _motion(self, theta: Theta) -> int:
        same = (self._swings.theta[:, 0] == theta.k) & (self._swings.theta[:, 1] == to_microseconds(theta.t_w))
        found = np.flatnonzero(same)
        return int(found[0]) if len(found) else -1

    def _hit(self, found: Found) -> ProbableHit:
        k, switch = self._swings.theta[found.motion].tolist()
        position = self._swings.position[found.row] * (1.0, found.side, 1.0)
        return ProbableHit(
            Theta(k, switch / 1e6), self._swings.time.item(found.row), position, found.probability, found.side
        )


_FREE = Underway(math.nan, math.nan, -1.0)
