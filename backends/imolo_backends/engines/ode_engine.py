"""ODE, the paper's engine, as an `Engine`."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PositiveInt, model_validator

from imolo.config.model import Fraction, NonNegative, Searched
from imolo.conformance import Limitation
from imolo.contracts.engine import Array, EngineOptions
from imolo.contracts.urdf import RobotModel
from imolo.errors import DivergenceError
from imolo_backends.compiled import CFunction, c_function
from imolo_backends.engines import ode_step
from imolo_backends.engines.adapter import FLOOR, EngineAdapter, Loaded, Poses, Touch
from imolo_backends.engines.engine_checks import check_value
from imolo_backends.engines.ode_c import ask, body_id, view
from imolo_backends.engines.ode_library import ode
from imolo_backends.engines.ode_model import OdeRobot, make_ball
from imolo_backends.engines.ode_step import read_joints
from imolo_backends.simulation.simulated import simulated_plugin

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
        robot_space, fixed_space = self._robot_space, self._fixed_space = ode.SimpleSpace(), ode.SimpleSpace()
        self._robot = OdeRobot(world, robot_space, scene, robot, options.stop_erp)
        self._ball, self._ball_shape = make_ball(world, scene.ball)
        fixed = {ode.GeomPlane(fixed_space, (0.0, 0.0, 1.0), 0.0): FLOOR}
        for box in scene.boxes:
            shape = ode.GeomBox(fixed_space, [2.0 * half for half in box.half_extents])
            shape.setPosition(box.center)
            fixed[shape] = box.name
        self._shapes = self._robot.shapes | fixed
        self._names = {shape._id(): name for shape, name in self._shapes.items()}
        world.setQuickStepNumIterations(options.sweeps)
        self._prepare_steps()
        return self._loaded()

    def _prepare_steps(self) -> None:
        scene, options, ball = self._scene, self._options, body_id(self._ball)
        words, numbers = self._block = ode_step.new_block()
        spaces = (self._robot_space, self._fixed_space, self._ball_shape)
        words[ode_step.WORLD], words[ode_step.BALL] = ask("dBodyGetWorld", ball), ball
        words[ode_step.GROUP] = ask("dJointGroupCreate", 0)
        words[ode_step.ROBOT_SPACE : ode_step.BALL_SHAPE + 1] = [space._id() for space in spaces]
        words[ode_step.SWEEPS], words[ode_step.MOST] = options.sweeps, options.max_contacts
        words[ode_step.TURNED] = options.friction == "sliding"
        fall = [g * scene.timestep for g in scene.gravity]
        numbers[ode_step.TIMESTEP : ode_step.FALL_Z + 1] = (
            *(scene.timestep, scene.friction, options.contact_erp),
            *(scene.restitution, scene.robot_restitution, options.restitution_velocity),
            scene.friction * math.hypot(*fall),  # [m/s] in a step, by friction under the weight
            *fall,
        )
        angle, velocity, _ = self._motion
        self._motion = angle, velocity, view("dBodyGetLinearVel", ball)
        self._base_speed = self._robot.base_speed()
        self._torque, self._force, self._touched = np.zeros(len(angle)), np.zeros(3), np.zeros(1)
        joints = self._robot.joints, self._robot.offset, angle, velocity
        read_joints(*joints)
        moving = *self._motion[2:], *self._base_speed
        self._arguments = words, numbers, *joints, *moving, self._torque, self._force, self._touched

    def advance(self, joint_torque: Array, ball_force: Array) -> bool:
        """See `EngineAdapter.advance`."""
        self._torque[:], self._force[:] = joint_torque, ball_force
        ode_step.step(*self._arguments)
        return bool(self._touched[0])

    def compiled_advance(self) -> tuple[CFunction, Array, Array, Array]:
        """See `EngineAdapter.compiled_step`."""
        return c_function(ode_step.step, *self._arguments), self._torque, self._force, self._touched

    def touches(self) -> Iterator[Touch]:
        """See `EngineAdapter.touches`.

        Raises:
            DivergenceError: A torque, force or speed is out of bounds, with which ODE might abort the process.
        """
        words, numbers = self._block
        if words[ode_step.DIVERGED]:
            speeds = [part.tolist() for part in (*self._motion[1:], *self._base_speed)]
            raise DivergenceError(
                f"not finite or beyond {ode_step.LARGEST:g} at {self.time:.4f} s: torques {self._torque.tolist()} N·m, "
                f"ball force {self._force.tolist()} N or speeds of joints, ball and base {speeds}"
            )
        for at in range(ode_step.TOUCHES, ode_step.CONTACTS, ode_step.TOUCH)[: words[ode_step.TOUCHED]]:
            _, *position = numbers[at : at + ode_step.ALONG].tolist()
            normal, force = numbers[at + ode_step.ALONG :][:3].tolist(), numbers[at + ode_step.FEEDBACK :][:3].tolist()
            yield self._names[words[at]], position, abs(sum(f * n for f, n in zip(force, normal, strict=True)))

    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """See `EngineAdapter.write_motion`; each step has done so."""

    def poses(self) -> Poses:
        """See `EngineAdapter.poses`."""
        return *self._robot.link_poses(), np.array(self._ball.getPosition())

    def close(self) -> None:
        """See `Engine.close`.

        ODE's objects are let go here, one after the other. The garbage collector, which meets them where the engine is
        part of a circle of references, takes them apart in an order in which ODE crashes.
        """
        if "_block" in vars(self):
            ask("dJointGroupDestroy", int(self._block[0][ode_step.GROUP]))
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
