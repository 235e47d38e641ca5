"""Tells from the cameras alone when the ball was thrown, was hit and landed: a robot has no contact sensors.

A ball that nothing touches keeps to the equation of motion with drag. Its samples are compared with the flight that is
predicted from the last one that kept to it. When some samples in a row do not, the flight has ended where the lines
before and after meet: on the floor or the box it has landed, near an arm it was hit, elsewhere it has touched
something else.
"""

import logging
import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from imolo.ball.aerodynamic import AerodynamicBallModel
from imolo.ball.model import chi_square_quantile
from imolo.ball.tracker import BallTracker, BallTrackerConfig, made_up_flight
from imolo.config.model import Model, NonNegative, Positive
from imolo.config.simulation import BallConfig
from imolo.contracts.robot import Body
from imolo.contracts.trial import EventName
from imolo_msgs import marker_t, mocap_frame_t

Array = NDArray[np.float64]
Arm = tuple[int, int]

logger = logging.getLogger(__name__)


class HitDetectorConfig(Model):
    """What counts as a hit."""

    ball: BallConfig = BallConfig()
    ball_noise: Positive = Field(0.002, description="sd of the ball in the cameras, each axis [m], assumed")
    reach: Positive = Field(
        0.15,
        description="from the middle line of an arm to the centre of a ball it touches [m]: 40 mm of plate, 45 mm of "
        "ball, and what both move between two frames that the lines do not tell, assumed",
    )
    samples: Annotated[int, Field(ge=2)] = Field(
        3, description="in a row that must leave the free flight, assumed: two may be reflections"
    )
    gate_probability: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        0.9999, description="share of the samples of a free flight that pass as such"
    )
    margin: NonNegative = Field(0.004, description="slack of the flight, as a standard deviation [m], assumed: spin")
    search_radius: Positive = Field(
        0.5, description="the ball is looked for so near to where it is expected [m], assumed: 12 m/s for 5 frames"
    )
    ground_margin: NonNegative = Field(
        0.06, description="between ball and floor or box at a touch of these [m], assumed: half a frame of a fall"
    )
    lost_time: Positive = Field(0.1, description="a ball that is not seen for longer is searched anew [s], assumed")


@dataclass(frozen=True, eq=False)
class BallEvent:
    """Something that the ball did.

    Attributes:
        name: THROW, HIT or BALL_LANDED.
        utime: When [µs].
        position: Where the centre of the ball was [m], shape (3,).
        detail: How it is known.
    """

    name: Literal[EventName.THROW, EventName.TOUCH, EventName.BALL_LANDED]
    utime: int
    position: Array
    detail: str


class HitDetector:
    """Follows the ball of one trial from frame to frame."""

    def __init__(self, config: HitDetectorConfig, tracker: BallTrackerConfig, body: Body) -> None:
        """Prepare for a trial.

        Args:
            config: What counts as a hit.
            tracker: How the ball is found, as the planner finds it.
            body: Of the robot, whose limbs may touch the ball, and the boxes around it.
        """
        self._config = config
        self._model = _drag_model(config)
        self._tracker = BallTracker(self._model, tracker)
        self._gate = chi_square_quantile(config.gate_probability, 3)
        self._spread = config.margin**2 * np.eye(3)
        self._state: Array | None = None
        self._covariance = np.empty((0, 0))
        self._utime = 0
        self._suspects: list[tuple[int, Array]] = []
        self._body = body
        self._arms: dict[Arm, list[tuple[int, Array]]] = {arm: [] for arm in _arms(body)}
        self._lengths = dict(zip(self._arms, (one.limb_length for one in body.effectors if one.limb), strict=True))
        self._told: set[EventName] = set()

    def warm_up(self) -> None:
        """Load and compile what takes a second at first."""
        twin = HitDetector(self._config, self._tracker.config, self._body)
        for frame in made_up_flight():
            twin.update(frame)

    def update(self, frame: mocap_frame_t) -> list[BallEvent]:
        """Take a frame and return what it shows to have happened, each event once."""
        self._note_arms(frame)
        events: list[BallEvent] = []
        if self._state is None:
            estimate = self._tracker.update(frame)
            if estimate is not None and estimate.in_flight:
                self._begin(frame.utime, estimate.state, estimate.covariance)
                position = estimate.state[:3].copy()
                events.append(BallEvent(EventName.THROW, frame.utime, position, "seen in flight"))
        else:
            events += self._follow(frame)
        new = [event for event in events if event.name not in self._told]
        self._told.update(event.name for event in new)
        return new

    def _begin(self, utime: int, state: Array, covariance: Array) -> None:
        self._utime, self._state, self._covariance, self._suspects = utime, state, covariance, []

    def _follow(self, frame: mocap_frame_t) -> list[BallEvent]:
        """Compare a frame with the free flight."""
        config, state = self._config, self._state
        assert state is not None
        elapsed = (frame.utime - self._utime) * 1e-6
        if elapsed <= 0.0:
            return []
        expected, covariance = self._model.propagate(state, self._covariance, elapsed)
        marker = self._nearest(frame, expected[:3])
        if marker is not None:
            innovation = marker - expected[:3]
            noise = np.diag(self._model.measurement_std**2)
            spread = covariance[:3, :3] + noise
            if innovation @ np.linalg.solve(spread + self._spread, innovation) <= self._gate:
                gain = np.linalg.solve(spread, covariance[:3]).T
                self._begin(frame.utime, expected + gain @ innovation, covariance - gain @ covariance[:3])
                return []
            self._suspects.append((frame.utime, marker))
            if len(self._suspects) >= config.samples:
                return self._end_of_flight(state)
        # A ball that is hidden at its end has landed where it must have.
        if elapsed > config.lost_time:
            return self._end_of_flight(state)
        return []

    def _end_of_flight(self, state: Array) -> list[BallEvent]:
        """Say what ended the flight, and follow what came after."""
        suspects, start = self._suspects, self._utime
        after: tuple[Array, Array] | None = None
        if len(suspects) >= 2:
            times = np.array([1e-6 * (utime - suspects[-1][0]) for utime, _ in suspects])
            later, covariance, _ = self._model.initial_state(times, np.array([place for _, place in suspects]))
            after = later, covariance
            contact = self._meeting(state, suspects)
        else:
            contact = self._ground_crossing(state)
        place = self._model.propagate(state, self._covariance, contact)[0][:3]
        utime = start + round(contact * 1e6)
        event = self._judge(utime, place, state, after, contact)
        if after is None:
            self._state = None
            self._tracker.reset()
        else:
            self._begin(suspects[-1][0], *after)
        return [] if event is None else [event]

    def _meeting(self, state: Array, suspects: list[tuple[int, Array]]) -> float:
        """Return how long after the last sample of the flight the line of the suspects meets it [s]."""
        first, second = suspects[0], suspects[1]
        velocity = (second[1] - first[1]) / (1e-6 * (second[0] - first[0]))
        latest = 1e-6 * (first[0] - self._utime)
        times = np.linspace(0.0, latest, 20)
        flight = state[:3] + np.outer(times, state[3:6])
        line = first[1] + np.outer(times - latest, velocity)
        return float(times[np.argmin(np.linalg.norm(flight - line, axis=1))])

    def _ground_crossing(self, state: Array) -> float:
        """Return when a flight that nobody saw end reached the ground [s], within the time it was not seen."""
        times = np.linspace(0.0, 2.0 * self._config.lost_time, 41)
        for time in times:
            place = self._model.propagate(state, self._covariance, float(time))[0][:3]
            if min(self._clearances(place).values()) <= 0.0:
                return float(time)
        return float(times[-1])

    def _judge(
        self, utime: int, place: Array, state: Array, after: tuple[Array, Array] | None, contact: float
    ) -> BallEvent | None:
        config = self._config
        change = "it was not seen again"
        if after is not None:
            before = self._model.propagate(state, self._covariance, contact)[0][3:6]
            change = f"its velocity changed by {np.linalg.norm(after[0][3:6] - before):.1f} m/s"
        distance, arm = self._nearest_arm(utime, place)
        clearances = self._clearances(place)
        surface = min(clearances, key=lambda name: clearances[name])
        if clearances[surface] <= config.ground_margin:
            return BallEvent(EventName.BALL_LANDED, utime, place, f"on {surface}, {change}")
        if after is not None and distance <= config.reach:
            detail = f"marker {arm}, {1e3 * distance:.0f} mm from the middle of the arm, {change}"
            return BallEvent(EventName.TOUCH, utime, place, detail)
        logger.info("the ball left its flight at %d us, %.2f m from the nearest arm: %s", utime, distance, change)
        return None

    def _clearances(self, place: Array) -> dict[str, float]:
        """Return the gaps between a ball at a place and the floor, and each box, by name [m]."""
        radius = self._config.ball.radius
        gaps = {"floor": float(place[2]) - radius}
        for box in self._body.boxes:
            center, half = np.array(box.center), np.array(box.half_extents)
            gaps[box.name] = float(np.linalg.norm(place - np.clip(place, center - half, center + half))) - radius
        return gaps

    def _nearest_arm(self, utime: int, place: Array) -> tuple[float, int]:
        """Return the distance of a place to the nearest arm at a time [m], and the label of its hand."""
        nearest = math.inf, marker_t.UNLABELLED
        for arm, seen in self._arms.items():
            line = _between(utime, seen)
            if line is None:
                continue
            shoulder, along = line[:3], line[3:] - line[:3]
            along *= self._lengths[arm] / max(float(np.linalg.norm(along)), 1e-6)
            part = np.clip((place - shoulder) @ along / (along @ along), 0.0, 1.0)
            nearest = min(nearest, (float(np.linalg.norm(place - shoulder - part * along)), arm[1]))
        return nearest

    def _note_arms(self, frame: mocap_frame_t) -> None:
        seen = {marker.marker_id: marker.marker_position for marker in frame.markers}
        for (shoulder, hand), places in self._arms.items():
            if shoulder in seen and hand in seen:
                places.append((frame.utime, np.array([*seen[shoulder], *seen[hand]])))
                del places[:-32]

    def _nearest(self, frame: mocap_frame_t, expected: Array) -> Array | None:
        unlabelled = [m.marker_position for m in frame.markers if m.marker_id == marker_t.UNLABELLED]
        places = np.array(unlabelled).reshape(-1, 3)
        distances = np.linalg.norm(places - expected, axis=1)
        if not len(distances) or not distances.min() <= self._config.search_radius:
            return None
        return np.asarray(places[distances.argmin()])


def _drag_model(config: HitDetectorConfig) -> AerodynamicBallModel:
    ball = config.ball
    drag = ball.air_density * ball.drag_coefficient * math.pi * ball.radius**2 / (2.0 * ball.mass)
    return AerodynamicBallModel(
        kind="drag",
        time_step=0.0083,
        acceleration_density=0.01,
        measurement_std=np.full(3, config.ball_noise),
        prior_mean=np.array([0.0, 0.0, 0.0, drag]),
        prior_std=np.array([30.0, 30.0, 30.0, 0.3 * drag]),
    )


def _arms(body: Body) -> list[Arm]:
    """Return the labels of the markers at both ends of each limb that may touch the ball."""
    return [(body.marker_id(one.limb), body.marker_id(one.name)) for one in body.effectors if one.limb]


def _between(utime: int, seen: list[tuple[int, Array]]) -> Array | None:
    """Return shoulder and hand at a time, linear between two frames, shape (6,)."""
    if not seen:
        return None
    times = [time for time, _ in seen]
    values = np.array([value for _, value in seen])
    return np.array([np.interp(utime, times, values[:, column]) for column in range(6)])
