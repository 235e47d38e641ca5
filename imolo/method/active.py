"""Which motion to try next: the one of which the forward model knows least."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imolo.method.forward_model import ForwardModel

Array = NDArray[np.float64]


def least_certain(model: ForwardModel, motions: Array, since_swing: Sequence[float]) -> int:
    """Return which motion has the largest variance, summed over the axes and the times.

    Args:
        model: Fitted; its estimator predicts a standard deviation.
        motions: To choose from, shape (M, n).
        since_swing: Times since the start of the swing at which the hand matters [s].

    Raises:
        ConfigError: The estimator knows no standard deviation.
    """
    theta = np.repeat(motions, len(since_swing), axis=0)
    time = model.template.swing_start(theta) + np.tile(since_swing, len(motions))
    variance = (model.predict_std(theta, time) ** 2).sum(axis=1).reshape(len(motions), -1)
    return int(variance.sum(axis=1).argmax())
