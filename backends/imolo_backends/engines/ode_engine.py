"""ODE, the paper's engine, as an `Engine`."""

import math
from typing import Any, Literal

import numpy as np
from pydantic import PositiveInt, model_validator

from imolo.config.model import Fraction, NonNegative
from imolo.conformance import Limitation
from imolo.contracts.engine import Array, BallContact, EngineOptions, EngineState, Scene
from imolo.contracts.urdf import RobotModel, read_urdf
from imolo.errors import DivergenceError
from imolo_backends.engines.engine_checks import FLOOR, check_scene, check_value, merge_touches
from imolo_backends.engines.ode_model import OdeRobot, make_body, ode
from imolo_backends.simulation.simulated import simulated_plugin

LARGEST = 1e9  # [N·m, N, rad/s, m/s] ODE ends the process when a rotation overflows, which is far beyond
PAPER_SETTINGS = {
    "erp": 1e-6,
    "cfm": 1e-6,
    "stop_erp": 1e-6,
    "contact_erp": 1e-6,
    "max_contacts": 3,
    "friction": "pyramid",
}
SLIDING = 1e-6  # [m/s] slower than this, a contact sticks and has no direction of sliding


class OdeOptions(EngineOptions):
    """Options of the ODE engine.

    Attributes:
        settings: `paper` replaces the defaults of all other options by the paper's settings (Sec. VI) and by what ODE
            does on its own. They move the hand by 3 mm, and a pendulum swings .9 mm off its pivot in 5 s.
        erp: Share of a joint's error removed per step [-].
        cfm: Softness of joints, stops and contacts [m/(s·N)]; at ODE's 1e-10 hinges give by a millionth of a torque.
        stop_erp: Share of the error of a joint beyond its stop removed per step [-].
        contact_erp: Share of a penetration removed per step [-]. At ODE's .2 a ball that should not bounce keeps up to
            18 % of its speed.
        max_contacts: Largest number of contact points of two shapes; the deepest are kept.
        friction: ODE's friction is a pyramid: a box slides 29 % less far at 45° to its axes. `sliding` turns it at each
            contact into the direction of sliding, where it is exact.
        restitution_velocity: Slower impacts do not bounce [m/s].
    """

    settings: Literal["accurate", "paper"] = "accurate"
    erp: Fraction = 0.8
    cfm: NonNegative = 1e-11
    stop_erp: Fraction = 0.02
    contact_erp: Fraction = 0.02
    max_contacts: PositiveInt = 4
    friction: Literal["sliding", "pyramid"] = "sliding"
    restitution_velocity: NonNegative = 0.05

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        if isinstance(given, dict) and given.get("settings") == "paper":
            return {**PAPER_SETTINGS, **given}
        return given


class OdeEngine:
    """One trial in ODE, in a world of its own."""

    def __init__(self, scene: Scene, options: OdeOptions) -> None:
        robot = read_urdf(scene.urdf)
        check_scene(scene, robot)
        self._scene = scene
        self._options = options
        world = self._world = ode.World()
        world.setGravity(scene.gravity)
        world.setERP(options.erp)
        world.setCFM(options.cfm)
        self._contact_joints = ode.JointGroup()
        self._robot_space, self._fixed_space = ode.SimpleSpace(), ode.SimpleSpace()
        self._robot = OdeRobot(world, self._robot_space, scene, options.stop_erp)
        self._shapes = dict(self._robot.shapes)
        self._add_torque = [hinge.addTorque for hinge in self._robot.hinges]

        self._ball = make_body(world, scene.ball.mass, scene.ball.inertia * np.eye(3))
        self._ball_shape = ode.GeomSphere(None, scene.ball.radius)
        self._ball_shape.setBody(self._ball)
        self._ball.setPosition(scene.ball.position)
        self._ball.setLinearVel(scene.ball.velocity)
        self._shapes[self._ball_shape] = self._ball, "ball"
        self._shapes[ode.GeomPlane(self._fixed_space, (0.0, 0.0, 1.0), 0.0)] = None, FLOOR
        for box in scene.boxes:
            shape = ode.GeomBox(self._fixed_space, [2.0 * half for half in box.half_extents])
            shape.setPosition(box.center)
            self._shapes[shape] = None, box.name

        self._fall = [g * scene.timestep for g in scene.gravity]
        self._ball_touches: list[tuple[Any, str, Any, Any]] = []
        self._contacts: list[BallContact] = []
        joints = len(scene.joint_names)
        self._motion = np.empty(joints), np.empty(joints), np.empty(3)
        self._motion_is_old = True
        self._steps = 0
        self._check(robot)

    def step(self, joint_torque: Array, ball_force: Array) -> None:
        """See `Engine.step`.

        Raises:
            DivergenceError: A torque, force or speed is out of bounds, with which ODE might abort the process.
        """
        torque, force = joint_torque.tolist(), ball_force.tolist()
        _, velocity, ball_velocity = self.motion()
        total = sum(map(abs, (*torque, *force, *velocity.tolist(), *ball_velocity.tolist(), *self._robot.base_speed())))
        if not total < LARGEST:
            raise DivergenceError(
                f"not finite or beyond {LARGEST:g} at {self._steps * self._scene.timestep:.4f} s: torques {torque} N·m "
                f"or ball force {force} N or speeds: {velocity.tolist()} rad/s, ball {ball_velocity.tolist()} m/s"
            )
        # ODE forgets torques and forces after every step.
        for add, value in zip(self._add_torque, torque, strict=True):
            add(value)
        self._ball.addForce(force)
        ode.collide2(self._robot_space, self._fixed_space, None, self._meet)
        ode.collide2(self._ball_shape, self._fixed_space, None, self._meet)
        ode.collide2(self._ball_shape, self._robot_space, None, self._meet)
        self._world.step(self._scene.timestep)
        self._steps += 1
        self._motion_is_old = True
        if self._ball_touches:
            self._collect_contacts()
        self._contact_joints.empty()
        self._robot.count_turns()

    def _meet(self, _: None, first: Any, second: Any) -> None:
        contacts = ode.collide(first, second)
        if not contacts:
            return
        options, scene = self._options, self._scene
        (first_body, first_name), (second_body, second_name) = self._shapes[first], self._shapes[second]
        if first_body is None and second_body is None:
            return
        with_ball = self._ball in (first_body, second_body)
        if len(contacts) > options.max_contacts:
            contacts.sort(key=lambda contact: -contact.getContactGeomParams()[2])
            del contacts[options.max_contacts :]
        for contact in contacts:
            mode = ode.ContactApprox1 | ode.ContactSoftERP
            contact.setMu(scene.friction)
            contact.setSoftERP(options.contact_erp)
            position, normal, _, _, _ = contact.getContactGeomParams()
            if with_ball:
                mode |= ode.ContactBounce
                contact.setBounce(scene.restitution)
                contact.setBounceVel(options.restitution_velocity)
            if options.friction == "sliding":
                direction = _sliding_direction(first_body, second_body, position, normal, self._fall)
                if direction is not None:
                    mode |= ode.ContactFDir1
                    contact.setFDir1(direction)
            contact.setMode(mode)
            joint = ode.ContactJoint(self._world, self._contact_joints, contact)
            joint.attach(first_body, second_body)
            if with_ball:
                joint.setFeedback(True)
                other = second_name if first_body is self._ball else first_name
                self._ball_touches.append((joint, other, position, normal))

    def _collect_contacts(self) -> None:
        touches = []
        for joint, other, position, normal in self._ball_touches:
            force = joint.getFeedback()[0]
            touches.append((other, position, abs(sum(f * n for f, n in zip(force, normal, strict=True)))))
            # With it the process would abort when the joint is removed.
            joint.setFeedback(False)
        self._ball_touches.clear()
        self._contacts += merge_touches(self._steps * self._scene.timestep, touches)

    def motion(self) -> tuple[Array, Array, Array]:
        """See `Engine.motion`."""
        angle, velocity, ball_velocity = self._motion
        if self._motion_is_old:
            self._robot.write_motion(angle, velocity)
            ball_velocity[:] = self._ball.getLinearVel()
            self._motion_is_old = False
        return self._motion

    def read(self) -> EngineState:
        """See `Engine.read`."""
        position, rotation, base_quaternion = self._robot.link_poses()
        angle, velocity, ball_velocity = self.motion()
        contacts, self._contacts = tuple(self._contacts), []
        return EngineState(
            time=self._steps * self._scene.timestep,
            joint_angle=angle.copy(),
            joint_velocity=velocity.copy(),
            link_position=position,
            link_rotation=rotation,
            base_quaternion=base_quaternion,
            ball_position=np.array(self._ball.getPosition()),
            ball_velocity=ball_velocity.copy(),
            ball_contacts=contacts,
        )

    def close(self) -> None:
        """See `Engine.close`.

        ODE's objects are let go here, one after the other. The garbage collector, which meets them where the engine is
        part of a circle of references, takes them apart in an order in which ODE crashes.
        """
        vars(self).clear()

    def _check(self, robot: RobotModel) -> None:
        scene, world, options = self._scene, self._world, self._options
        self._robot.check(robot, options.stop_erp, options.cfm)
        ball = self._ball.getMass()
        check_value("mass of the ball [kg]", ball.mass, scene.ball.mass)
        check_value("inertia of the ball [kg m²]", ball.I, scene.ball.inertia * np.eye(3))
        check_value("gravity [m/s²]", world.getGravity(), scene.gravity)
        check_value("ERP and CFM of the joints", (world.getERP(), world.getCFM()), (options.erp, options.cfm))
        check_value("damping [-]", (world.getLinearDamping(), world.getAngularDamping()), (0.0, 0.0))
        check_value("auto-disable flag", world.getAutoDisableFlag(), 0.0)


def _sliding_direction(first: Any, second: Any, position: Any, normal: Any, fall: Any) -> Any:
    """Return the unit vector along which one body slides on the other, either way round; None where nothing slides.

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
    return (x / speed, y / speed, z / speed) if speed > SLIDING else None


LIMITATIONS = (
    Limitation(
        "ODE damps what tumbles: its gyroscopic torque is implicit, of first order with a large error",
        {"tumbling_box": ("error of orientation", "error of orientation at dt = 0", "order of orientation")},
    ),
    Limitation(
        "hinges are constraints of free bodies; mending their error takes energy",
        {
            "spinning_joint": ("velocity",),
            "rod_pendulum": ("swing of the energy", "energy that is conserved, largest change"),
        },
    ),
)

BACKEND = simulated_plugin(
    OdeEngine,
    OdeOptions,
    "ODE, the paper's: exact LCP, friction pyramid turned along the slide",
    LIMITATIONS,
    ingredients={
        "friction cone": ({"friction": "sliding"}, {"friction": "pyramid"}),
        "contact stiffness": ({"contact_erp": 0.02}, {"contact_erp": 0.2}, {"contact_erp": 1e-6}),
        "joint-limit model": ({"stop_erp": 0.02}, {"stop_erp": 0.2}, {"stop_erp": 1e-6}),
        "joint stiffness": ({"erp": 0.8}, {"erp": 0.2}, {"erp": 1e-6}),
        "softness": ({"cfm": 1e-11}, {"cfm": 1e-6}),
    },
)
