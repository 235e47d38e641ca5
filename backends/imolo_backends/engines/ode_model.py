"""The robot in ODE: its bodies, hinges and shapes, built from the URDF, for which ODE has no loader."""

import math
from typing import Any

import numpy as np

from imolo.contracts.engine import Array, Ball, Scene
from imolo.contracts.urdf import CollisionShape, Joint, RobotModel
from imolo.errors import BackendError
from imolo_backends.engines.engine_checks import Body, base_rotation, check_value
from imolo_backends.engines.ode_c import body_id, joint_id, view
from imolo_backends.engines.ode_library import ode
from imolo_backends.engines.rigid_parts import find_places, merge_fixed

# pyode's constants from FMax on are those of an older ODE: its ParamStopERP sets the bounce of ODE 0.16.
LOWER_STOP, UPPER_STOP, STOP_BOUNCE, STOP_ERP, STOP_CFM = 0, 1, 7, 9, 10

Pose = tuple[Array, Array]


class OdeRobot:
    """The robot of one world.

    Links that fixed joints hold together are one body, and a fixed base is none, so that neither can give.

    Attributes:
        shapes: By collision shape the name of its link.
        hinges: In the order of the scene's joints; sliders among them.
        joints: The same for `ode_step.read_joints`.
        offset: The same.
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
        self.shapes: dict[Any, str] = {}
        for name, link in robot.links.items():
            for collision in link.collisions:
                self._add_shape(space, name, collision)
        self._start()

        order, places = list(self._bodies), [self._places[name] for name in scene.link_names]
        self._part = [order.index(place.part) if place.part in order else -1 for place in places]
        self._offset = np.array([place.position for place in places])[:, :, None]
        self._turn = np.array([place.rotation for place in places])
        self._com = np.array([model.links[name].com for name in order]).reshape(-1, 3, 1)
        kinds = [model.joints[name].kind for name in scene.joint_names]
        self.joints = np.array(
            [
                (joint_id(body_id(self._bodies[model.joints[name].child])), kind == "prismatic", kind == "continuous")
                for name, kind in zip(scene.joint_names, kinds, strict=True)
            ],
            dtype=np.int64,
        ).reshape(-1, 3)
        now = [
            joint.getPosition() if kind == "prismatic" else joint.getAngle()
            for joint, kind in zip(self.hinges, kinds, strict=True)
        ]
        self.offset = np.array([[zero[name] for name in scene.joint_names], now])
        turning = self.joints[:, 2] != 0
        turns = np.rint((np.array(scene.joint_angle)[turning] - self.offset[1, turning]) / math.tau)
        self.offset[0, turning] += math.tau * turns

    def base_speed(self) -> tuple[Array, Array]:
        """Return views of the velocity [m/s] of the base's COM and of its spin [rad/s]; empty for a fixed base."""
        base = self._bodies.get(self._model.base)
        if base is None:
            return np.zeros(0), np.zeros(0)
        return view("dBodyGetLinearVel", body_id(base)), view("dBodyGetAngularVel", body_id(base))

    def link_poses(self) -> tuple[Array, Array, Array]:
        """Return origins [m], shape (L, 3), and rotation matrices, shape (L, 3, 3), and the base's quaternion."""
        bodies = self._bodies.values()
        rotations = np.array([body.getRotation() for body in bodies]).reshape(-1, 3, 3)
        centers = np.array([body.getPosition() for body in bodies]).reshape(-1, 3)
        origins = centers - (rotations @ self._com)[:, :, 0]
        # A fixed base, which is no body, comes last.
        origin, rotation = np.vstack((origins, self._base_pose[0])), np.vstack((rotations, self._base_pose[1][None]))
        turned = rotation[self._part]
        base = self._bodies.get(self._model.base)
        quaternion = self._scene.base_quaternion if base is None else base.getQuaternion()
        return origin[self._part] + (turned @ self._offset)[:, :, 0], turned @ self._turn, np.array(quaternion)

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
        for name, hinge, zero in zip(self._scene.joint_names, self.hinges, self.offset[0].tolist(), strict=True):
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
        self.shapes[shape] = name


def make_body(world: Any, mass: float, inertia: Array) -> Any:
    """Return a body of this mass [kg] and inertia [kg m²], whose frame has its origin at the COM, as ODE wants it."""
    body, made = ode.Body(world), ode.Mass()
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tolist()
    made.setParameters(mass, 0.0, 0.0, 0.0, xx, yy, zz, xy, xz, yz)
    body.setMass(made)
    return body


def make_ball(world: Any, ball: Ball) -> tuple[Any, Any]:
    """Return the ball's body and its shape, in no space."""
    body, shape = make_body(world, ball.mass, ball.inertia * np.eye(3)), ode.GeomSphere(None, ball.radius)
    shape.setBody(body)
    body.setPosition(ball.position)
    body.setLinearVel(ball.velocity)
    return body, shape
