"""The Open Dynamics Engine, or the way to get it; alone in a module so that it is quickly seen whether it is there.

`ode` is Python's module, which builds a scene; what follows leads from its objects to those of ODE's C interface.
"""

import ctypes
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np

from imolo.contracts.engine import Array

try:
    import ode

    ode.HingeJoint  # noqa: B018 - PyPI has another package of this name
except (ImportError, AttributeError) as error:
    get = shlex.join(["bash", str(Path(__file__).with_name("get_ode")), sys.executable])
    raise ImportError(
        f"{error}; PyPI has no wheel of the Open Dynamics Engine, Debian has one for its own version of Python: {get}"
    ) from error

__all__ = ["LIBRARY", "ask", "body_id", "joint_id", "ode", "view"]

LIBRARY = "libode.so.8"  # the module has loaded it, so that this name is enough
C = ctypes.CDLL(LIBRARY)


def ask(name: str, *ids: int) -> int:
    """Return the id or address that one of ODE's C functions returns."""
    function = getattr(C, name)
    function.restype = ctypes.c_size_t
    return int(function(*map(ctypes.c_size_t, ids)))


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
