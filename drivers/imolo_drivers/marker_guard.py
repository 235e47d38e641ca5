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
        kept: list[marker_t] = []
        strangers: list[marker_t] = []
        for marker in frame.markers:
            labelled = marker.marker_id != marker_t.UNLABELLED
            (strangers if labelled and self._jump(marker.marker_id, marker, frame.utime) > 0.0 else kept).append(marker)
        for label in [marker.marker_id for marker in strangers]:
            jump, nearest = min((self._jump(label, marker, frame.utime), i) for i, marker in enumerate(strangers))
            if jump <= 0.0:
                marker = strangers.pop(nearest)
                marker.marker_id = label
                kept.append(marker)
                self.renamed += 1
        self.removed += len(strangers)
        for marker in kept:
            if marker.marker_id != marker_t.UNLABELLED:
                self._seen[marker.marker_id] = (frame.utime, np.array(marker.marker_position))
        frame.markers, frame.num_markers = kept, len(kept)

    def _jump(self, label: int, marker: marker_t, utime: int) -> float:
        """Return how much farther a marker is from where the label was than it can have come [m]."""
        if label not in self._seen:
            return 0.0
        before, place = self._seen[label]
        possible = self._config.slack + self._config.speed * (utime - before) * 1e-6
        return float(np.linalg.norm(np.array(marker.marker_position) - place)) - possible
