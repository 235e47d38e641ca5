"""The checks of a robot in one simulated backend: `imolo check --robot NAME`.

They run short trials and look at what passes on the bus, so that they hold for every backend, and name what is wrong
with a body, its actuators or its motion before anything is learned.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imolo.campaigns.motion_recorder import without_chance
from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import body_of, config_for
from imolo.conformance.check import Check, Measurement, Outcome, run_check
from imolo.conformance.suite import Suite
from imolo.contracts.actuators import Channel
from imolo.contracts.planner import Controller
from imolo.contracts.robot import Body
from imolo.contracts.trial import Trial, TrialKind
from imolo.errors import ConfigError, MessageError
from imolo.messaging import channels
from imolo.messaging.log import Log, read_log
from imolo.method.motion import Theta
from imolo.trials.trainer import ONSET_DELAY, MotionPlayer
from imolo.trials.trial import Bystander, run_trial

Array = NDArray[np.float64]

REST = 0.6  # [s] that a robot is left alone
SETTLED = 0.5  # [s] after which it stands still
STILL_SPEED = 0.05  # [rad/s, m/s] of a joint that stands still: what friction smoothing and solvers leave
STILL_WAY = 1e-3  # [m] of an effector in the last tenth of a second
HELD = 5.0  # [s] of actuators whose joints are held: until pressures have settled
ASYMMETRY = 0.02  # [-] what iterative solvers leave of their order of the two sides, over the way of the hand


@dataclass(frozen=True)
class RobotSuite(Suite):
    """The checks of one robot in one backend.

    Attributes:
        robot: Name of the robot.
    """

    robot: str = ""

    @cached_property
    def config(self) -> ExperimentConfig:
        """The robot's defaults on the backend, nothing left to chance."""
        return without_chance(config_for(self.backend, robot={"name": self.robot}))

    @cached_property
    def checks(self) -> dict[str, Check]:
        """The checks by name, in the order of the report."""
        probe = _Probe(self.config)
        mirrored = bool(probe.body.mirrored_joints)
        found = [
            Check("masses", "body", "Every part has a mass and an inertia that a body can have", probe.masses),
            Check("ranges", "body", "Poses and targets lie within the ranges of joints and channels", probe.ranges),
            Check("markers", "body", "Cameras see the markers where the model has them", probe.markers),
            Check("ready_pose", "body", "The robot stands still in its ready pose", probe.ready_pose),
            *((Check("mirror", "body", "Mirrored motions are mirror images", probe.mirror),) if mirrored else ()),
            Check("actuators", "actuators", "Held joints settle to the torque in closed form", probe.actuators),
            Check("motion", "motion", "Every corner of the table's grid is a motion", probe.motion),
        ]
        found += self.config.simulation.actuators.checks(probe.body.joint_limits)
        return {check.name: check for check in found}

    def run(self, name: str) -> list[Outcome]:
        """Run one check in this process and judge what it measured."""
        return run_check(self.checks[name], ())

    def misplaced(self) -> list[Outcome]:
        """A robot declares no limitations."""
        return []


def robot_suites(robot: str, backends: Sequence[str]) -> list[Suite]:
    """Return the checks of a robot in each of some backends."""
    return [RobotSuite(f"{robot} in {backend}", backend, {}, robot) for backend in backends]


class _Probe:
    """Measures one robot."""

    def __init__(self, config: ExperimentConfig) -> None:
        self.config = config
        self.body: Body = body_of(config.robot)

    def masses(self) -> Iterator[Measurement]:
        """Compare the moments of inertia with what a rigid body can have."""
        model = self.body.model
        # A frame that a link carries needs no mass of its own, and neither does a base that stands on the world.
        parts = sorted(set(model.parts.values()) - ({model.parts[model.base]} if self.body.fixed_base else set()))
        lightest = min(parts, key=model.part_mass)
        light = sum(model.part_mass(part) <= 0.0 for part in parts)
        yield Measurement(f"parts without mass (the lightest is {lightest})", "", 0.0, light, 0.0, "bodies have mass")
        # The largest principal moment is at most the sum of the others.
        impossible = [link.name for link in model.links.values() if link.mass and not _possible(link.inertia)]
        what = f"links with an impossible inertia ({', '.join(impossible) or 'none'})"
        yield Measurement(what, "", 0.0, len(impossible), 0.0, "triangle inequality of principal moments")

    def ranges(self) -> Iterator[Measurement]:
        """Compare ready pose and resting targets with their ranges, and see that effectors can touch."""
        low, high = self.body.joint_limits.T
        ready = np.array(self.body.ready)
        beyond = np.maximum(np.maximum(low - ready, ready - high), 0.0)
        joint = self.body.joints[int(beyond.argmax())]
        what = f"ready pose beyond the farthest joint's limit ({joint.name})"
        yield Measurement(what, joint.unit, 0.0, float(beyond.max()), 1e-9, "rounding")
        wrong = [c.name for c in self._channels if not (c.low <= c.rest <= c.high and c.low <= c.released <= c.high)]
        model = self.body.model
        bare = [one.name for one in self.body.effectors if not model.links[one.link].collisions]
        what = f"effectors whose link has no collision shape to touch with ({', '.join(bare) or 'none'})"
        yield Measurement(what, "", 0.0, len(bare), 0.0, "a ball touches shapes")
        what = f"channels whose rest or release is out of range ({', '.join(wrong) or 'none'})"
        yield Measurement(what, "", 0.0, len(wrong), 0.0, "`Channel`")

    def markers(self) -> Iterator[Measurement]:
        """Compare the first frame with the kinematics of the URDF."""
        log = self._trial(Bystander(), 0.05)
        frame = log.messages[channels.MOCAP][0]
        seen = {marker.marker_id: np.array(marker.marker_position) for marker in frame.markers}
        places = self.body.ready_markers()
        away = [
            float(np.linalg.norm(seen[marker.marker_id] - places[marker.name])) if marker.marker_id in seen else np.nan
            for marker in self.body.markers
        ]
        # Within the first frame the robot falls by half g t², and no farther.
        fall = 0.5 * 9.81 * (frame.utime * 1e-6) ** 2
        worst = self.body.markers[int(np.argmax(away))].name
        yield Measurement(f"farthest marker ({worst})", "m", 0.0, float(np.max(away)), 1e-3 + 10.0 * fall, "½ g t²")

    def ready_pose(self) -> Iterator[Measurement]:
        """Leave the robot alone and see whether it stands still."""
        truth = self._trial(Bystander(), REST).messages[channels.TRUTH_ROBOT]
        late = [message for message in truth if message.utime >= SETTLED * 1e6]
        speeds = np.abs([message.joint_velocity for message in late])
        joint = self.body.joints[int(speeds.max(axis=0).argmax())]
        basis = "at rest; what solvers and smoothed friction leave"
        yield Measurement(
            f"fastest joint ({joint.name})", f"{joint.unit}/s", 0.0, float(speeds.max()), STILL_SPEED, basis
        )
        hands = np.array([message.effector_position for message in late])
        way = float(np.linalg.norm(hands - hands[0], axis=-1).max())
        yield Measurement("way of the farthest effector in 0.1 s", "m", 0.0, way, STILL_WAY, basis)

    def actuators(self) -> Iterator[Measurement]:
        """Hold the joints and let the actuators settle under two sets of targets."""
        settings, ready = self.config.simulation.actuators, np.array(self.body.ready)
        timestep = self.config.simulation.timestep
        for name, target in self._targets():
            acting = settings.create(self.body.joint_limits, ready, timestep)
            acting.target[:] = target
            still = np.zeros(len(ready))
            for _ in range(round(HELD / timestep)):
                acting.step(ready, still)
            expected = settings.settled_torque(target, ready)
            off = acting.joint_torque - expected
            worst = int(np.abs(off).argmax())
            joint = self.body.joints[worst]
            what = f"{'torque' if joint.unit == 'rad' else 'force'} of {joint.name} under {name}"
            scale = float(np.abs(expected).max())
            yield Measurement(
                what,
                joint.effort_unit,
                float(expected[worst]),
                float(acting.joint_torque[worst]),
                0.01 * scale + 1e-3,
                "1 %, settled",
            )

    def motion(self) -> Iterator[Measurement]:
        """Make U of the corners of every method's grid."""
        for name, method in self.config.methods.items():
            corners = list(product(*zip(*method.grid.bounds(self.config.motion), strict=True)))
            refused = [error for corner in corners if (error := self._refusal(corner))]
            what = f"corners of the grid of {name!r} that are no motion ({refused[0] if refused else 'none'})"
            yield Measurement(what, "", 0.0, len(refused), 0.0, "`MotionTemplate.commands`, `Channel`")

    def mirror(self) -> Iterator[Measurement]:
        """Compare the effectors of a motion and of its mirror image."""
        joints, model = list(self.body.joint_names), self.body.model
        for name, other in self.body.mirrored_joints.items():
            if (
                name in joints
                and model.links[model.joints[name].child].mass != model.links[model.joints[other].child].mass
            ):
                yield Measurement(f"mass beyond {name} and {other}", "kg", 0.0, np.nan, 0.0, "mirror images")
        sign = self.config.motion.mirror
        if sign is None or len(self.body.effectors) < 2:
            return
        theta = self.config.training.motions[0]
        mirrored = tuple((np.array(theta) * sign).tolist())
        one, mirror = (self._hands(motion) for motion in (theta, mirrored))
        image = mirror[:, ::-1] * [1.0, -1.0, 1.0]
        way = float(np.linalg.norm(np.ptp(one[:, 0], axis=0)))
        apart = float(np.linalg.norm(one - image, axis=-1).max()) / way
        yield Measurement(
            "effectors from the mirror image, over their way", "", 0.0, apart, ASYMMETRY, "iterative solvers"
        )

    @property
    def _channels(self) -> tuple[Channel, ...]:
        return self.config.simulation.actuators.channels

    def _targets(self) -> list[tuple[str, Array]]:
        rest = np.array([channel.rest for channel in self._channels])
        first = self.config.motion.commands(self.config.training.motions[0], 0).targets[-1]
        return [("the resting targets", rest), ("the last phase of the first motion", np.array(first))]

    def _refusal(self, theta: Theta) -> str:
        try:
            commands = self.config.motion.commands(theta, 0)
            type(commands).from_message(commands.to_message(0, 0), self._channels)
        except (ConfigError, MessageError) as error:
            return str(error)
        return ""

    def _hands(self, theta: Theta) -> Array:
        end = self.config.motion.swing_of(theta) + self.config.training.sampled_to
        log = self._trial(MotionPlayer(self.config.motion, theta), ONSET_DELAY + end)
        truth = [m for m in log.messages[channels.TRUTH_ROBOT] if m.utime > ONSET_DELAY * 1e6]
        return np.array([message.effector_position for message in truth])

    def _trial(self, controller: Controller, duration: float) -> Log:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "check.lcmlog"
            run_trial(self.config, Trial(TrialKind.TRAINING, 0, self.config.seed), controller, path, duration)
            return read_log(path)


def _possible(inertia: Array) -> bool:
    moments = np.linalg.eigvalsh(inertia)
    return bool(moments[0] > 0.0 and moments[2] <= (moments[0] + moments[1]) * (1.0 + 1e-6))
