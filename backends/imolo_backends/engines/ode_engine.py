"""ODE, the paper's engine, as an `Engine`."""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PositiveInt, model_validator

from imolo.config.model import Fraction, NonNegative, Searched
from imolo.conformance import Limitation
from imolo.contracts.engine import Array, EngineOptions
from imolo.contracts.urdf import RobotModel
from imolo.errors import DivergenceError
from imolo_backends.engines.adapter import FLOOR, EngineAdapter, Loaded, Poses, Touch
from imolo_backends.engines.engine_checks import check_value, fill
from imolo_backends.engines.ode_library import ode
from imolo_backends.engines.ode_model import OdeRobot, make_ball, sliding
from imolo_backends.simulation.simulated import simulated_plugin

LARGEST = 1e9  # [N·m, N, rad/s, m/s] ODE ends the process when a rotation overflows, which is far beyond
PAPER_SETTINGS = dict.fromkeys(("erp", "cfm", "stop_erp", "contact_erp"), 1e-6) | {
    "max_contacts": 3,
    "friction": "pyramid",
}


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
            contact into the direction of sliding and lets it act there alone, where it is exact, unless the contact is
            so slow that it may stick.
        sweeps: 0 solves contacts and joints exactly, but limits friction by the normal forces that there would be
            without friction. A number of sweeps (ODE's quick step) limits it by those that there are, as an impact
            on an edge needs, but lets joints give.
        restitution_velocity: Slower impacts do not bounce [m/s].
    """

    settings: Literal["accurate", "paper"] = "accurate"
    erp: Fraction = 0.8
    cfm: Annotated[NonNegative, Searched(1e-12, 1e-2)] = 1e-11
    stop_erp: Fraction = 0.02
    contact_erp: Annotated[Fraction, Searched(0.001, 0.9)] = 0.02
    max_contacts: PositiveInt = 4
    friction: Literal["sliding", "pyramid"] = "sliding"
    sweeps: Annotated[int, Field(ge=0)] = 0
    restitution_velocity: NonNegative = 0.05

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        if isinstance(given, dict) and given.get("settings") == "paper":
            return {**PAPER_SETTINGS, **given}
        return given


class OdeEngine(EngineAdapter):
    """One trial in ODE, in a world of its own."""

    def load(self, urdf: Path, robot: RobotModel, options: OdeOptions) -> Loaded:
        """See `EngineAdapter.load`."""
        scene = self._scene
        self._options = options
        world = self._world = ode.World()
        world.setGravity(scene.gravity)
        world.setERP(options.erp)
        world.setCFM(options.cfm)
        self._contact_joints = ode.JointGroup()
        self._robot_space, self._fixed_space = ode.SimpleSpace(), ode.SimpleSpace()
        self._robot = OdeRobot(world, self._robot_space, scene, robot, options.stop_erp)
        self._shapes = dict(self._robot.shapes)
        self._ball, self._ball_shape = make_ball(world, scene.ball)
        self._shapes[self._ball_shape] = self._ball, "ball"
        self._shapes[ode.GeomPlane(self._fixed_space, (0.0, 0.0, 1.0), 0.0)] = None, FLOOR
        for box in scene.boxes:
            shape = ode.GeomBox(self._fixed_space, [2.0 * half for half in box.half_extents])
            shape.setPosition(box.center)
            self._shapes[shape] = None, box.name

        self._fall = [g * scene.timestep for g in scene.gravity]
        self._stopped = scene.friction * math.hypot(*self._fall)  # [m/s] in a step, by friction under the weight
        self._step = world.quickStep if options.sweeps else world.step
        world.setQuickStepNumIterations(options.sweeps)
        self._ball_touches: list[tuple[Any, str, Any, Any]] = []
        return self._loaded()

    def advance(self, joint_torque: Array, ball_force: Array) -> bool:
        """See `EngineAdapter.advance`.

        Raises:
            DivergenceError: A torque, force or speed is out of bounds, with which ODE might abort the process.
        """
        torque, force = joint_torque.tolist(), ball_force.tolist()
        _, velocity, ball_velocity = self.motion()
        speeds = (*velocity.tolist(), *ball_velocity.tolist(), *self._robot.base_speed())
        if not sum(map(abs, (*torque, *force, *speeds))) < LARGEST:
            what = f"torques {torque} N·m, ball force {force} N or speeds of joints, ball and base {speeds}"
            raise DivergenceError(f"not finite or beyond {LARGEST:g} at {self.time:.4f} s: {what}")
        # ODE forgets torques and forces after every step.
        for add, value in zip(self._robot.add_torque, torque, strict=True):
            add(value)
        self._ball.addForce(force)
        ode.collide2(self._robot_space, self._fixed_space, None, self._meet)
        ode.collide2(self._ball_shape, self._fixed_space, None, self._meet)
        ode.collide2(self._ball_shape, self._robot_space, None, self._meet)
        self._step(self._scene.timestep)
        touched = bool(self._ball_touches)
        if touched:
            self._told = [self._tell(*touch) for touch in self._ball_touches]
            self._ball_touches.clear()
        self._contact_joints.empty()
        self._robot.count_turns()
        return touched

    def _meet(self, _: None, first: Any, second: Any) -> None:
        contacts = ode.collide(first, second)
        if not contacts:
            return
        options, scene = self._options, self._scene
        (first_body, first_name), (second_body, second_name) = self._shapes[first], self._shapes[second]
        if first_body is second_body is None:
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
            bounce = scene.restitution if with_ball else scene.robot_restitution
            if with_ball or bounce > 0.0:
                mode |= ode.ContactBounce
                contact.setBounce(bounce)
                contact.setBounceVel(options.restitution_velocity)
            if options.friction == "sliding":
                direction, speed = sliding(first_body, second_body, position, normal, self._fall)
                if direction is not None:
                    mode |= ode.ContactFDir1
                    contact.setFDir1(direction)
                    if speed > self._stopped:
                        mode |= ode.ContactMu2
                        contact.setMu2(0.0)
            contact.setMode(mode)
            joint = ode.ContactJoint(self._world, self._contact_joints, contact)
            joint.attach(first_body, second_body)
            if with_ball:
                joint.setFeedback(True)
                other = second_name if first_body is self._ball else first_name
                self._ball_touches.append((joint, other, position, normal))

    def _tell(self, joint: Any, other: str, position: Any, normal: Any) -> Touch:
        force = joint.getFeedback()[0]
        joint.setFeedback(False)  # with it the process would abort when the joint is removed
        return other, position, abs(sum(f * n for f, n in zip(force, normal, strict=True)))

    def touches(self) -> list[Touch]:
        """See `EngineAdapter.touches`."""
        return self._told

    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """See `EngineAdapter.write_motion`."""
        self._robot.write_motion(joint_angle, joint_velocity)
        fill(ball_velocity, self._ball.getLinearVel())

    def poses(self) -> Poses:
        """See `EngineAdapter.poses`."""
        return *self._robot.link_poses(), np.array(self._ball.getPosition())

    def close(self) -> None:
        """See `Engine.close`.

        ODE's objects are let go here, one after the other. The garbage collector, which meets them where the engine is
        part of a circle of references, takes them apart in an order in which ODE crashes.
        """
        vars(self).clear()

    def _loaded(self) -> Loaded:
        world, options, ball = self._world, self._options, self._ball.getMass()
        check_value("ERP and CFM of the joints", (world.getERP(), world.getCFM()), (options.erp, options.cfm))
        check_value("auto-disable flag", world.getAutoDisableFlag(), 0.0)
        return Loaded(
            links=self._robot.loaded_links(),
            ball=(ball.mass, ball.c, np.array(ball.I)),
            gravity=world.getGravity(),
            limits=self._robot.loaded_limits(options.stop_erp, options.cfm),
            timestep=None,
            welded=True,
            resistance={"the world": (world.getLinearDamping(), world.getAngularDamping())},
        )


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
    summary="ODE, the paper's: exact LCP, friction pyramid turned along the slide",
    limitations=LIMITATIONS,
    ingredients={
        "friction cone": ({"friction": "sliding"}, {"friction": "pyramid"}),
        "contact stiffness": ({"contact_erp": 0.02}, {"contact_erp": 0.2}, {"contact_erp": 1e-6}),
        "joint-limit model": ({"stop_erp": 0.02}, {"stop_erp": 0.2}, {"stop_erp": 1e-6}),
        "joint stiffness": ({"erp": 0.8}, {"erp": 0.2}, {"erp": 1e-6}),
        "softness": ({"cfm": 1e-11}, {"cfm": 1e-6}),
    },
)
