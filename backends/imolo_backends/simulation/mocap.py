"""Motion-capture cameras as the planner meets them: late, noisy, and not always complete (Secs. V-B, VII-A)."""

from collections import deque
from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from imolo.config.simulation import MocapConfig
from imolo.contracts.engine import Array, EngineState
from imolo.contracts.robot import Body
from imolo_backends.simulation.streams import MARKER_SIZE, pack_frame, put_marker
from imolo_msgs import marker_t

NO_LABEL: int = marker_t.UNLABELLED
BALL, FRAME, GHOST = range(3)  # places of their chances behind those of the markers; then where the ghost is
BLOCK = 16  # frames whose chances are drawn together
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
        count = self._count = len(body.markers)
        self._markers = (
            np.array([marker.marker_id for marker in body.markers], dtype=np.int32),
            np.array([body.link_of(marker) for marker in body.markers], dtype=np.int64),
            np.array([marker.offset for marker in body.markers], dtype=np.float64).reshape(count, 3),
        )
        noise, of_marker = (config.marker_noise, config.ball_noise), (config.marker_dropout, config.unlabelled)
        self._faults = (*noise, *of_marker, config.ball_dropout, config.ghost)
        self._chances = _chances(rng, count)
        self._seen = np.empty((count + 2) * MARKER_SIZE, dtype=np.uint8)
        self._frame_number = 0
        self._late = round(config.clock_offset * 1e6)
        self._waiting: deque[tuple[int, bytes]] = deque()

    def expose(self, utime: int, state: EngineState) -> None:
        """Take a frame of the state at `utime` [µs]."""
        config = self._config
        self._frame_number += 1
        normal, chance = next(self._chances)
        if chance[2 * self._count + FRAME] < config.frame_dropout:
            return
        bodies = state.link_position, state.link_rotation, state.ball_position
        count = _see(*bodies, *self._markers, self._faults, normal, chance, self._seen)
        frame = pack_frame(utime + self._late, self._frame_number, count, self._seen)
        self._waiting.append((utime + round(config.latency * 1e6), frame))

    def deliver(self, utime: int) -> list[bytes]:
        """Return the frames whose latency is over at `utime` [µs], each a `mocap_frame_t`."""
        frames = []
        while self._waiting and self._waiting[0][0] <= utime:
            frames.append(self._waiting.popleft()[1])
        return frames


def _chances(rng: np.random.Generator, markers: int) -> Iterator[tuple[Array, Array]]:
    """Yield for one frame after the other numbers normally and uniformly distributed, see `_see`.

    Always as many, so that one lost marker does not change the rest of the trial; of several frames at once, since what
    draws them has left the processor's caches when the next one comes.
    """
    while True:
        yield from [(rng.standard_normal((markers + 1, 3)), rng.random(2 * markers + 6)) for _ in range(BLOCK)]


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
    out: NDArray[np.uint8],
) -> int:
    """Write a `marker_t` for each that is seen: the robot's markers, the ball, what is not there.

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
        out: Their bytes, shape ((M + 2) * MARKER_SIZE,).

    Returns:
        How many are seen.
    """
    count, seen, place = len(label), 0, np.empty(3)
    marker_noise, ball_noise, dropout, unlabelled, ball_dropout, ghost = faults
    for marker in range(count):
        if chance[marker] >= dropout:
            turned, start = link_rotation[link[marker]], link_position[link[marker]]
            x, y, z = offset[marker]
            for axis in range(3):
                # In this order, by which recorded logs stay what they are.
                place[axis] = start[axis] + ((turned[axis, 0] * x + turned[axis, 2] * z) + turned[axis, 1] * y)
                place[axis] += marker_noise * normal[marker, axis]
            put_marker(out, seen, label[marker] if chance[count + marker] >= unlabelled else NO_LABEL, place)
            seen += 1
    rest = chance[2 * count :]
    if rest[BALL] >= ball_dropout:
        put_marker(out, seen, NO_LABEL, ball_position + ball_noise * normal[count])
        seen += 1
    if rest[GHOST] < ghost:
        put_marker(out, seen, NO_LABEL, link_position[0] + GHOST_DISTANCE * (2.0 * rest[GHOST + 1 :] - 1.0))
        seen += 1
    return seen
