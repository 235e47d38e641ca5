"""Check logs of a robot before anything is fitted to them: what cannot be used is left out, and said in a line."""

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of
from imolo.contracts.actuators import Channel
from imolo.errors import BusError, TrainingDataError
from imolo.identification.experiment import Finding
from imolo.identification.robot_logs import (
    RobotLog,
    largest_range,
    marker_samples,
    read_motion,
    sensor_samples,
    sensor_unit,
)
from imolo.messaging import channels
from imolo.messaging.log import Log, read_log

Array = NDArray[np.float64]

LENGTHS = {1000.0: "mm", 100.0: "cm", 39.37: "inches"}
ALIKE = 1.3  # a ratio of two lengths this far from another is another unit
ASIDE = 0.1  # [m] rms distance from the ready pose above which the frame is not the world's
HIGHEST, LOWEST = 3.0, 1e-3  # of a channel's range: readings beyond are in another unit
SHIFTED = 0.08  # of a channel's range: all channels read so much above their rest targets
GAP = 0.05  # [s] in which a marker moves too far to be followed
MARGIN = 0.05  # [s] that a recording may end before the motion does


def read_logs(
    paths: Sequence[tuple[str, Path]], config: ExperimentConfig, duration: float | None, quantities: Collection[str]
) -> tuple[list[RobotLog], list[Finding]]:
    """Read the motions of logs.

    Args:
        paths: Name and file of each.
        config: Of the robot.
        duration: See `read_motion`.
        quantities: What the study compares, which a log must hold.

    Returns:
        The motions that can be used, and what was found.
    """
    motions: list[RobotLog] = []
    left_out: dict[str, list[str]] = {}
    standing: list[tuple[float, float]] = []
    for name, path in paths:
        try:
            log = read_log(path)
            motion = usable_motion(log, name, config, duration, quantities)
        except (BusError, TrainingDataError) as error:
            left_out.setdefault(str(error).replace(f"{path}: ", "").replace(str(path), "it"), []).append(name)
            continue
        motions.append(motion)
        standing.append(_noise(log, motion.commands.onset_utime, config))
    findings = [
        Finding("left out", text, warning=True, recordings=tuple(names), unusable=True)
        for text, names in left_out.items()
    ]
    if motions:
        findings += _describe(motions, standing, config)
    return motions, findings


def usable_motion(
    log: Log, name: str, config: ExperimentConfig, duration: float | None, quantities: Collection[str]
) -> RobotLog:
    """Return the motion of a log that can be used.

    Raises:
        TrainingDataError: It cannot, for this reason.
    """
    _check_robot(log, config)
    _check_stamps(log, config)
    motion = read_motion(log, name, config, duration)
    onset = motion.commands.onset_utime
    _check_markers(log, motion, onset, config, quantities)
    _check_sensors(log, onset, config, quantities)
    return motion


def _check_robot(log: Log, config: ExperimentConfig) -> None:
    said = [one.robot_name for one in log.messages[channels.ROBOT]]
    said += [event.robot for event in log.messages[channels.TRIAL]]
    others = {name for name in said if name and name != config.robot.name}
    if others:
        other = others.pop()
        raise TrainingDataError(
            f"is of the robot {other!r}, the config of {config.robot.name!r}; give config: {{robot: {{name: {other}}}}}"
        )
    expected = [channel.unit for channel in config.simulation.actuators.channels]
    for one in log.messages[channels.ROBOT]:
        if list(one.channel_unit) != expected:
            raise TrainingDataError(
                f"has channels in {', '.join(one.channel_unit) or 'no unit'}, the config's robot in "
                f"{', '.join(expected)}; give the config of this robot"
            )


def _check_stamps(log: Log, config: ExperimentConfig) -> None:
    for channel, rate in ((channels.MOCAP, config.simulation.mocap.rate), (channels.ACTUATOR_STATE, None)):
        stamps = np.array([message.utime for message in log.messages[channel]], dtype=np.float64)
        if len(stamps) < 2:
            continue
        steps = np.diff(stamps)
        if (steps < 0).any():
            raise TrainingDataError(f"has {channel} whose time steps back; cut it there, each piece is a recording")
        ratio = float(np.median(steps)) * 1e-6 * (rate or 1.0)
        if rate is not None and not 0.02 < ratio < 50.0:
            raise TrainingDataError(
                f"has {channel} every {float(np.median(steps)) * 1e-6:g} s where {1.0 / rate:.3g} s are expected; "
                "stamps are in microseconds"
            )


def _check_markers(
    log: Log, motion: RobotLog, onset: int, config: ExperimentConfig, quantities: Collection[str]
) -> None:
    body = body_of(config.robot)
    if not {"effector", "markers"} & set(quantities):
        return
    if not log.messages[channels.MOCAP]:
        raise TrainingDataError("holds no MOCAP; record the cameras, or give quantities: [sensors]")
    if not motion.markers:
        raise TrainingDataError("shows no labelled marker during the motion; label them as `imolo robots` says")
    if "effector" in quantities and motion.effector not in motion.markers:
        raise TrainingDataError(
            f"never shows marker {motion.effector} ({body.effectors[0].name}) during the motion; label it, or leave "
            "effector out of quantities"
        )
    if "markers" in quantities and set(motion.markers) == {motion.effector}:
        raise TrainingDataError("shows no marker but the effector's; leave markers out of quantities")
    last = max(time[-1] for time, _ in motion.markers.values())
    if last < motion.until - MARGIN:
        raise TrainingDataError(
            f"shows markers until {last:.2f} s after the onset only, {motion.until:.2f} s are compared; give a shorter "
            "duration"
        )
    ready = body.ready_markers()
    pairs = []
    for marker in body.markers:
        time, position = marker_samples(log, marker.marker_id, onset)
        before = position[(time <= 0.0) & np.isfinite(position).all(axis=1)]
        if len(before):
            pairs.append((np.median(before, axis=0), np.array(ready[marker.name])))
    if len(pairs) < 2:
        return
    seen, expected = (np.array(part) for part in zip(*pairs, strict=True))
    ratio = float(np.linalg.norm(seen - seen.mean(axis=0)) / np.linalg.norm(expected - expected.mean(axis=0)))
    for factor, unit in LENGTHS.items():
        if factor / ALIKE < ratio < factor * ALIKE:
            raise TrainingDataError(f"has markers in {unit}, {ratio:.4g} times what metres would be; record metres")
    off = float(np.sqrt(((seen - expected) ** 2).sum(axis=1).mean()))
    if off > ASIDE:
        raise TrainingDataError(
            f"has the robot {off:.2g} m from its ready pose before the onset, and {ratio:.3g} times as large; record "
            "metres in the world's frame, x forward, z up, floor at 0"
        )


def _check_sensors(log: Log, onset: int, config: ExperimentConfig, quantities: Collection[str]) -> None:
    if "sensors" not in quantities:
        return
    time, measured = sensor_samples(log, onset)
    if not len(time):
        raise TrainingDataError("holds no ACTUATOR_STATE; record the sensors, or leave sensors out of quantities")
    actuators = config.simulation.actuators.channels
    if measured.shape[1] != len(actuators):
        raise TrainingDataError(
            f"has {measured.shape[1]} sensors, the config's robot {len(actuators)}; give the config of this robot"
        )
    finite = np.isfinite(measured)
    if not finite.all(axis=1).any():
        raise TrainingDataError("has no reading of all sensors that is a number; leave sensors out of quantities")
    for unit in dict.fromkeys(channel.unit for channel in actuators):
        own = [number for number, channel in enumerate(actuators) if channel.unit == unit]
        _check_readings(time, measured[:, own], [actuators[number] for number in own])


def _check_readings(time: Array, measured: Array, actuators: Sequence[Channel]) -> None:
    """Refuse readings of channels with the same unit that are in another one, or shifted."""
    finite, unit = np.isfinite(measured), actuators[0].unit
    largest = float(np.abs(measured[finite]).max())
    span = largest_range(actuators)
    if not LOWEST * span < largest < HIGHEST * span:
        raise TrainingDataError(f"has readings up to {largest:.3g} where the range is {span:.3g} {unit}; record {unit}")
    before = measured[(time <= 0.0) & finite.all(axis=1)]
    if len(before):
        above = np.median(before, axis=0) - [channel.rest for channel in actuators]
        if float(above.min()) > SHIFTED * span:
            raise TrainingDataError(
                f"has every sensor at least {float(above.min()):.3g} {unit} above its rest before the onset; record "
                "gauge pressures, or take the offset off"
            )


def _noise(log: Log, onset: int, config: ExperimentConfig) -> tuple[float, float]:
    """Return the standard deviation of markers [m] and sensors while the robot stands; NaN where nothing is seen."""
    spreads = []
    for marker in body_of(config.robot).markers:
        time, position = marker_samples(log, marker.marker_id, onset)
        still = position[(time > -0.2) & (time <= 0.0) & np.isfinite(position).all(axis=1)]
        if len(still) > 4:
            spreads.append(float(np.diff(still, axis=0).std() / np.sqrt(2.0)))
    time, measured = sensor_samples(log, onset)
    still = measured[(time > -0.2) & (time <= 0.0)]
    _, sizes = sensor_unit(config.simulation.actuators.channels)
    known = len(still) > 4 and still.shape[1] == len(sizes)  # it need not be where sensors are not compared
    sensors = float(np.nanstd(np.diff(still / sizes, axis=0)) / np.sqrt(2.0)) if known else np.nan
    return float(np.median(spreads)) if spreads else np.nan, sensors


def _describe(
    motions: Sequence[RobotLog], standing: Sequence[tuple[float, float]], config: ExperimentConfig
) -> list[Finding]:
    unit, _ = sensor_unit(config.simulation.actuators.channels)
    noise = np.array(standing)
    findings = []
    for column, factor, text in ((0, 1e3, "mm of a marker, each axis"), (1, 1.0, f"{unit} of a sensor")):
        values = noise[np.isfinite(noise[:, column]), column]
        if len(values):
            value = factor * float(np.median(values))
            findings.append(Finding("noise", f"{value:.2g} {text}, while the robot stands", value=value))
    labels = {marker.marker_id: marker.name for marker in body_of(config.robot).markers}
    unseen = {label: [one.name for one in motions if label not in one.markers] for label in labels}
    for label, names in unseen.items():
        if names:
            text = f"marker {label} ({labels[label]}) is never seen during the motion; the others are compared"
            findings.append(Finding("markers", text, warning=True, recordings=tuple(names)))
    gaps = [(max(float(np.diff(t, prepend=0.0, append=m.until).max()) for t, _ in m.markers.values()), m.name)
            for m in motions if m.markers]  # fmt: skip
    if long := [(gap, name) for gap, name in gaps if gap > GAP]:
        text = f"a marker is not seen for up to {max(long)[0]:.2f} s; nothing is compared there"
        findings.append(Finding("gaps", text, warning=True, recordings=tuple(name for _, name in long)))
    if broken := [one.name for one in motions if one.not_finite]:
        text = f"{sum(one.not_finite for one in motions)} samples are not finite and left out"
        findings.append(Finding("not finite", text, warning=True, recordings=tuple(broken)))
    return findings
