"""Where the cameras' frame lies in the world: a turn from y-up to z-up, then a fit of known markers.

Motive's frame is right-handed with y up; facing along its z, its x points left. Ours has x forward, y left and z up.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from imolo.config.model import Fraction, Model, NonNegative, Positive, Vector
from imolo.config.reading import read_model
from imolo.config.yaml_file import dump_yaml
from imolo.errors import CalibrationError, ConfigError
from imolo.machine.files import write_whole
from imolo_drivers.natnet.messages import Array

Z_UP = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Turns Motive's axes into ours: its z is forward, its x left, its y up."""


class CalibrationLimits(Model):
    """What markers and fit must keep to."""

    min_seen: Fraction = Field(0.5, description="share of the frames that must show a marker, assumed")
    max_motion: Positive = Field(
        0.002, description="sd of a marker at rest, each axis [m], assumed: seven times the noise of the cameras"
    )

    max_residual: Positive = Field(
        0.010, description="root mean square between markers and fit [m], assumed: places measured by hand"
    )
    max_error: Positive = Field(
        0.020, description="of one marker [m], assumed: twice that; more is a wrong label or a marker that came off"
    )
    min_spread: Positive = Field(
        0.05,
        description="of the markers across their longest line, RMS [m], assumed: 1 mm of noise turns it by 1°",
    )
    max_tilt: Positive = Field(5.0, description="of Motive's floor against ours [°], assumed: above is a wrong axis")


class Calibration(Model):
    """A rigid transform from Motive's frame to the world, without scaling.

    `rotation` holds the rows of a rotation matrix; position in the world = rotation · position + translation.
    """

    rotation: tuple[Vector, Vector, Vector] = tuple(map(tuple, Z_UP.tolist()))  # type: ignore[assignment]
    translation: Vector = Field((0.0, 0.0, 0.0), description="[m]")
    residual: NonNegative = Field(0.0, description="root mean square over the markers [m]")
    markers: tuple[str, ...] = Field((), description="names of the markers it was fitted to")

    @model_validator(mode="after")
    def _rotation_is_one(self) -> Self:
        rotation = np.array(self.rotation)
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0.0:
            raise ValueError("rotation is not a rotation matrix")
        return self

    def to_world(self, positions: Array) -> Array:
        """Return positions of Motive's frame in the world [m], both of shape (N, 3)."""
        return np.asarray(positions @ np.array(self.rotation).T + np.array(self.translation))

    def to_motive(self, positions: Array) -> Array:
        """Return positions of the world in Motive's frame [m], both of shape (N, 3)."""
        return np.asarray((positions - np.array(self.translation)) @ np.array(self.rotation))

    def errors(self, measured: Mapping[str, Vector], known: Mapping[str, Vector]) -> dict[str, float]:
        """Return how far each of `markers` is measured from where it is known to be [m]; arguments as of `fit`."""
        places = np.array([measured[name] for name in self.markers], dtype=np.float64)
        distances = self.to_world(places) - np.array([known[name] for name in self.markers])
        return dict(zip(self.markers, np.linalg.norm(distances, axis=1).tolist(), strict=True))

    def to_yaml(self) -> str:
        """Return it as YAML."""
        return dump_yaml(self.model_dump(mode="json"))

    def save(self, path: Path) -> None:
        """Write a YAML file.

        Raises:
            CalibrationError: It cannot be written.
        """
        try:
            write_whole(path, self.to_yaml())
        except OSError as error:
            raise CalibrationError(f"cannot write {path}: {error.strerror}") from None

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote.

        Raises:
            CalibrationError: The file is missing or damaged.
        """
        try:
            return read_model(path, cls, "calibrate first")
        except ConfigError as error:
            raise CalibrationError(f"{path} is not a calibration: {error}; calibrate first") from None


def fit(
    measured: Mapping[str, Vector], known: Mapping[str, Vector], limits: CalibrationLimits | None = None
) -> Calibration:
    """Fit the transform that brings measured markers closest to where they are known to be (Kabsch).

    Args:
        measured: Mean positions by name in Motive's frame [m], see `markers.rest_positions`.
        known: Positions by name in the world [m]; what was not measured is left out.
        limits: What the fit must keep to.

    Raises:
        CalibrationError: There are fewer than three markers, they lie on a line, do not fit, or Motive is not y-up.
    """
    from scipy.spatial.transform import Rotation

    limits = limits or CalibrationLimits()
    names = sorted(measured.keys() & known.keys())
    listed = ", ".join(names) or "none"
    if len(names) < 3:
        raise CalibrationError(f"a calibration needs 3 markers at known places; the cameras see {listed}")
    motive = np.array([measured[name] for name in names], dtype=np.float64)
    world = np.array([known[name] for name in names], dtype=np.float64)
    if not np.isfinite(motive).all() or not np.isfinite(world).all():
        raise CalibrationError(f"a position of the markers {listed} is not a number")
    motive_mean, world_mean = motive.mean(axis=0), world.mean(axis=0)
    for which, centred in (("measured", motive - motive_mean), ("known", world - world_mean)):
        spread = float(np.linalg.svd(centred, compute_uv=False)[1]) / np.sqrt(len(names))
        if spread < limits.min_spread:
            raise CalibrationError(
                f"the {which} places of the markers {listed} lie on a line within {1e3 * spread:.0f} mm, at least "
                f"{1e3 * limits.min_spread:.0f} mm are needed; take markers that span a plane"
            )
    turned = (motive - motive_mean) @ Z_UP.T
    correction = Rotation.align_vectors(world - world_mean, turned)[0].as_matrix()
    tilt = float(np.degrees(np.arccos(np.clip(correction[2, 2], -1.0, 1.0))))
    rotation = correction @ Z_UP
    translation = world_mean - rotation @ motive_mean
    errors = np.linalg.norm(motive @ rotation.T + translation - world, axis=1)
    residual = float(np.sqrt(np.mean(errors**2)))
    worst = int(np.argmax(errors))
    if residual > limits.max_residual or errors[worst] > limits.max_error:
        raise CalibrationError(
            f"{names[worst]} is off by {1e3 * errors[worst]:.1f} mm, at most {1e3 * limits.max_error:.1f} mm are "
            f"allowed, and all markers ({listed}) by {1e3 * residual:.1f} mm (root mean square), at most "
            f"{1e3 * limits.max_residual:.1f} mm. Check the names in Motive, the markers and the pose"
        )
    if tilt > limits.max_tilt:
        raise CalibrationError(
            f"Motive's floor is tilted by {tilt:.0f}° against ours, at most {limits.max_tilt:.0f}° are allowed; set "
            "its up axis to Y in the streaming settings, and its ground plane"
        )
    return Calibration(
        rotation=tuple(map(tuple, rotation.tolist())),
        translation=tuple(translation.tolist()),
        residual=residual,
        markers=tuple(names),
    )
