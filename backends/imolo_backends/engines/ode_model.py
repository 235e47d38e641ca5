"""The robot in ODE: its bodies, hinges and shapes, built from the URDF, for which ODE has no loader."""

import math
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np

from imolo.contracts.engine import Array, Scene
from imolo.contracts.urdf import CollisionShape, Joint, RobotModel
from imolo.errors import BackendError
from imolo_backends.engines.engine_checks import Body, base_rotation, check_value
from imolo_backends.engines.rigid_parts import find_places, merge_fixed

try:
    import ode as ode

    ode.HingeJoint  # noqa: B018 - PyPI has another package of this name
except (ImportError, AttributeError) as error:
    get = shlex.join(["bash", str(Path(__file__).with_name("get_ode")), sys.executable])
    raise ImportError(
        f"{error}; PyPI has no wheel of the Open Dynamics Engine, Debian has one for its own version of Python: {get}"
    ) from error

# pyode's constants from FMax on are those of an older ODE: its ParamStopERP sets the bounce of ODE 0.16.
LOWER_STOP, UPPER_STOP, STOP_BOUNCE, STOP_ERP, STOP_CFM = 0, 1, 7, 9, 10

SLIDING = 1e-6  # [m/s] slower than this, a contact sticks and has no direction of sliding

Pose = tuple[Array, Array]


class OdeRobot:
    """The robot of one world.

    Links that fixed joints hold together are one body, and a fixed base is none, so that neither can give.

    Attributes:
        shapes: By collision shape: the body it moves with, None for what is fixed, and the name of its link.
        hinges: In the order of the scene's joints; sliders among them.
        add_torque: In the same order, what adds a torque [N·m] or force [N] for the next step.
    """

    def __init__(self, world: Any, space: Any, scene: Scene, robot: RobotModel, stop_erp: float) -> None:
        self._world, self._scene = world, scene
        self._model = model = merge_fixed(robot)
        self._places = find_places(robot)
        self._base_pose = base = np.array(scene.base_position), base_rotation(scene)
        self._bodies = {
            name: make_body(world, link.mass, link.inertia)
            for name, link in model.links.items()
            if not (scene.fixed_base and name == model.base)
        }
        # ODE's angles and ways are zero where the joint is made, and stops must lie within half a turn of it.
        zero = {name: sum(model.joints[name].limits or (0.0, 0.0)) / 2.0 for name in scene.joint_names}
        poses = model.link_poses(zero, *base)
        self._place_bodies(poses)
        self.hinges = [self._make_joint(model.joints[name], poses, stop_erp) for name in scene.joint_names]
        self.shapes: dict[Any, tuple[Any, str]] = {}
        for name, link in robot.links.items():
            for collision in link.collisions:
                self._add_shape(space, name, collision)
        self._start()

        self._zero = np.array([zero[name] for name in scene.joint_names])
        kinds = [model.joints[name].kind for name in scene.joint_names]
        sliding = [kind == "prismatic" for kind in kinds]
        moving = list(zip(self.hinges, sliding, strict=True))
        self.add_torque = [joint.addForce if slides else joint.addTorque for joint, slides in moving]
        self._get_angle = [joint.getPosition if slides else joint.getAngle for joint, slides in moving]
        self._get_velocity = [joint.getPositionRate if slides else joint.getAngleRate for joint, slides in moving]
        self._wrapped = [get() for get in self._get_angle]
        self._turning = [i for i, kind in enumerate(kinds) if kind == "continuous"]
        for i in self._turning:
            self._zero[i] += math.tau * round((scene.joint_angle[i] - self._wrapped[i]) / math.tau)

    def count_turns(self) -> None:
        """Follow joints without limits beyond half a turn; to be called after every step."""
        for i in self._turning:
            before, now = self._wrapped[i], self._get_angle[i]()
            if abs(now - before) > math.pi:
                self._zero[i] += math.copysign(math.tau, before - now)
            self._wrapped[i] = now

    def write_motion(self, angle: Array, velocity: Array) -> None:
        """Write joint angles [rad] and velocities [rad/s], each of shape (J,)."""
        angle[:] = [get() for get in self._get_angle]
        angle += self._zero
        velocity[:] = [get() for get in self._get_velocity]

    def base_speed(self) -> tuple[float, ...]:
        """Return linear [m/s] and angular velocity [rad/s] of the base's COM; nothing where the base is fixed."""
        base = self._bodies.get(self._model.base)
        return () if base is None else (*base.getLinearVel(), *base.getAngularVel())

    def link_poses(self) -> tuple[Array, Array, Array]:
        """Return origins [m], shape (L, 3), and rotation matrices, shape (L, 3, 3), and the base's quaternion."""
        poses = {self._model.base: self._base_pose}
        for name, body in self._bodies.items():
            rotation = np.array(body.getRotation()).reshape(3, 3)
            poses[name] = np.array(body.getPosition()) - rotation @ self._model.links[name].com, rotation
        links = []
        for name in self._scene.link_names:
            place = self._places[name]
            position, rotation = poses[place.part]
            links.append((position + rotation @ place.position, rotation @ place.rotation))
        base = self._bodies.get(self._model.base)
        quaternion = self._scene.base_quaternion if base is None else base.getQuaternion()
        positions, rotations = map(np.array, zip(*links, strict=True))
        return positions, rotations, np.array(quaternion)

    def loaded_links(self) -> dict[str, Body]:
        """Return what ODE holds of each rigid part, under the name of its first link; a fixed base is no body."""
        held = {name: body.getMass() for name, body in self._bodies.items()}
        held.setdefault(self._model.base, ode.Mass())
        # The origin of ODE's bodies is their COM.
        return {name: (mass.mass, self._model.links[name].com, np.array(mass.I)) for name, mass in held.items()}

    def loaded_limits(self, stop_erp: float, cfm: float) -> dict[str, tuple[float, float]]:
        """Return the limits [rad or m] of the joints that have any.

        Raises:
            BackendError: A stop bounces, or is not as stiff as asked for.
        """
        limits = {}
        for name, hinge, zero in zip(self._scene.joint_names, self.hinges, self._zero, strict=True):
            if self._model.joints[name].limits is not None:
                limits[name] = hinge.getParam(LOWER_STOP) + zero, hinge.getParam(UPPER_STOP) + zero
                stop = [hinge.getParam(number) for number in (STOP_BOUNCE, STOP_ERP, STOP_CFM)]
                check_value(f"bounce, ERP and CFM of {name}'s stops", stop, (0.0, stop_erp, cfm))
        return limits

    def _start(self) -> None:
        scene, (position, rotation) = self._scene, self._base_pose
        angles = dict(zip(scene.joint_names, scene.joint_angle, strict=True))
        self._place_bodies(self._model.link_poses(angles, position, rotation))
        spin = np.array(scene.base_angular_velocity)
        for body in self._bodies.values():
            arm = np.array(body.getPosition()) - position
            body.setLinearVel((np.array(scene.base_velocity) + np.cross(spin, arm)).tolist())
            body.setAngularVel(spin.tolist())

    def _place_bodies(self, poses: dict[str, Pose]) -> None:
        for name, body in self._bodies.items():
            position, rotation = poses[name]
            body.setPosition((position + rotation @ self._model.links[name].com).tolist())
            body.setRotation(rotation.ravel().tolist())

    def _make_joint(self, joint: Joint, poses: dict[str, Pose], stop_erp: float) -> Any:
        position, rotation = poses[joint.parent]
        slides = joint.kind == "prismatic"
        made = (ode.SliderJoint if slides else ode.HingeJoint)(self._world)
        # In this order the angle has the URDF's sign.
        made.attach(self._bodies[joint.child], self._bodies.get(joint.parent, ode.environment))
        if not slides:
            made.setAnchor((position + rotation @ joint.position).tolist())
        made.setAxis((rotation @ joint.rotation @ joint.axis).tolist())
        if joint.limits is not None:
            half_range = 0.5 * (joint.limits[1] - joint.limits[0])
            if not slides and not half_range < math.pi:
                raise BackendError(f"ODE cannot limit {joint.name} to {joint.limits} rad, a whole turn or more")
            made.setParam(LOWER_STOP, -half_range)
            made.setParam(UPPER_STOP, half_range)
            made.setParam(STOP_ERP, stop_erp)
        return made

    def _add_shape(self, space: Any, name: str, collision: CollisionShape) -> None:
        match collision.kind:
            case "box":
                shape = ode.GeomBox(space, collision.size)
            case "sphere":
                shape = ode.GeomSphere(space, *collision.size)
            case "cylinder":
                shape = ode.GeomCylinder(space, *collision.size)
            case "mesh":
                raise BackendError(
                    f"ODE has no convex shapes, but {name} has a mesh; give it boxes, spheres or cylinders"
                )
        place = self._places[name]
        body = self._bodies.get(place.part)
        position = place.position + place.rotation @ collision.position
        rotation = place.rotation @ collision.rotation
        if body is None:
            base_position, base_turn = self._base_pose
            shape.setPosition((base_position + base_turn @ position).tolist())
            shape.setRotation((base_turn @ rotation).ravel().tolist())
        else:
            shape.setBody(body)
            shape.setOffsetPosition((position - self._model.links[place.part].com).tolist())
            shape.setOffsetRotation(rotation.ravel().tolist())
        self.shapes[shape] = body, name


def make_body(world: Any, mass: float, inertia: Array) -> Any:
    """Return a body of this mass [kg] and inertia [kg m²], whose frame has its origin at the COM, as ODE wants it."""
    body, made = ode.Body(world), ode.Mass()
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tolist()
    made.setParameters(mass, 0.0, 0.0, 0.0, xx, yy, zz, xy, xz, yz)
    body.setMass(made)
    return body


def sliding(first: Any, second: Any, position: Any, normal: Any, fall: Any) -> tuple[Any, float]:
    """Return the unit vector along which one body slides on the other, either way round, and the speed [m/s].

    The vector is None where nothing slides.

    Args:
        first: A body; one of the two may be None, which is fixed.
        second: The other one.
        position: Contact point [m].
        normal: Of the contact.
        fall: Velocity that gravity adds in a step [m/s]; with it a body that rests on a ramp has a direction as well.
    """
    if first is None:
        first, second = second, None
    x, y, z = first.getPointVel(position)
    vx, vy, vz = fall if second is None else second.getPointVel(position)
    sign = 1.0 if second is None else -1.0
    x, y, z = x + sign * vx, y + sign * vy, z + sign * vz
    nx, ny, nz = normal
    closing = x * nx + y * ny + z * nz
    x, y, z = x - closing * nx, y - closing * ny, z - closing * nz
    speed = math.sqrt(x * x + y * y + z * z)
    return ((x / speed, y / speed, z / speed) if speed > SLIDING else None), speed
