"""Find and follow the ball among the markers of the motion-capture frames (paper Sec. V-C)."""

import logging
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from imolo.ball.gate_kernel import nearest_marker
from imolo.ball.model import BallFilter, BallModel, chi_square_quantile
from imolo.config.model import Model, NonNegative, Positive
from imolo_msgs import ball_state_t, marker_t, mocap_frame_t

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

FARTHEST = 1e3  # [m] of a marker from the origin, the axes added up; assumed: no cameras see so far
UNKNOWN_VELOCITY = 10.0  # [m/s] standard deviation of a velocity that was not estimated, assumed: faster than any throw


class BallTrackerConfig(Model):
    """How the ball is found and followed."""

    detection_distance: Positive = Field(
        2.2, description="an unlabelled marker farther than this from the robot may be the ball [m], Sec. V-C"
    )
    gate_probability: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        0.999, description="share of the true measurements that pass the χ² gates"
    )
    gate_margin: NonNegative = Field(
        0.01, description="slack of the gate, as a standard deviation [m], assumed: misfit of the ball model"
    )
    coast_time: Positive = Field(0.25, description="a track without a measurement for longer is dropped [s], assumed")
    launch_frames: Annotated[int, Field(ge=4)] = Field(
        6, description="samples of free flight that start a track and its filter, assumed: fewer may be a thrower's arm"
    )
    launch_speed: Positive = Field(1.0, description="slowest ball in flight [m/s], assumed; throws have 6 to 8 m/s")
    link_speed: Positive = Field(
        12.0, description="a marker jumps no faster than this from frame to frame [m/s], assumed"
    )
    link_time: Positive = Field(
        0.03, description="longest gap between the samples of a marker before its launch [s], assumed: two lost frames"
    )


@dataclass(frozen=True, eq=False)
class BallEstimate:
    """Where the ball is at the time of a frame.

    Attributes:
        utime: Capture time of the frame [µs].
        state: Position [m], velocity [m/s] in the world frame and what the ball model adds, shape (n,), n >= 6.
        covariance: Covariance of the state, shape (n, n).
        in_flight: Whether the ball flies; before the release `state` is the marker at rest, its velocity unknown.
    """

    utime: int
    state: Array
    covariance: Array
    in_flight: bool

    def to_message(self) -> ball_state_t:
        """Return the estimate as a message."""
        message = ball_state_t()
        message.utime = self.utime
        message.ball_position, message.ball_velocity = self.state[:3].tolist(), self.state[3:6].tolist()
        message.covariance = self.covariance[:6, :6].tolist()
        return message


@dataclass
class TrackerCounters:
    """What the tracker had to put up with since the last reset.

    Attributes:
        dropouts: Frames in which a ball that was followed had no marker.
        ghosts: Unlabelled markers that were not the ball.
        late_frames: Frames not newer than the newest one.
        invalid_markers: Markers with a coordinate that is not finite, or of kilometres.
        restarts: Tracks whose filter contradicted the last samples and began anew.
    """

    dropouts: int = 0
    ghosts: int = 0
    late_frames: int = 0
    invalid_markers: int = 0
    restarts: int = 0


class _Samples:
    """The last few samples of one unlabelled marker."""

    def __init__(self, length: int) -> None:
        self.utimes: deque[int] = deque(maxlen=length)
        self.positions: deque[Array] = deque(maxlen=length)

    def append(self, utime: int, position: Array) -> None:
        """Add a sample: capture time [µs] and position [m], shape (3,)."""
        self.utimes.append(utime)
        self.positions.append(position)

    @property
    def full(self) -> bool:
        """Whether there are enough samples for a launch."""
        return len(self.utimes) == self.utimes.maxlen

    def expected(self, utime: int) -> Array:
        """Return where the marker should be at `utime` [m], shape (3,), if it moves on as it did."""
        if len(self.utimes) < 2:
            return self.positions[-1]
        share = (utime - self.utimes[-1]) / (self.utimes[-1] - self.utimes[-2])
        expected: Array = self.positions[-1] + share * (self.positions[-1] - self.positions[-2])
        return expected


@dataclass
class _Track:
    """A ball in flight."""

    kalman: BallFilter
    utime: int  # of the filter [µs]
    seen_utime: int  # of the last measurement [µs]
    samples: _Samples


class BallTracker:
    """Turns mocap frames into ball estimates.

    A launch begins a track: a few samples of one unlabelled marker, beyond the detection distance, that move and fit
    free flight. Then a gate around the predicted position follows the ball, also within that distance. The track
    starts anew if it contradicts the free flight of the last samples, as it does after a start in the thrower's arm,
    or if another launch is seen while it has no marker.

    Attributes:
        counters: Dropouts, ghosts, late frames and the like since the last reset.
    """

    def __init__(self, model: BallModel, config: BallTrackerConfig | None = None) -> None:
        self.model = model
        self.config = config = config or BallTrackerConfig()
        import filterpy.kalman  # noqa: F401 - now, not in the middle of a throw

        self._gate = chi_square_quantile(config.gate_probability, 3)
        self._restart_gate = chi_square_quantile(config.gate_probability, 6)
        self._launch_gate = chi_square_quantile(config.gate_probability, 3 * config.launch_frames - 6)
        self._margin = config.gate_margin**2
        self._warned: set[str] = set()
        self.reset()

    def reset(self) -> None:
        """Forget the ball, the robot and the time, as before a new trial, and count from zero."""
        self.counters = TrackerCounters()
        self._newest: int | None = None
        self._robot: list[tuple[float, float, float]] = []  # its markers when it was last seen
        self._track: _Track | None = None
        self._candidates: list[_Samples] = []

    def update(self, frame: mocap_frame_t) -> BallEstimate | None:
        """Take in one frame.

        Args:
            frame: Mocap frame; one that is not newer than the newest is ignored.

        Returns:
            The ball at the time of the frame, or None if it is not known or the frame came late.
        """
        if self._newest is not None and frame.utime <= self._newest:
            self.counters.late_frames += 1
            return None
        self._newest = frame.utime
        markers = self._read(frame)
        if self._track is not None:
            self._follow(self._track, frame.utime, markers)
        if self._track is None or self._track.seen_utime < frame.utime:
            self._search(frame.utime, markers)
        if self._track is None:
            return self._at_rest(frame.utime)
        kalman = self._track.kalman
        return BallEstimate(frame.utime, kalman.x.copy(), kalman.P.copy(), in_flight=True)

    def _read(self, frame: mocap_frame_t) -> Array:
        """Note where the robot is and return the unlabelled markers [m], shape (M, 3)."""
        robot, unlabelled = [], []
        for marker in frame.markers:
            x, y, z = marker.marker_position
            if not abs(x) + abs(y) + abs(z) < FARTHEST:  # NaN is not, either
                self.counters.invalid_markers += 1
                self._warn_once(
                    "a mocap frame (%d) has a marker that is nowhere in the room; such markers are ignored", frame.utime
                )
            elif marker.marker_id == marker_t.UNLABELLED:
                unlabelled.append((x, y, z))
            else:
                robot.append((x, y, z))
        self._robot = robot or self._robot
        return np.array(unlabelled, dtype=float).reshape(-1, 3)

    def _follow(self, track: _Track, utime: int, markers: Array) -> None:
        """Predict a track and correct it by the nearest marker within the gate, or drop it."""
        if utime - track.seen_utime > self.config.coast_time * 1e6:
            self._track = None
            return
        kalman = track.kalman
        self.model.advance(kalman, (utime - track.utime) * 1e-6)
        track.utime = utime
        nearest, distance, surprise = nearest_marker(markers, kalman.x, kalman.P, kalman.R, self._margin)
        if not distance <= self._gate:
            self.counters.dropouts += 1
            self.counters.ghosts += len(markers)
            return
        self.counters.ghosts += len(markers) - 1
        kalman.update(markers[nearest])
        track.seen_utime = utime
        track.samples.append(utime, markers[nearest])
        if surprise > self._gate:
            self._restart(track)

    def _restart(self, track: _Track) -> None:
        """Start the filter anew if the last samples are free flight, yet not the one that it follows."""
        launch = self._launch(track.samples)
        if launch is None:
            return
        state, covariance = launch
        if _mahalanobis((state - track.kalman.x)[:6], covariance[:6, :6]) > self._restart_gate:
            track.kalman = self.model.make_filter(state, covariance)
            self.counters.restarts += 1

    def _search(self, utime: int, markers: Array) -> None:
        """Link the far markers to those of the last frames and start a track if one was launched."""
        if not self._robot:
            self._warn_once("no robot marker was seen until frame %d; the ball cannot be told from the robot", utime)
            return
        robot = np.mean(self._robot, axis=0)
        far = list(markers[np.linalg.norm(markers - robot, axis=1) > self.config.detection_distance])
        oldest = utime - self.config.link_time * 1e6
        if self._track is None:
            lost = [samples for samples in self._candidates if samples.utimes[-1] < oldest and not samples.full]
            self.counters.ghosts += sum(len(samples.utimes) for samples in lost)
        self._candidates = [samples for samples in self._candidates if samples.utimes[-1] >= oldest]
        for samples in self._candidates:
            elapsed = (utime - samples.utimes[-1]) * 1e-6
            distances = [float(np.linalg.norm(marker - samples.expected(utime))) for marker in far]
            if distances and min(distances) < self.config.link_speed * elapsed:
                samples.append(utime, far.pop(int(np.argmin(distances))))
        for marker in far:
            self._candidates.append(_Samples(self.config.launch_frames))
            self._candidates[-1].append(utime, marker)
        for samples in self._candidates:
            launch = self._launch(samples) if samples.full and samples.utimes[-1] == utime else None
            if launch is not None:
                self.counters.restarts += self._track is not None
                self._track = _Track(self.model.make_filter(*launch), utime, utime, samples)
                self._candidates = []
                return

    def _launch(self, samples: _Samples) -> tuple[Array, Array] | None:
        """Return state and covariance at the last sample, or None if the samples are no free flight."""
        if not samples.full:
            return None
        time = (np.array(samples.utimes) - samples.utimes[-1]) * 1e-6
        state, covariance, misfit = self.model.initial_state(time, np.array(samples.positions))
        speed_noise = float(np.sqrt(np.trace(covariance[3:6, 3:6])))
        if misfit > self._launch_gate or np.linalg.norm(state[3:6]) < self.config.launch_speed + 3.0 * speed_noise:
            return None
        return state, covariance

    def _at_rest(self, utime: int) -> BallEstimate | None:
        """Return the far marker that has been seen for a while and is not in flight, if there is one now."""
        for samples in self._candidates:
            if samples.full and samples.utimes[-1] == utime:
                covariance = UNKNOWN_VELOCITY**2 * np.eye(6)
                covariance[:3, :3] = self.model.measurement_covariance(samples.positions[-1])
                state = np.concatenate([samples.positions[-1], np.zeros(3)])
                return BallEstimate(utime, state, covariance, in_flight=False)
        return None

    def _warn_once(self, message: str, utime: int) -> None:
        if message not in self._warned:
            self._warned.add(message)
            logger.warning(message, utime)


def made_up_flight() -> Iterator[mocap_frame_t]:
    """Yield half a second of frames of a ball that flies at a robot, to compile by what follows it."""
    for number in range(1, 61):
        time = number / 120.0
        robot, ball = marker_t(), marker_t()
        robot.marker_id, robot.marker_position = 0, [0.0, 0.0, 0.8]
        ball.marker_id = marker_t.UNLABELLED
        ball.marker_position = [5.0 - 6.0 * time, 0.0, 1.1 + 4.0 * time - 4.9 * time**2]
        frame = mocap_frame_t()
        frame.utime, frame.frame_number = round(time * 1e6), number
        frame.num_markers, frame.markers = 2, [robot, ball]
        yield frame


def _mahalanobis(difference: Array, covariance: Array) -> float:
    """Return the squared Mahalanobis norm of a difference, shape (n,), under a covariance, shape (n, n)."""
    return float(difference @ np.linalg.solve(covariance, difference))
