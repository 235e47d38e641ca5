"""A step in DART as compiled code, by the C++ methods that dartpy's library exports."""

import ctypes
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import dartpy
import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from imolo.contracts.engine import Array
from imolo_backends.compiled import answer_of, external, has_all

LIBRARY = ctypes.CDLL(dartpy.__file__)
PYBIND = b"system_libstdcpp_gxx_abi_1xxx_use_cxx11_abi_1"  # its name of the C++ whose addresses are asked for

ID, REAL, FLAG = types.intp, types.double, types.intc
WORLD, FRAME, BODY = "N4dart10simulation5World", "N4dart8dynamics5Frame", "N4dart8dynamics8BodyNode"
SKELETON, DOF = "N4dart8dynamics8Skeleton", "4dart8dynamics15DegreeOfFreedom"
VECTOR = "N5Eigen6MatrixIdLi3ELi1ELi0ELi3ELi1EEE"
_function = partial(external, LIBRARY)
world_step = _function(f"_Z{WORLD}4stepEb", types.void, ID, FLAG)
set_force = _function(f"_ZN{DOF}8setForceEd", types.void, ID, REAL)
angle_of = _function(f"_ZNK{DOF}11getPositionEv", REAL, ID)
velocity_of = _function(f"_ZNK{DOF}11getVelocityEv", REAL, ID)
add_force = _function(f"_Z{BODY}11addExtForceERK{VECTOR}S6_bb", types.void, ID, ID, ID, FLAG, FLAG)
# C++ is told first where to put the vector that it returns.
com_velocity = _function(f"_ZNK{BODY[1:]}20getCOMLinearVelocityEPKNS0_5FrameES4_", types.void, ID, ID, ID, ID)
FUNCTIONS = (world_step, set_force, angle_of, velocity_of, add_force, com_velocity)


class Addresses(NamedTuple):
    """Where DART has what a step needs.

    Attributes:
        ids: World, the ball's body, world frame, and the degree of freedom of each joint, shape (3 + J,).
        ball_impulse: Of the constraints on the ball in the last step [N s], shape (3,).
    """

    ids: NDArray[np.int64]
    ball_impulse: Array


def addresses(world: Any, robot: Any, dofs: Sequence[int], ball: Any) -> Addresses | None:
    """Return the addresses of these objects of dartpy's; None where it is compiled in another way."""
    if not has_all(LIBRARY, FUNCTIONS):
        return None
    try:
        skeleton, body = _address(robot, SKELETON), _address(ball, BODY)
        joints = [answer_of(LIBRARY, f"_Z{SKELETON}6getDofEm", skeleton, number) for number in dofs]
        ids = np.array([_address(world, WORLD), body, answer_of(LIBRARY, f"_Z{FRAME}5WorldEv"), *joints])
        twist = answer_of(LIBRARY, f"_ZNK{BODY[1:]}20getConstraintImpulseEv", body)
    except (AttributeError, TypeError, ValueError):
        return None
    return Addresses(ids, np.ctypeslib.as_array((ctypes.c_double * 6).from_address(twist))[3:])


def _address(thing: Any, kind: str) -> int:
    """Return where an object of C++ is, by the way that pybind11 has for other libraries.

    Raises:
        AttributeError, TypeError, ValueError: pybind11 is older, another C++ was taken, or it is of another kind.
    """
    type_info = _new_capsule(ctypes.addressof(ctypes.c_char.in_dll(LIBRARY, f"_ZTI{kind}E")), b"St9type_info", None)
    return int(
        _in_capsule(thing._pybind11_conduit_v1_(PYBIND, type_info, b"raw_pointer_ephemeral"), f"{kind}E".encode())
    )


_new_capsule, _in_capsule = ctypes.pythonapi.PyCapsule_New, ctypes.pythonapi.PyCapsule_GetPointer
_new_capsule.restype, _new_capsule.argtypes = ctypes.py_object, (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
_in_capsule.restype, _in_capsule.argtypes = ctypes.c_size_t, (ctypes.py_object, ctypes.c_char_p)


@njit(cache=True)
def step(
    ids: NDArray[np.int64],
    joint_angle: Array,
    joint_velocity: Array,
    ball_velocity: Array,
    joint_torque: Array,
    ball_force: Array,
    center: Array,
) -> None:
    """Take a step, and write how joints and ball move.

    Args:
        ids: See `Addresses`.
        joint_angle: [rad], shape (J,).
        joint_velocity: [rad/s], shape (J,).
        ball_velocity: [m/s], shape (3,).
        joint_torque: [N·m], shape (J,).
        ball_force: [N], shape (3,).
        center: Of the ball in its own frame [m], shape (3,).
    """
    world, ball, frame, joints = ids[0], ids[1], ids[2], ids[3:]
    for j in range(len(joints)):
        set_force(joints[j], joint_torque[j])
    add_force(ball, ball_force.ctypes.data, center.ctypes.data, 0, 1)
    world_step(world, 1)
    for j in range(len(joints)):
        joint_angle[j], joint_velocity[j] = angle_of(joints[j]), velocity_of(joints[j])
    com_velocity(ball_velocity.ctypes.data, ball, frame, frame)
