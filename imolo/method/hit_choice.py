"""The choice of the hit by its probability, beside the first tuple that is close enough (Sec. IV-A)."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from imolo.config.model import Fraction, Model, NonNegative, Positive
from imolo.errors import ConfigError
from imolo.method.commands import to_microseconds
from imolo.method.hit_kernel import (
    BallPath,
    Extent,
    Found,
    Swings,
    Underway,
    most_probable,
    most_probable_of,
    part_within,
)
from imolo.method.motion import MotionTemplate, Theta, motion_rows

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

COARSE = 130  # motions that are tried first, evenly over all
VELOCITY_SPAN = 0.012  # [s] over which the velocity of the hand is taken: the grid's 3 mm of rounding are then 0.2 m/s


class HitConfig(Model):
    """What a hit is and when it is likely enough, for the choice by probability."""

    effector_width: Positive | None = Field(
        None, description="short side of what is to meet the ball [m]; the robot's own if not given"
    )
    ball_radius: Positive | None = Field(None, description="[m]; that of `simulation.ball` if not given")
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
    coarse: tuple[Annotated[int, Field(ge=1)], ...] | None = Field(
        None, description=f"values of each parameter that are tried first; together about {COARSE} if not given"
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


def group_by_motion(
    template: MotionTemplate, theta: Array, time: Array, position: Array, hand_std: Array, spacing: float
) -> Swings:
    """Order the tuples of a table by motion and give them velocities.

    Args:
        template: What theta changes.
        theta: Of the tuples, shape (M, n).
        time: [s], shape (M,).
        position: Grid points [m], shape (M, 3).
        hand_std: Of the hand about its prediction [m], one row per distinct theta in ascending order, shape (T, 3).
        spacing: d_grid [m].
    """
    order = np.lexsort((time, *theta.T[::-1]))
    theta = theta[order]
    # Side by side in memory: the search looks at few tuples of many motions.
    tuples = np.column_stack((time[order], position[order], np.zeros_like(position)))
    time, position, velocity = tuples[:, 0], tuples[:, 1:4], tuples[:, 4:7]
    fresh = np.ones(len(theta), dtype=bool)
    fresh[1:] = (theta[1:] != theta[:-1]).any(axis=1)
    start = np.append(np.flatnonzero(fresh), len(theta)).astype(np.int64)
    motions = theta[fresh]
    values, places = zip(*(np.unique(column, return_inverse=True) for column in motions.T), strict=True)
    size = np.array([len(value) for value in values], dtype=np.int64)
    place = np.column_stack(places).astype(np.int64)
    lattice = np.full(int(np.prod(size)), -1, dtype=np.int64)
    lattice[np.ravel_multi_index(tuple(place.T), size)] = np.arange(len(motions))
    velocity[:] = _velocities(time, position, start)
    return Swings(
        lattice=lattice,
        size=size,
        place=place,
        mirror=_mirrored(template, values, place, lattice, size),
        motion=motion_rows(template, motions),
        # A grid point stands for a cell in which the hand may be anywhere.
        variance=np.ascontiguousarray(hand_std**2 + spacing**2 / 12.0),
        start=start,
        span=np.column_stack((time[start[:-1]], time[start[1:] - 1])),
        time=time,
        position=position,
        velocity=velocity,
    )


def _mirrored(
    template: MotionTemplate, values: tuple[Array, ...], place: Indices, lattice: Indices, size: Indices
) -> Indices:
    """Return the mirrored motion of each, -1 where there is none, shape (T,)."""
    sign = template.mirror
    if sign is None:
        return np.full(len(place), -1, dtype=np.int64)
    mirrored = np.empty_like(place)
    for axis, (value, factor) in enumerate(zip(values, sign, strict=True)):
        # The grid need not be symmetric: the stored value nearest to the mirrored one, to half a step.
        distance = np.abs(value[:, np.newaxis] - factor * value)
        nearest = distance.argmin(axis=0)
        step = np.diff(value).max() if len(value) > 1 else 0.0
        near = distance.min(axis=0) <= 0.5 * step + 1e-9
        mirrored[:, axis] = np.where(near, nearest, -1)[place[:, axis]]
    whole = (mirrored >= 0).all(axis=1)
    result = np.full(len(place), -1, dtype=np.int64)
    result[whole] = lattice[np.ravel_multi_index(tuple(mirrored[whole].T), size)]
    return result


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
        self._swings, self._row, self._config = swings, template.row_maker(), config
        if config.effector_width is None or config.ball_radius is None:
            raise ConfigError("the choice by probability needs hit.effector_width and hit.ball_radius")
        count = len(swings.size)
        self._numbers = {tuple(theta): number for number, theta in enumerate(swings.motion[:, :count].tolist())}
        coarse = config.coarse or (round(COARSE ** (1.0 / count)),) * count
        if len(coarse) != count:
            raise ConfigError(f"hit.coarse is {coarse}; give {count} numbers, one per parameter of the motion")
        self._coarse = np.maximum(1, swings.size // np.array(coarse))
        self._extent = Extent(
            # What meets a plate seen from its edge is a bar with round ends: its largest rectangle (docs/choice.md).
            0.5 * config.effector_width + 0.5 * config.ball_radius,
            math.sqrt(0.75) * config.ball_radius,
            config.timing_std**2,
            0.5 * time_step + 1e-6,
            config.farthest,
        )
        self._awaited = 0.0
        self._low = swings.position.min(axis=0) - config.farthest
        self._high = swings.position.max(axis=0) + config.farthest
        if template.mirror is not None:
            mirrored = max(abs(self._low[1]), abs(self._high[1]))
            self._low[1], self._high[1] = -mirrored, mirrored
        nowhere = BallPath(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3, 3)))
        self._free = Underway((0.0,) * (2 * count), -1.0, False)
        most_probable(nowhere, self._free, True, swings, self._extent, self._coarse)
        most_probable_of(np.zeros(1, dtype=np.int64), nowhere, swings, self._extent)
        self.reachable(np.zeros((1, 6))[:, :3])  # as a planner cuts it out of its states

    def reachable(self, position: Array) -> slice:
        """Return the part of a path, shape (N, 3), outside which no hand comes near; it may be empty."""
        return slice(*part_within(position, self._low, self._high))

    def start(self, ball: BallPath) -> ProbableHit | None:
        """Return the motion to start now; None if there is none, or a later start is likelier to hit.

        Args:
            ball: Its path as far as it is `reachable`, with times since an onset now.
        """
        now = most_probable(ball, self._free, False, self._swings, self._extent, self._coarse)
        if now.motion < 0:
            return None
        if now.probability < self._config.start_probability:
            # What was worth waiting for a frame ago probably still is.
            for delay in sorted(self._config.look_ahead, key=lambda delay: abs(delay - self._awaited)):
                later = ball._replace(time=ball.time - delay)
                if (
                    most_probable(later, self._free, False, self._swings, self._extent, self._coarse).probability
                    > now.probability
                ):
                    self._awaited = delay
                    return None
        return self._hit(most_probable(ball, self._free, True, self._swings, self._extent, self._coarse))

    def update(self, ball: BallPath, theta: Theta, elapsed: float) -> ProbableHit | None:
        """Return the motion to go on with; None if none that can still be commanded comes near,
        or the motion cannot be changed any more.

        Args:
            ball: Its path as far as it is `reachable`, with times since the onset.
            theta: Of the motion under way.
            elapsed: Time since its onset at which new commands can take effect [s]; negative before the onset.
        """
        row, now = self._row(theta), to_microseconds(elapsed)
        shown = [now > to_microseconds(since) for since in row[len(theta) :]]
        if all(shown):
            return None
        underway = Underway(row, elapsed, any(shown))
        best = most_probable(ball, underway, True, self._swings, self._extent, self._coarse)
        if best.motion < 0:
            return None
        current = self._motion(theta)
        if current >= 0:
            kept = most_probable_of(np.array([current]), ball, self._swings, self._extent)
            if kept.probability >= best.probability:
                best = kept
        return self._hit(best)

    def _motion(self, theta: Theta) -> int:
        return self._numbers.get(tuple(theta), -1)

    def _hit(self, found: Found) -> ProbableHit:
        theta = tuple(self._swings.motion[found.motion, : self._swings.size.size].tolist())
        position = self._swings.position[found.row] * (1.0, found.side, 1.0)
        return ProbableHit(theta, self._swings.time.item(found.row), position, found.probability, found.side)
