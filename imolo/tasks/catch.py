"""Catching a thrown ball (Sec. IV-C names it): the effector gives way, so that the ball touches its face slowly."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation

from imolo.config.experiment import ExperimentConfig
from imolo.config.model import Model, NonNegative, Positive
from imolo.contracts.robot import Body, Effector, Marker
from imolo.contracts.task import Task, TaskPlugin, Verdict
from imolo.contracts.trial import EventName
from imolo.errors import ConfigError
from imolo.messaging import channels
from imolo.messaging.log import Log
from imolo.tasks.hit import HitTask
from imolo.trials.causes import ball_track
from imolo.trials.recordings import hand_at, marker_track

Array = NDArray[np.float64]

SPEED = "relative speed [m/s]"
TOO_FAST, BESIDE, UNSEEN = "too fast", "beside the face", "catch not seen"
FIT_TIME = 0.06  # [s] before the touch over which the velocities are taken: 7 frames
FEWEST = 4  # samples of a velocity
FEWEST_MARKERS = 3  # that tell how a link is turned


class CatchOptions(Model):
    """What a catch is."""

    relative_speed: Positive = Field(description="fastest touch that is a catch [m/s]")
    face_margin: NonNegative = Field(
        0.01, description="beyond the edge of the face, and below its plane, that still count as on it [m], assumed"
    )


class CatchTask(HitTask):
    """An effector is to touch the ball with its face, and no faster than allowed."""

    def __init__(self, config: ExperimentConfig, options: Model, body: Body) -> None:
        """Take ball, thrower and the robot's faces.

        Raises:
            ConfigError: No effector of the robot has a face whose pose its markers tell.
        """
        super().__init__(config, options, body)
        self._options = CatchOptions.model_validate(options.model_dump())
        self._body = body
        for effector in body.effectors:
            if effector.normal is None:
                raise ConfigError(
                    f"robot {body.name!r} cannot catch: effector {effector.name!r} has no face; give it a `normal`"
                )
            if len(self._markers(effector)) < FEWEST_MARKERS:
                raise ConfigError(
                    f"robot {body.name!r} cannot catch: fewer than {FEWEST_MARKERS} markers on {effector.link!r} "
                    f"tell how {effector.name!r} is turned; add some"
                )

    def judge(self, log: Log, onset_utime: int) -> Verdict:
        """Judge the first touch after the onset by the cameras: where on the effector, and how fast."""
        touches = [event for event in log.messages[channels.TRIAL] if event.event == EventName.TOUCH]
        touch = next((event for event in touches if event.utime >= onset_utime), None)
        if touch is None:
            return Verdict(False)
        effector = next((one for one in self._body.effectors if one.link == touch.touched), self._body.effectors[0])
        time = touch.utime * 1e-6
        pose = self._pose(log, effector, time)
        utimes, places = ball_track(log)
        ball = _velocity(np.asarray(1e-6 * utimes, dtype=np.float64), places, time)
        hand = _velocity(*marker_track(log, self._body.marker_id(effector.name)), time)
        if pose is None or ball is None or hand is None:
            return Verdict(False, cause=UNSEEN)
        speed = float(np.linalg.norm(ball - hand))
        measures = {SPEED: speed}
        if not self._on_face(effector, pose, np.array(touch.event_position)):
            return Verdict(False, measures, BESIDE)
        if speed > self._options.relative_speed:
            return Verdict(False, measures, TOO_FAST)
        return Verdict(True, measures)

    def _markers(self, effector: Effector) -> Sequence[Marker]:
        return [marker for marker in self._body.markers if marker.link == effector.link]

    def _pose(self, log: Log, effector: Effector, time: float) -> tuple[Array, Array] | None:
        """Return where the face's middle is [m], shape (3,), and the link's rotation, shape (3, 3), by its markers."""
        seen = [
            (marker.offset, place)
            for marker in self._markers(effector)
            if (place := hand_at(log, marker.marker_id, time)) is not None
        ]
        if len(seen) < FEWEST_MARKERS:
            return None
        offsets, places = (np.array(part) for part in zip(*seen, strict=True))
        turn, _ = Rotation.align_vectors(places - places.mean(axis=0), offsets - offsets.mean(axis=0))
        rotation = turn.as_matrix()
        middle = next(marker.offset for marker in self._body.markers if marker.name == effector.name)
        return places.mean(axis=0) + rotation @ (np.array(middle) - offsets.mean(axis=0)), rotation

    def _on_face(self, effector: Effector, pose: tuple[Array, Array], contact: Array) -> bool:
        middle, rotation = pose
        normal = rotation @ np.array(effector.normal)
        from_middle = contact - middle
        height = float(from_middle @ normal)
        across = float(np.linalg.norm(from_middle - height * normal))
        margin = self._options.face_margin
        return height >= -margin and across <= 0.5 * effector.width + margin


def _velocity(times: Array, positions: Array, time: float) -> Array | None:
    """Return the velocity at a time from the samples just before it, on a parabola [m/s], shape (3,).

    None where there are too few samples.
    """
    since = times - time
    near = (since >= -FIT_TIME) & (since <= 0.0)
    if near.sum() < FEWEST:
        return None
    slope: Array = np.polynomial.polynomial.polyfit(since[near], positions[near], 2)[1]
    return slope


def _create(config: ExperimentConfig, options: Model, body: Body) -> Task:
    return CatchTask(config, options, body)


TASK = TaskPlugin("touch a thrown ball with a face, slowly enough", "Catch", "caught", "catches", CatchOptions, _create)
