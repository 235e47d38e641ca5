"""Where the cameras' frame lies, from the robot itself: its markers in the ready pose are at known places."""

import select
import time

from imolo.contracts.robot import Body
from imolo.errors import CalibrationError
from imolo_drivers.natnet.calibration import Calibration, CalibrationLimits, fit
from imolo_drivers.natnet.client import NatNetClient
from imolo_drivers.natnet.config import NatNetConfig
from imolo_drivers.natnet.markers import find_labels, rest_positions
from imolo_drivers.natnet.messages import Frame, ModelDefinitions

POLL = 0.05  # [s] between two looks whether to go on waiting


def calibrate(
    cameras: NatNetConfig, body: Body, seconds: float, patience: float
) -> tuple[Calibration, dict[str, float]]:
    """Watch the robot at rest in its ready pose, and fit where the cameras' frame lies.

    Args:
        cameras: How they are reached, and what their markers are called.
        body: Of the robot, which tells where its markers are in the ready pose.
        seconds: How long to watch [s].
        patience: How long to wait for the first frame [s].

    Returns:
        The calibration, and how far each marker is from where it should be, by name [m].

    Raises:
        NatNetError: The cameras cannot be understood, or do not know the robot.
        CalibrationError: There are no frames, a marker is hidden or moves, or the markers do not fit.
    """
    with NatNetClient(cameras) as client:
        definitions, frames = _watch(client, seconds, patience)
    limits, labels = CalibrationLimits(), cameras.labels.of(body)
    # An effector may hang freely while the actuators are off, as arms without air do.
    loose = {effector.name for effector in body.effectors}
    known = {name: place for name, place in body.ready_markers().items() if name not in loose}
    ours = {marker.marker_id: marker.name for marker in body.markers}
    names = {label: ours[label] for label in labels.markers.values() if ours.get(label) in known}
    measured = rest_positions(frames, find_labels(labels, definitions), names, limits)
    calibration = fit(measured, known, limits)
    return calibration, calibration.errors(measured, known)


def _watch(client: NatNetClient, seconds: float, patience: float) -> tuple[ModelDefinitions, list[Frame]]:
    """Return the models that Motive streams, and its frames of some seconds from the first one on."""
    frames: list[Frame] = []
    end = time.monotonic() + patience
    while (now := time.monotonic()) < end:
        select.select((client,), (), (), min(POLL, end - now))
        began = bool(frames)
        # Without the models nobody knows which marker is which.
        new = client.poll()
        frames += new if client.definitions is not None else []
        if frames and not began:
            end = time.monotonic() + seconds
    if client.definitions is None or not frames:
        raise CalibrationError(client.missing(patience))
    return client.definitions, frames
