"""Joint angles from what the cameras see of a robot: least squares of the poses of its links."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imolo.contracts.robot import Body

Array = NDArray[np.float64]

BASE = 6  # position and rotation vector of the base link, before the joint angles


class MarkerFit:
    """Finds the pose of a body whose markers are nearest to the ones seen."""

    def __init__(self, body: Body) -> None:
        """Take markers and joints of a body."""
        self._body = body
        self._model = body.model
        self._markers = {marker.marker_id: marker for marker in body.markers}
        moved_by = {joint.child: joint for joint in self._model.joints.values()}
        self._above: dict[str, list[int]] = {}
        for marker in body.markers:
            link, above = marker.link, []
            while link in moved_by:
                joint = moved_by[link]
                if joint.name in body.joint_names:
                    above.append(body.joint_names.index(joint.name))
                link = joint.parent
            self._above[marker.link] = above
        position, (w, x, y, z) = body.base(np.array(body.ready)) if callable(body.base) else body.base
        rotation = Rotation.from_quat([x, y, z, w]).as_rotvec()
        self._ready = np.concatenate((position, rotation, body.ready))
        self._low, self._high = body.joint_limits.T

    def joint_angles(self, frames: list[Mapping[int, Array]]) -> Array:
        """Return the joint angles of frames that follow each other, within the joints' limits.

        What the markers of a frame leave open stays as it was.

        Args:
            frames: Of each: position of the markers seen, by label [m], shape (3,).

        Returns:
            [rad], shape (F, J).
        """
        pose = self._ready
        angles = []
        for seen in frames:
            labels = [label for label in seen if label in self._markers]
            if labels:
                pose = self._fit(labels, np.array([seen[label] for label in labels]), pose)
            angles.append(np.clip(pose[BASE:], self._low, self._high))
        return np.array(angles).reshape(len(frames), len(self._body.joint_names))

    def _fit(self, labels: list[int], seen: Array, start: Array) -> Array:
        free = slice(BASE if self._body.fixed_base else 0, None)
        weak = 1e-4  # [m per m or rad] holds what no marker shows where it was

        def full(free_part: Array) -> Array:
            pose = start.copy()
            pose[free] = free_part
            return pose

        def off(part: Array) -> Array:
            return np.concatenate(((self._places(labels, full(part))[0] - seen).ravel(), weak * (part - start[free])))

        def slopes(part: Array) -> Array:
            slope = self._places(labels, full(part))[1][:, free]
            return np.concatenate((slope, weak * np.eye(slope.shape[1])))

        found = least_squares(off, start[free], slopes, method="lm", xtol=1e-8, ftol=1e-8)
        return full(found.x)

    def _places(self, labels: list[int], pose: Array) -> tuple[Array, Array]:
        """Return where markers are [m], shape (M, 3), and how that changes with the pose, shape (3 M, 6 + J)."""
        body = self._body
        turn = Rotation.from_rotvec(pose[3:BASE])
        joint_angle = dict(zip(body.joint_names, pose[BASE:].tolist(), strict=True))
        poses = self._model.link_poses(joint_angle, pose[:3], turn.as_matrix())
        axes = []
        for name in body.joint_names:
            joint = self._model.joints[name]
            origin, rotation = poses[joint.parent]
            axes.append((origin + rotation @ joint.position, rotation @ joint.rotation @ joint.axis, joint.kind))
        turning = _left_jacobian(pose[3:BASE])
        places, slope = np.zeros((len(labels), 3)), np.zeros((len(labels), 3, len(pose)))
        for row, label in enumerate(labels):
            marker = self._markers[label]
            origin, rotation = poses[marker.link]
            places[row] = origin + rotation @ np.array(marker.offset)
            slope[row, :, :3] = np.eye(3)
            slope[row, :, 3:BASE] = -_cross(places[row] - pose[:3]) @ turning
            for joint_index in self._above[marker.link]:
                center, axis, kind = axes[joint_index]
                way = axis if kind == "prismatic" else np.cross(axis, places[row] - center)
                slope[row, :, BASE + joint_index] = way
        return places, slope.reshape(3 * len(labels), len(pose))


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _left_jacobian(vector: Array) -> Array:
    """Return what turns a change of a rotation vector into the turn that follows it, shape (3, 3)."""
    angle = float(np.linalg.norm(vector))
    k = _cross(vector)
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * k)
    return np.asarray(np.eye(3) + (1 - np.cos(angle)) / angle**2 * k + (angle - np.sin(angle)) / angle**3 * k @ k)
