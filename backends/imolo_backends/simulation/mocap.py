"""Motion-capture cameras as the planner meets them: late, noisy, and not always complete (Secs. V-B, VII-A)."""

from collections import deque

import numpy as np

from imolo.config.simulation import MocapConfig
from imolo.contracts.engine import Array, EngineState
from imolo.contracts.robot import Body
from imolo_msgs import marker_t, mocap_frame_t

GHOST_DISTANCE = 3.0  # [m] from the base along each axis at most, assumed: the capture volume


class Mocap:
    """Exposes frames, keeps them for the latency, and loses some of what was in them."""

    def __init__(self, config: MocapConfig, body: Body, rng: np.random.Generator) -> None:
        """Prepare the cameras.

        Args:
            config: What is wrong with them.
            body: Whose markers they see.
            rng: Chance of this trial.
        """
        self._config = config
        self._rng = rng
        self._markers = body.markers
        self._link = np.array([body.link_of(marker) for marker in body.markers])
        self._offset = np.array([marker.offset for marker in body.markers])
        self._frame_number = 0
        self._late = round(config.clock_offset * 1e6)
        self._waiting: deque[tuple[int, mocap_frame_t]] = deque()

    def expose(self, utime: int, state: EngineState) -> None:
        """Take a frame of the state at `utime` [µs]."""
        config, count = self._config, len(self._markers)
        self._frame_number += 1
        # Always the same number of draws, so that one lost marker does not change the rest of the trial.
        normal = self._rng.standard_normal((count + 1, 3))
        chance = self._rng.random(2 * count + 6).tolist()
        ball_chance, frame_chance, ghost_chance, *ghost_place = chance[2 * count :]
        if frame_chance < config.frame_dropout:
            return
        robot = (self.true_markers(state) + config.marker_noise * normal[:count]).tolist()
        markers = [
            _marker(marker.marker_id if label_chance >= config.unlabelled else marker_t.UNLABELLED, position)
            for marker, position, seen_chance, label_chance in zip(
                self._markers, robot, chance[:count], chance[count : 2 * count], strict=True
            )
            if seen_chance >= config.marker_dropout
        ]
        if ball_chance >= config.ball_dropout:
            markers.append(
                _marker(marker_t.UNLABELLED, (state.ball_position + config.ball_noise * normal[count]).tolist())
            )
        if ghost_chance < config.ghost:
            ghost = state.link_position[0] + GHOST_DISTANCE * (2.0 * np.array(ghost_place) - 1.0)
            markers.append(_marker(marker_t.UNLABELLED, ghost.tolist()))
        frame = mocap_frame_t()
        frame.utime = utime + self._late
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


def _marker(marker_id: int, position: list[float]) -> marker_t:
    marker = marker_t()
    marker.marker_id = marker_id
    marker.marker_position = position
    return marker
