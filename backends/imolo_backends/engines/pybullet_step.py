"""A step in PyBullet as compiled code, by Bullet's C interface, which its library exports."""

import ctypes
import mmap
import struct
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from imolo.contracts.engine import Array
from imolo_backends.compiled import CFunction, c_function, external, has_all
from imolo_backends.engines.engine_checks import UNTOUCHED
from imolo_backends.engines.quiet_import import quiet_imports

with quiet_imports():  # it prints its build time
    import pybullet as pybullet

LIBRARY = ctypes.CDLL(pybullet.__file__)
BASE, TORQUE, WORLD_FRAME = -1, pybullet.TORQUE_CONTROL, pybullet.WORLD_FRAME

ID, INT, REAL = types.intp, types.intc, types.double
_function = partial(external, LIBRARY)
submit = _function("b3SubmitClientCommandAndWaitStatus", ID, ID, ID)
torques_command = _function("b3JointControlCommandInit2", ID, ID, INT, INT)
add_torque = _function("b3JointControlSetDesiredForceTorque", INT, ID, INT, REAL)
force_command = _function("b3ApplyExternalForceCommandInit", ID, ID)
add_force = _function("b3ApplyExternalForce", types.void, ID, INT, INT, ID, ID, INT)
step_command = _function("b3InitStepSimulationCommand", ID, ID)
state_command = _function("b3RequestActualStateCommandInit", ID, ID, INT)
find_state = _function("b3GetStatusActualState", INT, *[ID] * 8)
FUNCTIONS = (submit, torques_command, add_torque, force_command, add_force, step_command, state_command, find_state)
copy = external(ctypes.CDLL(None), "memcpy", ID, ID, ID, types.uintp)

# Of a program's file, see elf(5).
MAGIC = b"\x7fELF\x02\x01"  # with 64 bits, the lowest byte first
SECTIONS, SECTION_COUNT, SYMBOL_TABLE = 0x28, 0x3C, 2
SECTION = np.dtype(
    [("", "<u4"), ("kind", "<u4"), ("", "<u8", 2), ("at", "<u8"), ("size", "<u8"), ("link", "<u4"), ("", "<u4", 5)]
)
SYMBOL = np.dtype([("name", "<u4"), ("", "<u4"), ("value", "<u8"), ("size", "<u8")])


def compiled(
    client: int, robot: int, numbers: Sequence[int], ball: int, changes: Array, motion: tuple[Array, Array, Array]
) -> tuple[CFunction, Array, Array, Array] | None:
    """Return what `EngineAdapter.compiled_step` asks for; None where the library does not say what that needs.

    Args:
        client: Number of the module's connection.
        robot: Number of the robot's body.
        numbers: Of its joints.
        ball: Number of the ball's body.
        changes: See `step`.
        motion: Joint angles, joint velocities and velocity of the ball, which each step writes.
    """
    clients = has_all(LIBRARY, FUNCTIONS) and _clients()
    if not clients:
        return None
    address = ctypes.c_size_t.from_address(clients + 8 * client).value
    infos = [pybullet.getJointInfo(robot, number, client) for number in numbers]
    joints = np.array([info[3:5] for info in infos], dtype=np.int64).reshape(-1, 2)
    places, velocities = (np.zeros(1 + max(column, default=-1)) for column in joints.T)
    room = places, velocities, np.zeros(2, dtype=np.int64)
    center = np.array(pybullet.getBasePositionAndOrientation(ball, client)[0])
    acting, touched = (np.zeros(len(joints)), np.zeros(3)), np.zeros(3)
    ids = np.array([address, robot, ball])
    return c_function(step, ids, joints, changes, *room, *motion, *acting, center, touched), *acting, touched


@cache
def _clients() -> int:
    """Return where the module has the addresses of its connections, by the names of variables in its file."""
    with Path(pybullet.__file__).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as elf:
        if elf[: len(MAGIC)] != MAGIC:
            return 0
        (start,), (count,) = struct.unpack_from("<Q", elf, SECTIONS), struct.unpack_from("<H", elf, SECTION_COUNT)
        sections = np.frombuffer(elf, SECTION, count, start).copy()
        for table in sections[sections["kind"] == SYMBOL_TABLE]:
            names = sections[table["link"]]
            texts = elf[names["at"] : names["at"] + names["size"]]
            symbols = np.frombuffer(elf[table["at"] : table["at"] + table["size"]], SYMBOL)
            clients, known = (
                symbols["value"][symbols["name"] == texts.find(b"\0" + name + b"\0") + 1]
                for name in (b"sPhysicsClients1", b"b3ConnectPhysicsDirect")
            )
            if len(clients) == len(known) == 1:
                here = ctypes.cast(LIBRARY.b3ConnectPhysicsDirect, ctypes.c_void_p).value or 0
                return int(here + clients[0] - known[0])
    return 0


@njit(cache=True)
def read_state(client: int, body: int, places: Array, velocities: Array, found: NDArray[np.int64]) -> None:
    """Copy where a body is and how it moves: its base, then its joints.

    Args:
        client: Address of the connection.
        body: Its number.
        places: Of the base [m] and its quaternion, then of the joints [rad], as many as there is room for.
        velocities: Of the base [m/s] and [rad/s], then of the joints [rad/s], as many as there is room for.
        found: Room for two addresses, shape (2,).
    """
    at = found.ctypes.data
    find_state(submit(client, state_command(client, body)), 0, 0, 0, 0, at, at + 8, 0)
    copy(places.ctypes.data, found[0], 8 * len(places))
    copy(velocities.ctypes.data, found[1], 8 * len(velocities))


@njit(cache=True)
def step(
    ids: NDArray[np.int64],
    joints: NDArray[np.int64],
    changes: Array,
    places: Array,
    velocities: Array,
    found: NDArray[np.int64],
    joint_angle: Array,
    joint_velocity: Array,
    ball_velocity: Array,
    joint_torque: Array,
    ball_force: Array,
    ball_position: Array,
    touched: Array,
) -> None:
    """Take a step, write how joints and ball move, and to `touched` something that is not 0 if the ball touched.

    Args:
        ids: Address of the connection, numbers of the robot and of the ball, shape (3,).
        joints: Of each joint where it is among the robot's places and velocities, shape (J, 2).
        changes: What a force changes of the ball's velocity [s/kg], and gravity [m/s], in a step, shape (4,).
        places: See `read_state`, of the robot.
        velocities: See `read_state`, of the robot.
        found: See `read_state`.
        joint_angle: [rad], shape (J,).
        joint_velocity: [rad/s], shape (J,).
        ball_velocity: [m/s], shape (3,).
        joint_torque: [N·m], shape (J,).
        ball_force: [N], shape (3,).
        ball_position: [m], shape (3,).
        touched: Shape (3,).
    """
    client, robot, ball = ids
    if len(joints):
        command = torques_command(client, robot, TORQUE)
        for j in range(len(joints)):
            add_torque(command, joints[j, 1], joint_torque[j])
        submit(client, command)
    if ball_force[0] != 0.0 or ball_force[1] != 0.0 or ball_force[2] != 0.0:
        command = force_command(client)
        add_force(command, ball, BASE, ball_force.ctypes.data, ball_position.ctypes.data, WORLD_FRAME)
        submit(client, command)
    submit(client, step_command(client))
    x, y, z = ball_velocity
    read_state(client, ball, ball_position, ball_velocity, found)
    change = 0.0
    for axis, before in enumerate((x, y, z)):
        change += abs(ball_velocity[axis] - before - ball_force[axis] * changes[0] - changes[1 + axis])
    touched[0] = change > UNTOUCHED
    if len(joints):
        read_state(client, robot, places, velocities, found)
    for j in range(len(joints)):
        joint_angle[j], joint_velocity[j] = places[joints[j, 0]], velocities[joints[j, 1]]
