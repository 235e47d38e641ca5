"""Motion-capture cameras as the planner meets them: late, noisy, and not always complete (Secs. V-B, VII-A)."""

from collections import deque

import numpy as np
from numba import njit
from numpy.typing import NDArray

from imolo.config.simulation import MocapConfig
from imolo.contracts.engine import Array, EngineState
from imolo.contracts.robot import Body
from imolo_backends.simulation.streams import MARKER, pack_frame
from imolo_msgs import marker_t

NO_LABEL: int = marker_t.UNLABELLED
BALL, FRAME, GHOST = range(3)  # places of their chances behind those of the markers; then where the ghost is
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
        count = self._count = len(body.markers)
        self._markers = (
            np.array([marker.marker_id for marker in body.markers], dtype=np.int32),
            np.array([body.link_of(marker) for marker in body.markers], dtype=np.int64),
            np.array([marker.offset for marker in body.markers], dtype=np.float64).reshape(count, 3),
        )
        noise, of_marker = (config.marker_noise, config.ball_noise), (config.marker_dropout, config.unlabelled)
        self._faults = (*noise, *of_marker, config.ball_dropout, config.ghost)
        self._seen_id, self._seen_place = np.empty(count + 2, dtype=np.int32), np.empty((count + 2, 3))
        self._frame_number = 0
        self._late = round(config.clock_offset * 1e6)
        self._waiting: deque[tuple[int, bytes]] = deque()

    def expose(self, utime: int, state: EngineState) -> None:
        """Take a frame of the state at `utime` [µs]."""
        config, count = self._config, self._count
        self._frame_number += 1
        # Always the same number of draws, so that one lost marker does not change the rest of the trial.
        normal = self._rng.standard_normal((count + 1, 3))
        chance = self._rng.random(2 * count + 6)
        if chance[2 * count + FRAME] < config.frame_dropout:
            return
        bodies = state.link_position, state.link_rotation, state.ball_position
        count = _see(*bodies, *self._markers, self._faults, normal, chance, self._seen_id, self._seen_place)
        markers = np.empty(count, MARKER)
        markers["marker_id"], markers["marker_position"] = self._seen_id[:count], self._seen_place[:count]
        frame = pack_frame(utime + self._late, self._frame_number, markers)
        self._waiting.append((utime + round(config.latency * 1e6), frame))

    def deliver(self, utime: int) -> list[bytes]:
        """Return the frames whose latency is over at `utime` [µs], each a `mocap_frame_t`."""
        frames = []
        while self._waiting and self._waiting[0][0] <= utime:
            frames.append(self._waiting.popleft()[1])
        return frames


@njit(cache=True)
def _see(
    link_position: Array,
    link_rotation: Array,
    ball_position: Array,
    label: NDArray[np.int32],
    link: NDArray[np.int64],
    offset: Array,
    faults: tuple[float, ...],
    normal: Array,
    chance: Array,
    seen_id: NDArray[np.int32],
    seen_place: Array,
) -> int:
    """Write labels and places of what is seen: the robot's markers, the ball, what is not there.

    Args:
        link_position: [m], shape (L, 3).
        link_rotation: Shape (L, 3, 3).
        ball_position: [m], shape (3,).
        label: Of the robot's markers, shape (M,).
        link: On which they are, shape (M,).
        offset: Of each in the frame of its link [m], shape (M, 3).
        faults: Standard deviations of markers and ball [m]; chances that a marker is lost, that it bears no label, that
            the ball is lost, that there is a ghost.
        normal: Normally distributed, shape (M + 1, 3).
        chance: Uniformly distributed: of each marker to be lost, of each to bear no label; then see `BALL` and `GHOST`.
        seen_id: Out, shape (M + 2,).
        seen_place: Out [m], shape (M + 2, 3).

    Returns:
        How many are seen.
    """
    count, seen = len(label), 0
    marker_noise, ball_noise, dropout, unlabelled, ball_dropout, ghost = faults
    for marker in range(count):
        if chance[marker] >= dropout:
            seen_id[seen] = label[marker] if chance[count + marker] >= unlabelled else NO_LABEL
            turned = link_rotation[link[marker]]
            for axis in range(3):
                x, y, z = offset[marker]
                # In this order, by which recorded logs stay what they are.
                arm = (turned[axis, 0] * x + turned[axis, 2] * z) + turned[axis, 1] * y
                place = link_position[link[marker], axis] + arm
                seen_place[seen, axis] = place + marker_noise * normal[marker, axis]
            seen += 1
    rest = chance[2 * count :]
    if rest[BALL] >= ball_dropout:
        seen_id[seen] = NO_LABEL
        seen_place[seen] = ball_position + ball_noise * normal[count]
        seen += 1
    if rest[GHOST] < ghost:
        seen_id[seen] = NO_LABEL
        for axis in range(3):
            seen_place[seen, axis] = link_position[0, axis] + GHOST_DISTANCE * (2.0 * rest[GHOST + 1 + axis] - 1.0)
        seen += 1
    return seen
