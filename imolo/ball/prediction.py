"""What a ball model predicts of a recorded flight, and how far it is off (paper Sec. VII-C)."""

import numpy as np
from numpy.typing import NDArray

from imolo.ball.flight import Flight
from imolo.ball.model import BallModel

Array = NDArray[np.float64]

START_SAMPLES = 4  # start the filter of a recorded flight: 12 numbers for 6 unknowns


def filter_flight(model: BallModel, flight: Flight) -> tuple[Array, Array]:
    """Run the Kalman filter over a recorded flight.

    Returns:
        States, shape (N, n), and covariances, shape (N, n, n), after each sample; NaN before the filter has started.
    """
    start = START_SAMPLES - 1
    state, covariance, _ = model.initial_state(flight.time[: start + 1], flight.position[: start + 1])
    states = np.full((len(flight.time), len(state)), np.nan)
    covariances = np.full((len(flight.time), len(state), len(state)), np.nan)
    states[start], covariances[start] = state, covariance
    for i in range(start + 1, len(flight.time)):
        state, covariance = model.propagate(state, covariance, flight.time[i] - flight.time[i - 1])
        # The update of the tracker's filter but for rounding, in a third of its time: fits run it 100,000 times.
        noise = model.measurement_covariance(state[:3])
        gain = np.linalg.solve(covariance[:3, :3] + noise, covariance[:3]).T
        state = state + gain @ (flight.position[i] - state[:3])
        covariance = covariance - gain @ covariance[:3]
        states[i], covariances[i] = state, covariance
    return states, covariances


def prediction_errors(
    model: BallModel, flight: Flight, horizon: float, settling_time: float = 0.10
) -> tuple[Array, Array]:
    """Compare a flight with what the filter predicted `horizon` earlier (Sec. VII-C).

    Every sample is a target once the filter had seen `settling_time` of the flight at the moment of prediction; the
    prediction starts at the last sample that is at least `horizon` older than its target.

    Args:
        model: Model of filter and prediction.
        flight: Flight that the model was not fitted to.
        horizon: Lead time [s].
        settling_time: Observation before the first prediction [s].

    Returns:
        Predicted minus measured position [m], shape (M, 3), M may be 0; its predicted covariance, shape (M, 3, 3).
    """
    states, covariances = filter_flight(model, flight)
    time = flight.time
    tolerance = 1e-6  # [s] the resolution of message time
    earliest = max(time[0] + settling_time, time[START_SAMPLES - 1])
    errors, spreads = [], []
    for j in np.flatnonzero(time - horizon >= earliest - tolerance):
        i = np.searchsorted(time, time[j] - horizon + tolerance, side="right") - 1
        state, covariance = model.propagate(states[i], covariances[i], time[j] - time[i])
        errors.append(state[:3] - flight.position[j])
        spreads.append(covariance[:3, :3] + model.measurement_covariance(state[:3]))
    return np.reshape(errors, (-1, 3)), np.reshape(spreads, (-1, 3, 3))
