"""MuJoCo with one stiffness for all contacts, as small as an engine can be."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from imolo.config.model import Positive
from imolo.conformance import Limitation
from imolo.contracts.engine import Array, EngineOptions
from imolo.contracts.urdf import RobotModel
from imolo_backends.engines.adapter import FLOOR, EngineAdapter, Loaded, Poses, Touch
from imolo_backends.engines.engine_checks import base_rotation, turned_inertia
from imolo_backends.simulation.simulated import simulated_plugin

BALL = "my ball"


class MyOptions(EngineOptions):
    """Options of my engine; they appear as keys of the config's backend section."""

    contact_time: Positive = 0.002  # [s] time constant of contacts and stops


class MyEngine(EngineAdapter):
    """One trial."""

    def load(self, urdf: Path, robot: RobotModel, options: MyOptions) -> Loaded:
        """Load `self._scene` from `urdf`, which is gone afterwards, and say what the library holds."""
        scene = self._scene
        spec = mujoco.MjSpec.from_file(str(urdf))
        spec.compiler.fusestatic = False
        spec.option.timestep, spec.option.gravity = scene.timestep, scene.gravity
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # what diverges must be seen
        for geom in spec.geoms:
            geom.contype, geom.conaffinity = 1, 0  # links do not collide with each other
        base, world = spec.body(scene.link_names[0]), spec.worldbody
        base.pos, base.quat = scene.base_position, scene.base_quaternion
        if not scene.fixed_base:
            base.add_freejoint()
        world.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(50.0, 50.0, 1.0))
        for box in scene.boxes:
            world.add_geom(name=box.name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=box.center, size=box.half_extents)
        ball = scene.ball
        body = world.add_body(name=BALL, mass=ball.mass, inertia=[ball.inertia] * 3, ipos=[0.0] * 3)
        body.explicitinertial = True
        body.add_freejoint()
        body.add_geom(name=BALL, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(ball.radius, 0.0, 0.0))
        for geom in spec.geoms:
            geom.friction, geom.solref = (scene.friction, 0.0, 0.0), (options.contact_time, 1.0)
        for joint in spec.joints:
            joint.solref_limit = (options.contact_time, 1.0)
        self._model = model = spec.compile()
        self._data = data = mujoco.MjData(model)

        joints = [model.joint(name) for name in scene.joint_names]
        self._angles = np.array([joint.qposadr[0] for joint in joints], dtype=int)
        self._speeds = np.array([joint.dofadr[0] for joint in joints], dtype=int)
        self._links = [model.body(name).id for name in scene.link_names]
        self._ball_dof = model.body(BALL).dofadr[0]
        self._ball_angle = model.jnt_qposadr[model.body(BALL).jntadr[0]]
        data.qpos[self._angles] = scene.joint_angle
        data.qpos[self._ball_angle : self._ball_angle + 3] = ball.position
        data.qvel[self._ball_dof : self._ball_dof + 3] = ball.velocity
        if not scene.fixed_base:
            dof = model.body(scene.link_names[0]).dofadr[0]
            data.qvel[dof : dof + 3] = scene.base_velocity
            data.qvel[dof + 3 : dof + 6] = base_rotation(scene).T @ np.array(scene.base_angular_velocity)
        return self._loaded(joints)

    def _loaded(self, joints: list[Any]) -> Loaded:
        model, bodies = self._model, {}
        for body in map(model.body, range(1, model.nbody)):
            inertia = turned_inertia(np.roll(body.iquat, -1), body.inertia)  # from w, x, y, z to x, y, z, w
            bodies[body.name] = (float(body.mass[0]), body.ipos, inertia)
        return Loaded(
            ball=bodies.pop(BALL),
            links=bodies,
            gravity=model.opt.gravity,
            limits={joint.name: joint.range for joint in joints if joint.limited[0]},
            timestep=model.opt.timestep,
            friction=[(f"shape {number}", value) for number, value in enumerate(model.geom_friction[:, 0])],
            resistance={"the joints": [model.dof_damping, model.dof_frictionloss]},
        )

    def advance(self, joint_torque: Array, ball_force: Array) -> bool:
        """Advance by one timestep; True lets the framework ask for `touches`."""
        data, dof = self._data, self._ball_dof
        data.qfrc_applied[self._speeds] = joint_torque
        data.qfrc_applied[dof : dof + 3] = ball_force
        mujoco.mj_step(self._model, data)
        return bool(data.qfrc_constraint[dof : dof + 3].any())

    def touches(self) -> Iterator[Touch]:
        """Yield with what the ball is in contact, where [m], and the normal force [N]."""
        wrench = np.zeros(6)
        for index, pair in enumerate(self._data.contact.geom):
            bodies = self._model.geom_bodyid[pair]
            names = [self._model.geom(g).name or self._model.body(b).name for g, b in zip(pair, bodies, strict=True)]
            if BALL in names:
                mujoco.mj_contactForce(self._model, self._data, index, wrench)
                yield names[names[0] == BALL], self._data.contact.pos[index], float(wrench[0])

    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """Write where the joints are, and how fast joints and ball are; called at every step."""
        joint_angle[:], joint_velocity[:] = self._data.qpos[self._angles], self._data.qvel[self._speeds]
        ball_velocity[:] = self._data.qvel[self._ball_dof : self._ball_dof + 3]

    def poses(self) -> Poses:
        """Return where links and ball are."""
        data, base = self._data, self._links[0]
        mujoco.mj_kinematics(self._model, data)  # otherwise one step behind the joints
        rotations = data.xmat.reshape(-1, 3, 3)[self._links]
        ball_position = data.qpos[self._ball_angle : self._ball_angle + 3]
        return data.xpos[self._links], rotations, data.xquat[base], ball_position


DAMPED = "contacts are critically damped, whatever is asked for"
BACKEND = simulated_plugin(
    MyEngine,
    MyOptions,
    summary="one line for `imolo backends`",
    limitations=[Limitation(DAMPED, {"restitution_asked": tuple(f"e got for {e} asked" for e in (0, 0.3, 0.5, 0.8))})],
    ingredients={"contact stiffness": ({"contact_time": 0.002}, {"contact_time": 0.02})},
)
