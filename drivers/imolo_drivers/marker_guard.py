"""Gives markers that have taken each other's name their own again."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from imolo.config.model import Model, NonNegative, Positive
from imolo_msgs import marker_t, mocap_frame_t

Array = NDArray[np.float64]


class MarkerGuardConfig(Model):
    """When a labelled marker cannot be the one that bears its label."""

    speed: Positive = Field(15.0, description="no marker of the robot is faster [m/s], assumed: a hand swings at 8.4")
    slack: NonNegative = Field(0.05, description="jump that is always believed [m], assumed: a marker half hidden")


class MarkerGuard:
    """Compares every labelled marker with where it was.

    Attributes:
        renamed: How many markers were given back their name.
        removed: How many were left out, nobody knowing whose they are.
    """

    def __init__(self, config: MarkerGuardConfig) -> None:
        """Know nothing yet."""
        self.renamed = self.removed = 0
        self._config = config
        self._seen: dict[int, tuple[int, Array]] = {}

    def repair(self, frame: mocap_frame_t) -> None:
        """Correct the labels of a frame in place; what jumped to where no other marker was is left out."""
        left_out = self._rename([marker for marker in frame.markers if self._jumped(marker)], frame.utime)
        frame.markers = [marker for marker in frame.markers if not any(marker is one for one in left_out)]
        frame.num_markers = len(frame.markers)
        for marker in frame.markers:
            if marker.marker_id != marker_t.UNLABELLED:
                self._seen[marker.marker_id] = (frame.utime, np.array(marker.marker_position))

    def _jumped(self, marker: marker_t) -> bool:
        if marker.marker_id not in self._seen:
            return False
        _, place = self._seen[marker.marker_id]
        return float(np.linalg.norm(np.array(marker.marker_position) - place)) > self._config.slack

    def _rename(self, jumped: list[marker_t], utime: int) -> list[marker_t]:
        """Share the names of the markers that jumped out among them anew; return those that can have none of them.

        After a gap in the frames a marker can have come from almost everywhere, which is no reason to believe its name.
        The least sum of squared distances tells who is who, and changes nothing where all moved together: a common
        displacement adds the same to every way of sharing.
        """
        if not jumped:
            return []
        labels = [marker.marker_id for marker in jumped]
        before, places = zip(*(self._seen[label] for label in labels), strict=True)
        now = np.array([marker.marker_position for marker in jumped])
        distances = np.linalg.norm(now[:, np.newaxis] - np.array(places), axis=2)
        possible = self._config.slack + self._config.speed * 1e-6 * (utime - np.array(before)) >= distances
        # What is impossible is chosen where nothing else is left.
        cost = np.where(possible, 0.0, 1.0 + np.sum(distances**2)) + distances**2
        left_out = []
        from scipy.optimize import linear_sum_assignment  # late, so that the backends are listed at once

        for i, j in zip(*linear_sum_assignment(cost), strict=True):
            if not possible[i, j]:
                left_out.append(jumped[i])
            elif i != j:
                jumped[i].marker_id = labels[j]
                self.renamed += 1
        self.removed += len(left_out)
        return left_out
