"""Independent truth: mechanisms from their URDF, and equations of motion solved to rounding."""

from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from imolo.contracts.engine import Array, EngineState, Scene
from imolo.contracts.urdf import Link, read_urdf
from imolo_backends.conformance.bodies import GRAVITY, ROD_INERTIA, ROD_LENGTH, ROD_MASS

DERIVATIVE = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0  # of five equidistant values, in the middle; fourth order


class Mechanism:
    """A scene's robot as a floating tree of links, from nothing but its URDF.

    Generalised velocities are the base origin's velocity and the base's angular velocity, both in world axes, and the
    joint velocities in the order of the scene: shape (6 + J,).
    """

    def __init__(self, scene: Scene) -> None:
        self._model = read_urdf(scene.urdf)
        self._joint_names = scene.joint_names
        self._link_names = scene.link_names
        self.mass = self._model.mass

    def poses(self, state: EngineState) -> tuple[Array, Array]:
        """Return where joint angles and base put the link frames: (L, 3) [m] and rotations (L, 3, 3)."""
        poses = self._poses(state.joint_angle, state.link_position[0], rotation_of(state))
        return np.array([poses[n][0] for n in self._link_names]), np.array([poses[n][1] for n in self._link_names])

    def center_of_mass(self, state: EngineState) -> Array:
        """Return the COM of all links [m], shape (3,)."""
        poses = self._poses(state.joint_angle, state.link_position[0], rotation_of(state))
        weighted = [link.mass * (poses[n][0] + poses[n][1] @ link.com) for n, link in self._model.links.items()]
        center: Array = np.sum(weighted, axis=0) / self.mass
        return center

    def mass_matrix(self, joint_angle: Array, base_rotation: Array) -> Array:
        """Return the mass matrix at these joint angles [rad], shape (6 + J, 6 + J)."""
        matrix = np.zeros((6 + len(self._joint_names),) * 2)
        for link, rotation, _, linear, angular in self._links(joint_angle, np.zeros(3), base_rotation):
            matrix += link.mass * linear.T @ linear + angular.T @ rotation @ link.inertia @ rotation.T @ angular
        return matrix

    def angular_momentum(self, window: Sequence[EngineState]) -> Array:
        """Return the angular momentum about the COM [kg m²/s], shape (3,), in the middle of five states."""
        now = window[2]
        joint_velocity = _derivative(window, [state.joint_angle for state in window])
        velocity = np.concatenate([*base_twist(window), joint_velocity])
        momentum, linear_momentum = np.zeros(3), np.zeros(3)
        for link, rotation, com, linear, angular in self._links(
            now.joint_angle, now.link_position[0], rotation_of(now)
        ):
            push = link.mass * linear @ velocity
            momentum += np.cross(com, push) + rotation @ link.inertia @ rotation.T @ angular @ velocity
            linear_momentum += push
        about_com: Array = momentum - np.cross(self.center_of_mass(now), linear_momentum)
        return about_com

    def _poses(self, joint_angle: Array, position: Array, rotation: Array) -> dict[str, tuple[Array, Array]]:
        angles = dict(zip(self._joint_names, joint_angle.tolist(), strict=True))
        return self._model.link_poses(angles, position, rotation)

    def _links(
        self, joint_angle: Array, base_position: Array, base_rotation: Array
    ) -> list[tuple[Link, Array, Array, Array, Array]]:
        """Return each link with its rotation, COM, and the Jacobians of its COM and of its rotation, (3, 6 + J)."""
        poses = self._poses(joint_angle, base_position, base_rotation)
        joint_of = {joint.child: joint for joint in self._model.joints.values()}
        links = []
        for name, link in self._model.links.items():
            position, rotation = poses[name]
            com = position + rotation @ link.com
            linear, angular = np.zeros((2, 3, 6 + len(self._joint_names)))
            linear[:, :3] = angular[:, 3:6] = np.eye(3)
            linear[:, 3:6] = np.cross(com - base_position, np.eye(3))
            while name in joint_of:
                joint = joint_of[name]
                if joint.name in self._joint_names:
                    column = 6 + self._joint_names.index(joint.name)
                    origin, turned = poses[name]
                    angular[:, column] = turned @ joint.axis
                    linear[:, column] = np.cross(angular[:, column], com - origin)
                name = joint.parent
            links.append((link, rotation, com, linear, angular))
        return links


def rotation_of(state: EngineState) -> Array:
    """Return the rotation matrix of the base, shape (3, 3), from its quaternion."""
    matrix: Array = Rotation.from_quat(state.base_quaternion, scalar_first=True).as_matrix()
    return matrix


def base_twist(window: Sequence[EngineState]) -> tuple[Array, Array]:
    """Return velocity [m/s] and angular velocity [rad/s] of the base, world axes, in the middle of five states."""
    middle = rotation_of(window[2])
    turns = [rotation_vector(rotation_of(state) @ middle.T) for state in window]
    return _derivative(window, [state.link_position[0] for state in window]), _derivative(window, turns)


def _derivative(window: Sequence[EngineState], values: Sequence[Array]) -> Array:
    step = (window[-1].time - window[0].time) / 4.0
    rate: Array = np.tensordot(DERIVATIVE, np.array(values), 1) / step
    return rate


def rotation_vector(rotation: Array) -> Array:
    """Return axis times angle [rad], shape (3,), of a rotation matrix."""
    vector: Array = Rotation.from_matrix(rotation).as_rotvec()
    return vector


def tumbling_rotation(inertia: Array, spin: Array, duration: float) -> Array:
    """Return how a free body is turned, shape (3, 3), after a duration [s] (Euler's equations).

    Args:
        inertia: Principal moments [kg m²], shape (3,), along the body axes, which are the world's at the start.
        spin: Angular velocity at the start [rad/s], shape (3,).
        duration: [s].
    """

    def rates(_: float, state: Array) -> Array:
        omega, turn = state[:3], state[3:].reshape(3, 3)
        return np.concatenate([np.cross(inertia * omega, omega) / inertia, np.cross(turn, omega).ravel()])

    start = np.concatenate([spin, np.eye(3).ravel()])
    rotation: Array = _solve(rates, start, duration)[3:].reshape(3, 3)
    return rotation


def double_pendulum_angles(angles: tuple[float, float], duration: float) -> Array:
    """Return both joint angles [rad] of two hanging rods some time [s] after they were let go at rest.

    Lagrange's equations in the angles of the rods to the vertical.
    """
    mgl = ROD_MASS * GRAVITY * ROD_LENGTH
    far = ROD_MASS * ROD_LENGTH**2
    about_end = ROD_INERTIA + 0.25 * far

    def rates(_: float, state: Array) -> Array:
        first, second, first_rate, second_rate = state
        cosine, sine = np.cos(first - second), np.sin(first - second)
        mass = [[about_end + far, 0.5 * far * cosine], [0.5 * far * cosine, about_end]]
        force = [
            -0.5 * far * sine * second_rate**2 - 1.5 * mgl * np.sin(first),
            0.5 * far * sine * first_rate**2 - 0.5 * mgl * np.sin(second),
        ]
        return np.concatenate([state[2:], np.linalg.solve(mass, force)])

    first, second = _solve(rates, np.array([angles[0], sum(angles), 0.0, 0.0]), duration)[:2]
    return np.array([first, second - first])


def _solve(rates: object, start: Array, duration: float) -> Array:
    solution = solve_ivp(rates, (0.0, duration), start, method="DOP853", rtol=1e-12, atol=1e-12)
    end: Array = solution.y[:, -1]
    return end
