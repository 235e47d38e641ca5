"""How far the hand may be from where the forward model predicts it, judged on motions that were left out of the fit."""

import numpy as np
from numpy.typing import NDArray

from imolo.method.forward_model import ForwardModel

Array = NDArray[np.float64]

FEWEST_MOTIONS = 3  # assumed: with fewer nothing is learned of what lies between them
MOST_LEFT_OUT = 60  # motions, evenly among all: a mean over more of them would tell the floor no better than to 10 %


class HandUncertainty:
    """Standard deviation of the hand about its prediction, from leave-one-motion-out errors.

    variance = variance predicted by the model (0 where it predicts none) + floor², the floor along each axis being the
    likeliest one for the errors on motions that were left out. A Gaussian process needs it because it takes the samples
    of one motion for independent and the hand for smoother than it is; without a predicted variance the floor is the
    root mean square of the errors. What differs from trial to trial (valves, supply, pose) is in the errors, too.

    Attributes:
        floor: Along each world axis [m], shape (3,).
    """

    def __init__(self, model: ForwardModel) -> None:
        """Leave out one motion after the other.

        Raises:
            NotTrainedError: The model has not been fitted.
        """
        self._model = model
        training = model.training
        motions = np.unique(training.theta, axis=0)
        if len(motions) < FEWEST_MOTIONS:
            # Nothing can be left out; the hand is then no more certain than the samples are spread.
            self.floor: Array = training.position.std(axis=0)
            return
        errors, variances, weights = [], [], []
        for motion in motions[:: -(-len(motions) // MOST_LEFT_OUT)]:
            left_out = (training.theta == motion).all(axis=1)
            rest = ~left_out
            other = model.refitted(training.theta[rest], training.time[rest], training.position[rest])
            at = training.theta[left_out], training.time[left_out]
            errors.append(other.predict(*at) - training.position[left_out])
            variances.append(_variance(other, *at))
            weights.append(np.full(left_out.sum(), 1.0 / left_out.sum()))
        self.floor = np.sqrt(
            _likeliest_floor(np.concatenate(errors), np.concatenate(variances), np.concatenate(weights))
        )

    def std(self, theta: Array, time: Array) -> Array:
        """Return the standard deviation along each world axis [m], shape (N, 3).

        Args:
            theta: Motion parameters, shape (N, n).
            time: Time since motion onset [s], shape (N,).
        """
        result: Array = np.sqrt(_variance(self._model, theta, time) + self.floor**2)
        return result


def _variance(model: ForwardModel, theta: Array, time: Array) -> Array:
    if not model.knows_std:
        return np.zeros((len(theta), 3))
    predicted: Array = model.predict_std(theta, time) ** 2
    return predicted


def _likeliest_floor(error: Array, variance: Array, weight: Array) -> Array:
    """Return the variance [m²] to add to make normal errors likeliest, along each axis, shape (3,).

    Args:
        error: [m], shape (N, 3).
        variance: Predicted [m²], shape (N, 3).
        weight: Of each sample, shape (N,).
    """
    candidates = np.linspace(0.0, np.sqrt(np.max(error**2, axis=0)), 201)[:, np.newaxis] ** 2  # (201, 1, 3)
    total = variance + candidates + 1e-12
    cost = np.einsum("n,cna->ca", weight, np.log(total) + error**2 / total)
    best: Array = np.take_along_axis(candidates[:, 0], cost.argmin(axis=0)[np.newaxis], axis=0)[0]
    return best
