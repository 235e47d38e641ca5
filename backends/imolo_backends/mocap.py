"""Motion-capture cameras as the planner meets them: late, noisy, and not always complete (Secs. V-B, VII-A)."""

from collections import deque

import numpy as np

from imolo.config.simulation import MocapConfig
from imolo_backends.engine import Array, EngineState
from imolo_backends.liberobot import MARKERS
from imolo_msgs import marker_t, mocap_frame_t

UNLABELLED = -1


class Mocap:
    """Exposes frames, keeps them for the latency, and loses some of what was in them."""

    def __init__(self, config: MocapConfig, link_names: tuple[str, ...], rng: np.random.Generator) -> None:
        """Prepare the cameras.

        Args:
            config: What is wrong with them.
            link_names: Order of the links in an `EngineState`.
            rng: Chance of this trial.
        """
        self._config = config
        self._rng = rng
        self._link = np.array([link_names.index(marker.link) for marker in MARKERS])
        self._offset = np.array([marker.offset for marker in MARKERS])
        self._frame_number = 0
        self._waiting: deque[tuple[int, mocap_frame_t]] = deque()

    def expose(self, utime: int, state: EngineState) -> None:
        """Take a frame of the state at `utime` [µs]."""
        config, rng = self._config, self._rng
        self._frame_number += 1
        # Always the same number of draws, so that one lost marker does not change the rest of the trial.
        robot = self.true_markers(state) + rng.normal(0.0, 1.0, self._offset.shape) * config.marker_noise
        ball = state.ball_position + rng.normal(0.0, 1.0, 3) * config.ball_noise
        ghost = state.link_position[0] + rng.uniform(-3.0, 3.0, 3)
        seen = rng.uniform(size=len(robot)) >= config.marker_dropout
        labelled = rng.uniform(size=len(robot)) >= config.unlabelled
        ball_seen, frame_seen, ghost_unseen = rng.uniform(size=3) >= (
            config.ball_dropout,
            config.frame_dropout,
            config.ghost,
        )
        if not frame_seen:
            return
        markers = [
            _marker(marker.marker_id if has_label else UNLABELLED, position)
            for marker, position, is_seen, has_label in zip(MARKERS, robot, seen, labelled, strict=True)
            if is_seen
        ]
        if ball_seen:
            markers.append(_marker(UNLABELLED, ball))
        if not ghost_unseen:
            markers.append(_marker(UNLABELLED, ghost))
        frame = mocap_frame_t()
        frame.utime = utime
        frame.frame_number = self._frame_number
        frame.num_markers = len(markers)
        frame.markers = markers
        self._waiting.append((utime + round(config.latency * 1e6), frame))

    def deliver(self, utime: int) -> list[mocap_frame_t]:
        """Return the frames whose latency is over at `utime` [µs]."""
        frames = []
        while self._waiting and self._waiting[0][0] <= utime:
            frames.append(self._waiting.popleft()[1])
        return frames

    def true_markers(self, state: EngineState) -> Array:
        """Return the positions of all robot markers without any fault [m], shape (M, 3)."""
        rotation = state.link_rotation[self._link]
        return np.asarray(state.link_position[self._link] + np.einsum("mij,mj->mi", rotation, self._offset))


def _marker(marker_id: int, position: Array) -> marker_t:
    marker = marker_t()
    marker.marker_id = marker_id
    marker.marker_position = position.tolist()
    return marker
