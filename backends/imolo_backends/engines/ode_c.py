"""From the objects of Python's module `ode`, which builds a scene, to those of ODE's C interface."""

import ctypes
from functools import partial
from typing import Any

import numpy as np

from imolo.contracts.engine import Array
from imolo_backends.compiled import answer_of
from imolo_backends.engines.ode_library import ode

C = ctypes.CDLL("libode.so.8")  # the module has loaded it, so that this name is enough
ask = partial(answer_of, C)


def view(name: str, body: int) -> Array:
    """Return the vector of a body, shape (3,), where ODE has it."""
    return np.ctypeslib.as_array((ctypes.c_double * 3).from_address(ask(name, body)))


def body_id(body: Any) -> int:
    """Return the id of one of the module's bodies, which it tells of shapes alone."""
    shape = ode.GeomSphere(None, 1.0)
    shape.setBody(body)
    return ask("dGeomGetBody", shape._id())


def joint_id(child: int) -> int:
    """Return the id of the joint whose first body this is."""
    count = ask("dBodyGetNumJoints", child) & 0xFFFF
    joints = [ask("dBodyGetJoint", child, number) for number in range(count)]
    return next(joint for joint in joints if ask("dJointGetBody", joint, 0) == child)
