"""What a robot is: a body, its actuators, and the defaults of an experiment with it.

World frame: x forward, y left, z up, floor at z = 0.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from imolo.contracts.engine import Ball, BoxShape, Scene
from imolo.contracts.urdf import Joint, RobotModel, read_urdf
from imolo.errors import BackendError, did_you_mean

if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig, RobotConfig

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
Pose = tuple[Vector, tuple[float, float, float, float]]
"""Origin of the base link [m] and its rotation as a quaternion w, x, y, z."""

GIVE = 1e-9  # [rad, m] a ready pose may lie at a limit, but for rounding


@dataclass(frozen=True)
class Marker:
    """A mocap marker: its label, name, the link it is glued to, and its offset in that link's frame [m]."""

    marker_id: int
    name: str
    link: str
    offset: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Effector:
    """A part that is to meet the ball: a hand, a racket, a gripper.

    Attributes:
        name: Of the marker in its middle.
        link: That touches the ball.
        width: Short side of what meets the ball [m].
        limb: Marker where the limb begins that ends in it, such as the shoulder's: what counts as touching for cameras.
        limb_length: From there to its far end [m].
        normal: Direction its face looks in, in the frame of the link; None where every side will do.
    """

    name: str
    link: str
    width: float
    limb: str | None = None
    limb_length: float = 0.0
    normal: Vector | None = None


@dataclass(frozen=True)
class Foot:
    """A link that stands, and how high its frame is above the ground then [m]."""

    link: str
    height: float


@dataclass(frozen=True, eq=False)
class Body:
    """The rigid parts of a robot and how they are placed at the start of a trial.

    Attributes:
        name: Of the robot.
        urdf: Its model.
        markers: What the cameras see of it.
        effectors: What is to meet the ball; the first one is the one that learns.
        base: Pose of the base link, or what returns it for the joint angles [rad], shape (J,), of a trial.
        joint_names: Movable joints in the order of all arrays; that of the URDF if not given.
        link_names: Links in the order of all arrays, the base first; that of the URDF if not given.
        ready: Joint angles of the ready pose [rad], shape (J,); zeros if not given.
        fixed_base: Whether the base link is welded to the world.
        feet: Links that stand; none on a fixed base.
        boxes: Fixed boxes beside the floor.
        mirrored_joints: The joint of the other side for each joint, by name, where the robot is mirror-symmetric about
            the plane y = 0.
    """

    name: str
    urdf: Path
    markers: tuple[Marker, ...]
    effectors: tuple[Effector, ...]
    base: Pose | Callable[[Array], Pose] = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    joint_names: tuple[str, ...] = ()
    link_names: tuple[str, ...] = ()
    ready: tuple[float, ...] = ()
    fixed_base: bool = False
    feet: tuple[Foot, ...] = ()
    boxes: tuple[BoxShape, ...] = ()
    mirrored_joints: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fill in what the URDF says.

        Raises:
            BackendError: A name is not in the URDF, or the ready pose does not fit.
        """
        model = self.model
        movable = tuple(joint.name for joint in model.joints.values() if joint.kind != "fixed")
        links = (model.base, *(name for name in model.links if name != model.base))
        object.__setattr__(self, "joint_names", self.joint_names or movable)
        object.__setattr__(self, "link_names", self.link_names or links)
        object.__setattr__(self, "ready", tuple(self.ready) or (0.0,) * len(self.joint_names))
        for name in self.joint_names:
            self._check_name("joint", name, movable)
        for name in (*self.mirrored_joints, *self.mirrored_joints.values()):
            self._check_name("mirrored joint", name, self.joint_names)
        used = [(f"marker {marker.name!r}", marker.link) for marker in self.markers]
        used += [(f"effector {effector.name!r}", effector.link) for effector in self.effectors]
        used += [("foot", foot.link) for foot in self.feet]
        for what, link in used:
            self._check_name(f"link of {what},", link, model.links)
        names = [marker.name for marker in self.markers]
        for effector in self.effectors:
            for name in (effector.name, *((effector.limb,) if effector.limb else ())):
                self._check_name("marker of an effector,", name, names)
        for name in names:
            if names.count(name) > 1:
                raise BackendError(f"robot {self.name!r}: two markers are named {name!r}; give each a name of its own")
        if not self.effectors:
            raise BackendError(f"robot {self.name!r} has no effector; name the link that is to meet the ball")
        ids = [marker.marker_id for marker in self.markers]
        for number in ids:
            if number < 0 or ids.count(number) > 1:
                raise BackendError(f"robot {self.name!r}: marker id {number} is negative or used twice; number from 0")
        if len(self.ready) != len(self.joint_names):
            raise BackendError(
                f"robot {self.name!r}: the ready pose has {len(self.ready)} angles for {len(self.joint_names)} joints "
                f"({', '.join(self.joint_names)})"
            )

    def _check_name(self, what: str, name: str, known: "Sequence[str] | Mapping[str, Any]") -> None:
        if name not in known:
            raise BackendError(
                f"robot {self.name!r}: {what} {name!r} is not in {self.urdf.name}{did_you_mean(name, list(known))}; "
                f"known: {', '.join(known)}"
            )

    @cached_property
    def model(self) -> RobotModel:
        """What the URDF says."""
        return read_urdf(self.urdf)

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The movable joints in the order of all arrays."""
        return tuple(self.model.joints[name] for name in self.joint_names)

    @cached_property
    def joint_limits(self) -> Array:
        """Lowest and highest position of each joint [rad or m], shape (J, 2); infinite where it turns without end."""
        limits = [joint.limits or (-np.inf, np.inf) for joint in self.joints]
        array = np.array(limits, dtype=np.float64).reshape(-1, 2)
        array.flags.writeable = False
        return array

    @property
    def learning_marker(self) -> int:
        """Label of the marker in the middle of the first effector."""
        return self.effector_marker(0)

    def effector_marker(self, index: int) -> int:
        """Return the label of the marker in the middle of an effector."""
        return self.marker_id(self.effectors[index].name)

    def marker_id(self, name: str) -> int:
        """Return the label of a marker."""
        return next(marker.marker_id for marker in self.markers if marker.name == name)

    @property
    def standing_markers(self) -> dict[int, float]:
        """Labels of the markers at the origins of the feet's frames, and how high each is when its foot stands [m]."""
        heights = {foot.link: foot.height for foot in self.feet}
        return {
            marker.marker_id: heights[marker.link]
            for marker in self.markers
            if marker.link in heights and not any(marker.offset)
        }

    def link_of(self, marker: Marker) -> int:
        """Return the index of the link a marker is on."""
        return self.link_names.index(marker.link)

    def scene(
        self,
        ball: Ball,
        timestep: float,
        friction: float,
        restitution: float,
        joint_offset: Array | Sequence[float] | None = None,
        robot_restitution: float = 0.0,
    ) -> Scene:
        """Return the scene of a trial: the robot in its ready pose, the ball, the boxes.

        Args:
            ball: The ball.
            timestep: Length of one step [s].
            friction: Coulomb friction coefficient of every contact [-].
            restitution: Coefficient of restitution of the ball's contacts [-].
            joint_offset: Added to the ready joint angles [rad], shape (J,).
            robot_restitution: Coefficient of restitution of the robot's own contacts [-].

        Raises:
            BackendError: An offset pushes a joint out of its range.
        """
        offset = np.zeros(len(self.joint_names)) if joint_offset is None else np.asarray(joint_offset, dtype=np.float64)
        if offset.shape != (len(self.joint_names),):
            raise BackendError(f"joint_offset has shape {offset.shape}; expected ({len(self.joint_names)},)")
        angle = np.array(self.ready) + offset
        for joint, value, (low, high) in zip(self.joints, angle.tolist(), self.joint_limits.tolist(), strict=True):
            if not low - GIVE <= value <= high + GIVE:
                raise BackendError(
                    f"{joint.name} cannot start at {_shown(joint, value)}; its range is {_shown(joint, low)} to "
                    f"{_shown(joint, high)}; a pose at the end of the range is offset inwards"
                )
        position, quaternion = self.base(angle) if callable(self.base) else self.base
        return Scene(
            urdf=self.urdf,
            joint_names=self.joint_names,
            link_names=self.link_names,
            base_position=position,
            base_quaternion=quaternion,
            joint_angle=tuple(angle.tolist()),
            ball=ball,
            boxes=self.boxes,
            timestep=timestep,
            friction=friction,
            restitution=restitution,
            robot_restitution=robot_restitution,
            fixed_base=self.fixed_base,
        )

    def ready_markers(self) -> dict[str, Vector]:
        """Return where the markers are in the ready pose, by name, in the world [m]."""
        from scipy.spatial.transform import Rotation

        position, (w, x, y, z) = self.base(np.array(self.ready)) if callable(self.base) else self.base
        poses = self.model.link_poses(
            dict(zip(self.joint_names, self.ready, strict=True)),
            np.array(position),
            Rotation.from_quat([x, y, z, w]).as_matrix(),
        )
        places: dict[str, Vector] = {}
        for marker in self.markers:
            origin, rotation = poses[marker.link]
            px, py, pz = (origin + rotation @ np.array(marker.offset)).tolist()
            places[marker.name] = (px, py, pz)
        return places


@dataclass(frozen=True)
class Published:
    """What somebody published of the robot itself, to stand beside the simulations; texts as they are shown.

    Attributes:
        method: That was used.
        successes: Such as "16/20".
        rate: Share of successes [-].
        interval: Wilson 95 % interval of it [%], such as "58-92".
        hand_error: Mean ± standard deviation [mm].
        ball_errors: The same, by lead time [s] with two digits.
        source: Where it stands.
    """

    method: str
    successes: str
    rate: float
    interval: str
    hand_error: str
    ball_errors: Mapping[str, str]
    source: str


@dataclass(frozen=True)
class Robot:
    """What an entry point of the group `imolo.robots` names; its public name is that of the entry point.

    Attributes:
        summary: One line for `imolo robots`.
        config: What an experiment with it may say: `ExperimentConfig` with the robot's own kinds of motion, actuators
            and disturbance.
        defaults: What a config that names the robot need not say; a YAML file beside the robot, or its content.
        body: Makes the body under the options of a config's `robot` section.
        ingredients: What of it can be exchanged, for `imolo attribute`: by ingredient, the alternative settings, each a
            part of a config.
        published: What is known of the robot itself.
    """

    summary: str
    config: "type[ExperimentConfig]"
    defaults: Path | Mapping[str, Any]
    body: "Callable[[RobotConfig], Body]"
    ingredients: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    published: tuple[Published, ...] = ()


def _shown(joint: Joint, position: float) -> str:
    return f"{np.degrees(position):.3f}°" if joint.unit == "rad" else f"{position:.4f} m"
