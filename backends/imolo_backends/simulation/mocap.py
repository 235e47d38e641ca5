"""Motion-capture cameras as the planner meets them: late, noisy, and not always complete (Secs. V-B, VII-A)."""

from collections import deque

import numpy as np

from imolo.config.simulation import MocapConfig
from imolo.contracts.engine import Array, EngineState
from imolo.contracts.robot import Body
from imolo_backends.simulation.streams import MARKER, pack_frame
from imolo_msgs import marker_t

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
        self._label = np.array([marker.marker_id for marker in body.markers])
        self._link = np.array([body.link_of(marker) for marker in body.markers])
        self._offset = np.array([marker.offset for marker in body.markers])
        self._frame_number = 0
        self._late = round(config.clock_offset * 1e6)
        self._waiting: deque[tuple[int, bytes]] = deque()

    def expose(self, utime: int, state: EngineState) -> None:
        """Take a frame of the state at `utime` [µs]."""
        config, count = self._config, len(self._label)
        self._frame_number += 1
        # Always the same number of draws, so that one lost marker does not change the rest of the trial.
        normal = self._rng.standard_normal((count + 1, 3))
        chance = self._rng.random(2 * count + 6)
        ball_chance, frame_chance, ghost_chance = chance[2 * count : 2 * count + 3].tolist()
        if frame_chance < config.frame_dropout:
            return
        # The robot's markers, the ball, what is not there.
        markers, seen = np.empty(count + 2, MARKER), np.empty(count + 2, dtype=bool)
        label, place = markers["marker_id"], markers["marker_position"]
        label[:] = marker_t.UNLABELLED
        label[:count] = np.where(chance[count : 2 * count] >= config.unlabelled, self._label, marker_t.UNLABELLED)
        place[:count] = self.true_markers(state) + config.marker_noise * normal[:count]
        place[count] = state.ball_position + config.ball_noise * normal[count]
        place[count + 1] = state.link_position[0] + GHOST_DISTANCE * (2.0 * chance[2 * count + 3 :] - 1.0)
        seen[:count] = chance[:count] >= config.marker_dropout
        seen[count:] = ball_chance >= config.ball_dropout, ghost_chance < config.ghost
        frame = pack_frame(utime + self._late, self._frame_number, markers[seen])
        self._waiting.append((utime + round(config.latency * 1e6), frame))

    def deliver(self, utime: int) -> list[bytes]:
        """Return the frames whose latency is over at `utime` [µs], each a `mocap_frame_t`."""
        frames = []
        while self._waiting and self._waiting[0][0] <= utime:
            frames.append(self._waiting.popleft()[1])
        return frames

    def true_markers(self, state: EngineState) -> Array:
        """Return the positions of all robot markers without any fault [m], shape (M, 3)."""
        rotation = state.link_rotation[self._link]
        return np.asarray(state.link_position[self._link] + np.einsum("mij,mj->mi", rotation, self._offset))
