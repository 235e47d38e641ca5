"""From the markers of a NatNet frame to a MOCAP message: our labels, the world frame."""

from collections.abc import Mapping, Sequence

import numpy as np

from imolo.errors import CalibrationError, NatNetError, did_you_mean
from imolo_drivers.natnet import messages as m
from imolo_drivers.natnet.calibration import Calibration, CalibrationLimits
from imolo_drivers.natnet.config import NamedMarkers
from imolo_msgs import marker_t, mocap_frame_t

Labels = Mapping[tuple[int, int], int]
"""Our label of a marker by `model_id` and `marker_id`."""


def find_labels(config: NamedMarkers, definitions: m.ModelDefinitions) -> dict[tuple[int, int], int]:
    """Find the robot's markers among the models that Motive streams.

    Raises:
        NatNetError: There is no such asset, its id is not known, or a marker is missing.
    """
    asset = config.asset
    names = _marker_names(asset, definitions)
    if names is None:
        known = sorted({definition.name for definition in definitions.definitions if hasattr(definition, "name")})
        raise NatNetError(
            f"Motive streams no asset {asset!r}{did_you_mean(asset, known)}; it streams {', '.join(known) or 'none'}"
        )
    model_id = config.model_id or _model_id(asset, definitions)
    if model_id is None:
        raise NatNetError(f"Motive does not tell the id of the marker set {asset!r}; set labels.model_id")
    missing = sorted(set(config.markers) - set(names))
    if missing:
        raise NatNetError(
            f"the asset {asset!r} has no marker {missing[0]!r}{did_you_mean(missing[0], names)}; "
            f"it has {', '.join(names) or 'none with a name'}"
        )
    return {(model_id, names[name]): label for name, label in config.markers.items()}


def mocap_frame(frame: m.Frame, utime: int, labels: Labels, calibration: Calibration) -> mocap_frame_t:
    """Return the MOCAP message of a frame that was exposed at `utime` [µs].

    It holds the robot's markers and those of no model, as far as they were seen; markers of other models are left out.
    """
    robot = [
        (labels[key], marker.position)
        for marker in frame.labelled
        if marker.seen and (key := (marker.model_id, marker.marker_id)) in labels
    ]
    positions = np.array([position for _, position in robot], dtype=np.float64).reshape(-1, 3)
    world = calibration.to_world(np.concatenate([positions, frame.unlabelled]))
    message = mocap_frame_t()
    message.utime = utime
    message.frame_number = frame.number
    message.num_markers = len(world)
    message.markers = []
    marker_ids = [label for label, _ in robot] + [marker_t.UNLABELLED] * len(frame.unlabelled)
    for marker_id, position in zip(marker_ids, world.tolist(), strict=True):
        marker = marker_t()
        marker.marker_id = marker_id
        marker.marker_position = position
        message.markers.append(marker)
    return message


def rest_positions(
    frames: Sequence[m.Frame], labels: Labels, names: Mapping[int, str], limits: CalibrationLimits
) -> dict[str, m.Vector3]:
    """Return the mean positions of markers of a robot at rest over the frames that saw them, in Motive's frame [m].

    Args:
        frames: Of some seconds.
        labels: Of all of the robot's markers.
        names: Name of each label whose marker is wanted.
        limits: What the markers must keep to.

    Raises:
        CalibrationError: A marker was not seen, or too seldom, or it moved.
    """
    seen: dict[int, list[m.Vector3]] = {label: [] for label in names}
    for frame in frames:
        for marker in frame.labelled:
            label = labels.get((marker.model_id, marker.marker_id))
            if label in seen and marker.seen:
                seen[label].append(marker.position)
    hidden = [
        f"{names[label]} in {len(positions)}"
        for label, positions in seen.items()
        if len(positions) < max(limits.min_seen * len(frames), 1)
    ]
    if hidden:
        raise CalibrationError(
            f"of {len(frames)} frames the cameras saw {', '.join(hidden)}; {100 * limits.min_seen:.0f} % are needed. "
            "Uncover the markers, and look in Motive whether they have their labels"
        )
    motion = {names[label]: float(np.std(positions, axis=0).max()) for label, positions in seen.items()}
    name = max(motion, key=lambda one: motion[one])
    if motion[name] > limits.max_motion:
        raise CalibrationError(
            f"{name} moved by {1e3 * motion[name]:.1f} mm (standard deviation), at most {1e3 * limits.max_motion:.1f} "
            "mm are allowed; let the robot rest"
        )
    return {names[label]: tuple(np.mean(positions, axis=0).tolist()) for label, positions in seen.items()}


def _marker_names(asset: str, definitions: m.ModelDefinitions) -> dict[str, int] | None:
    """Return the `marker_id` of each name; in a model they count from 1."""
    of_set: dict[str, int] | None = None
    for definition in definitions.definitions:
        match definition:
            case m.AssetDefinition(name=name, markers=markers) if name == asset:
                return {marker.name: marker.marker_id & 0xFFFF for marker in markers}
            case m.RigidBodyDefinition(name=name, markers=markers) if name == asset:
                of_body = {marker.name: place for place, marker in enumerate(markers, 1) if marker.name}
                if of_body:
                    return of_body
            case m.MarkerSetDefinition(name=name, marker_names=marker_names) if name == asset:
                of_set = {marker_name: place for place, marker_name in enumerate(marker_names, 1)}
    return of_set


def _model_id(asset: str, definitions: m.ModelDefinitions) -> int | None:
    for definition in definitions.definitions:
        match definition:
            case (
                m.AssetDefinition(name=name, asset_id=model_id)
                | m.RigidBodyDefinition(name=name, body_id=model_id)
                | m.SkeletonDefinition(name=name, skeleton_id=model_id)
            ) if name == asset:
                return model_id
    return None
