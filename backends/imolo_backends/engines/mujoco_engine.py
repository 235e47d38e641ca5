"""MuJoCo as an `Engine`."""

import ctypes
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from imolo.conformance import Limitation
from imolo.contracts.engine import Array, Scene
from imolo.contracts.urdf import RobotModel
from imolo_backends.compiled import CFunction
from imolo_backends.engines.adapter import EngineAdapter, Loaded, Poses, Touch
from imolo_backends.engines.engine_checks import base_rotation, joint_index, turned_inertia
from imolo_backends.engines.mujoco_model import BALL as BALL
from imolo_backends.engines.mujoco_model import MujocoOptions as MujocoOptions
from imolo_backends.engines.mujoco_model import build_model
from imolo_backends.simulation.simulated import simulated_plugin

MJ_STEP = ctypes.cast(ctypes.CDLL(mujoco._functions.__file__).mj_step, ctypes.c_void_p).value or 0


class MujocoEngine(EngineAdapter):
    """One trial in MuJoCo."""

    def load(self, urdf: Path, robot: RobotModel, options: MujocoOptions) -> Loaded:
        """See `EngineAdapter.load`."""
        scene = self._scene
        model = self._model = build_model(scene, options, urdf)
        data = self._data = mujoco.MjData(model)

        joints = [model.joint(name) for name in scene.joint_names]
        self._angle_index = joint_index([joint.qposadr[0] for joint in joints])
        self._velocity_index = joint_index([joint.dofadr[0] for joint in joints])
        ball_dof = model.body(BALL).dofadr[0]
        ball_angle = model.jnt_qposadr[model.body(BALL).jntadr[0]]
        self._applied = data.qfrc_applied
        self._ball_force = data.qfrc_applied[ball_dof : ball_dof + 3]
        self._ball_position = data.qpos[ball_angle : ball_angle + 3]
        self._ball_velocity = data.qvel[ball_dof : ball_dof + 3]
        self._ball_reaction = data.qfrc_constraint[ball_dof : ball_dof + 3]
        self._views = isinstance(self._velocity_index, slice)
        if self._views:  # MuJoCo's own memory, in which compiled code works
            self._motion = (data.qpos[self._angle_index], data.qvel[self._velocity_index], self._ball_velocity)
        self._links = joint_index([model.body(name).id for name in scene.link_names])
        self._body_position, self._body_rotation = data.xpos, data.xmat.reshape(-1, 3, 3)
        self._base_quaternion = data.xquat[model.body(scene.link_names[0]).id]
        self._ball_geom = model.geom(BALL).id
        # What is fixed is a shape of the world, and shapes of links have no names.
        geoms = map(model.geom, range(model.ngeom))
        self._geom_names = [model.body(geom.bodyid[0]).name if geom.bodyid[0] else geom.name for geom in geoms]
        self._start()
        return _loaded(model, scene)

    def _start(self) -> None:
        scene, data = self._scene, self._data
        data.qpos[self._angle_index] = scene.joint_angle
        if not scene.fixed_base:
            base = self._model.body(scene.link_names[0])
            position, velocity = self._model.jnt_qposadr[base.jntadr[0]], base.dofadr[0]
            data.qpos[position : position + 3] = scene.base_position
            data.qpos[position + 3 : position + 7] = scene.base_quaternion
            data.qvel[velocity : velocity + 3] = scene.base_velocity
            # A free joint's angular velocity is in body axes, its linear velocity in world axes.
            data.qvel[velocity + 3 : velocity + 6] = base_rotation(scene).T @ np.array(scene.base_angular_velocity)
        self._ball_position[:] = scene.ball.position
        self._ball_velocity[:] = scene.ball.velocity

    def advance(self, joint_torque: Array, ball_force: Array) -> object:
        """See `EngineAdapter.advance`."""
        self._applied[self._velocity_index] = joint_torque
        self._ball_force[:] = ball_force
        mujoco.mj_step(self._model, self._data)
        return self._ball_reaction.any()  # cheaper than a look at the contact list, which always holds the feet

    def compiled_advance(self) -> tuple[CFunction, Array, Array, Array] | None:
        """See `EngineAdapter.compiled_step`."""
        if not self._views:
            return None
        function = CFunction(MJ_STEP, (self._model._address, self._data._address))
        return function, self._applied[self._velocity_index], self._ball_force, self._ball_reaction

    def touches(self) -> Iterator[Touch]:
        """See `EngineAdapter.touches`."""
        wrench = np.zeros(6)
        for index, (first, second) in enumerate(self._data.contact.geom.tolist()):
            if self._ball_geom in (first, second):
                mujoco.mj_contactForce(self._model, self._data, index, wrench)
                other = self._geom_names[first if second == self._ball_geom else second]
                yield other, self._data.contact.pos[index], float(wrench[0])

    def write_motion(self, joint_angle: Array, joint_velocity: Array, ball_velocity: Array) -> None:
        """See `EngineAdapter.write_motion`."""
        if not self._views:
            joint_angle[:] = self._data.qpos[self._angle_index]
            joint_velocity[:] = self._data.qvel[self._velocity_index]
            ball_velocity[:] = self._ball_velocity

    def poses(self) -> Poses:
        """See `EngineAdapter.poses`."""
        # After mj_step the link poses are one step older than the joint angles.
        mujoco.mj_kinematics(self._model, self._data)
        links = self._links
        return self._body_position[links], self._body_rotation[links], self._base_quaternion, self._ball_position


def _loaded(model: Any, scene: Scene) -> Loaded:
    bodies = {}
    for body in map(model.body, range(1, model.nbody)):
        inertia = turned_inertia(np.roll(body.iquat, -1), body.inertia)
        bodies[body.name] = (float(body.mass[0]), body.ipos, inertia)
    limited = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_LIMIT
    joints = map(model.joint, scene.joint_names)
    return Loaded(
        ball=bodies.pop(BALL),
        links=bodies,
        gravity=model.opt.gravity,
        limits={joint.name: joint.range for joint in joints if limited and joint.limited[0]},
        timestep=model.opt.timestep,
        friction=[(f"shape {number}", value) for number, value in enumerate(model.geom_friction[:, 0])],
        resistance={"the joints": [model.dof_damping, model.dof_frictionloss]},
    )


ALONG = ("distance", "distance at dt = 0", "direction")
OFF_FLOOR = ("height off, at most", "turn, at most")
LIMITATIONS = (
    Limitation("a soft contact, critically damped, gives back 0.14", {"restitution_asked": ("e got for 0 asked",)}),
    Limitation(
        "soft friction gives way a little beside the slip, for the contact's impedance is 0.9 to 0.95, not 1",
        {"slide_30": ALONG, "slide_45": ALONG, "cone_or_pyramid": ("friction at 45° over friction at 0°",)},
    ),
    Limitation(
        "slip lifts what slides off its soft contact: it hops",
        {
            "slide_0": OFF_FLOOR,
            "slide_30": OFF_FLOOR,
            "slide_45": OFF_FLOOR,
            "friction_asked": ("mu got for 0.2 asked", "mu got for 1.2 asked"),
            "slide_to_roll": ("speed while the solid ball slides", "speed while the hollow ball slides"),
        },
    ),
)

BACKEND = simulated_plugin(
    MujocoEngine,
    MujocoOptions,
    summary="MuJoCo: soft contacts, elliptic friction cone",
    limitations=LIMITATIONS,
    ingredients={
        "integrator": ({"integrator": "implicitfast"}, {"integrator": "rk4"}),
        "friction cone": ({"cone": "elliptic"}, {"cone": "pyramidal"}),
        "friction stiffness": ({"impratio": 1.0}, {"impratio": 10.0}, {"impratio": 100.0}),
        "contact stiffness": ({"solref": (0.0005, 1.0)}, {"solref": (0.002, 1.0)}, {"solref": (0.02, 1.0)}),
        "joint-limit model": ({"solref_limit": (0.0005, 1.0)}, {"solref_limit": (0.002, 1.0)}),
    },
)
