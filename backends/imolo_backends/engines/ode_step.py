"""A step in ODE as compiled code, by ODE's C interface: torques, contacts, the solver, and how the joints move."""

import math
from functools import cache, partial
from typing import Any

import numpy as np
from numba import carray, cfunc, njit, types
from numpy.typing import NDArray

from imolo.contracts.engine import Array
from imolo_backends.compiled import external
from imolo_backends.engines.ode_c import C
from imolo_backends.engines.ode_library import ode

LARGEST = 1e9  # [N·m, N, rad/s, m/s] ODE ends the process when a rotation overflows, which is far beyond
SLIDING = 1e-6  # [m/s] slower than this, a contact sticks and has no direction of sliding

# A dContact in words of 8 bytes: its surface, its geometry, the direction of friction. Of two shapes there are at most
# FOUND, of the ball's with all shapes ROOM.
MODE, MU, MU2, BOUNCE, BOUNCE_VELOCITY, SOFT_ERP = 0, 1, 2, 6, 7, 8
POSITION, NORMAL, DEPTH, DIRECTION, CONTACT = 15, 19, 23, 27, 31
FOUND, ROOM = 150, 32
# What was touched: the other shape, where, the normal, and the dJointFeedback of the contact's joint.
OTHER, PLACE, ALONG, FEEDBACK, TOUCH = 0, 1, 4, 7, 23
# The block of memory that a step works in: ids and counts, numbers, touches, contacts.
SELF, WORLD, GROUP, BALL, ROBOT_SPACE, FIXED_SPACE, BALL_SHAPE, MEET = range(8)
SWEEPS, MOST, TURNED, MADE, TOUCHED, DIVERGED = range(8, 14)
TIMESTEP, FRICTION, ERP, BALL_BOUNCE, ROBOT_BOUNCE, SLOWEST_BOUNCE, STOPPED, FALL_X, FALL_Y, FALL_Z = range(14, 24)
TOUCHES = 24
CONTACTS = TOUCHES + ROOM * TOUCH
BLOCK = CONTACTS + FOUND * CONTACT

Block = tuple[NDArray[np.int64], Array]
"""The same memory as integers and as numbers, each of shape (BLOCK,)."""

ID, REAL = types.intp, types.double
PLAIN = ode.ContactApprox1 | ode.ContactSoftERP
WITH_BOUNCE, WITH_DIRECTION, WITH_MU2 = ode.ContactBounce, ode.ContactFDir1, ode.ContactMu2

_function = partial(external, C)
add_hinge_torque = _function("dJointAddHingeTorque", types.void, ID, REAL)
add_slider_force = _function("dJointAddSliderForce", types.void, ID, REAL)
hinge_angle, hinge_rate = _function("dJointGetHingeAngle", REAL, ID), _function("dJointGetHingeAngleRate", REAL, ID)
slider_place = _function("dJointGetSliderPosition", REAL, ID)
slider_rate = _function("dJointGetSliderPositionRate", REAL, ID)
add_force = _function("dBodyAddForce", types.void, ID, REAL, REAL, REAL)
point_velocity = _function("dBodyGetPointVel", types.void, ID, REAL, REAL, REAL, ID)
body_of = _function("dGeomGetBody", ID, ID)
collide = _function("dCollide", types.intc, ID, ID, types.intc, ID, types.intc)
collide_all = _function("dSpaceCollide2", types.void, ID, ID, ID, ID)
make_contact = _function("dJointCreateContact", ID, ID, ID, ID)
attach = _function("dJointAttach", types.void, ID, ID, ID)
set_feedback = _function("dJointSetFeedback", types.void, ID, ID)
remove_all = _function("dJointGroupEmpty", types.void, ID)
solve, sweep = _function("dWorldStep", types.intc, ID, REAL), _function("dWorldQuickStep", types.intc, ID, REAL)


def new_block() -> Block:
    """Return empty memory."""
    numbers = np.zeros(BLOCK)
    words = numbers.view(np.int64)
    words[SELF], words[MEET] = numbers.ctypes.data, _compiled_meet().address
    return words, numbers


@cache
def _compiled_meet() -> Any:
    # Not while the module is imported, since that takes seconds at first.
    return cfunc(types.void(types.voidptr, ID, ID), cache=True)(meet)


@njit(cache=True)
def sliding(words: NDArray[np.int64], numbers: Array, first: int, second: int, at: int) -> float:
    """Return how fast one body slides on the other at a contact [m/s], and write along which direction there.

    Args:
        words: The block.
        numbers: The same.
        first: A body; 0 for what is fixed.
        second: The other one.
        at: Where the contact is in the block.
    """
    sign = -1.0
    if first == 0:
        first, second = second, 0
    px, py, pz = numbers[at + POSITION], numbers[at + POSITION + 1], numbers[at + POSITION + 2]
    d = at + DIRECTION
    where = words[SELF] + 8 * d
    point_velocity(first, px, py, pz, where)
    x, y, z = numbers[d], numbers[d + 1], numbers[d + 2]
    if second == 0:
        # With what gravity adds in a step, a body that rests on a ramp has a direction as well.
        sign, vx, vy, vz = 1.0, numbers[FALL_X], numbers[FALL_Y], numbers[FALL_Z]
    else:
        point_velocity(second, px, py, pz, where)
        vx, vy, vz = numbers[d], numbers[d + 1], numbers[d + 2]
    x, y, z = x + sign * vx, y + sign * vy, z + sign * vz
    nx, ny, nz = numbers[at + NORMAL], numbers[at + NORMAL + 1], numbers[at + NORMAL + 2]
    closing = x * nx + y * ny + z * nz
    x, y, z = x - closing * nx, y - closing * ny, z - closing * nz
    speed = math.sqrt(x * x + y * y + z * z)
    if speed > SLIDING:
        numbers[d], numbers[d + 1], numbers[d + 2] = x / speed, y / speed, z / speed
    return speed


@njit(cache=True)
def deepest(numbers: Array, count: int) -> int:
    """Return which of the contacts that were found is the deepest, of equally deep ones the first."""
    best = 0
    for i in range(1, count):
        if numbers[CONTACTS + i * CONTACT + DEPTH] > numbers[CONTACTS + best * CONTACT + DEPTH]:
            best = i
    return best


def meet(block: Any, first: Any, second: Any) -> None:
    """Make the contacts of two shapes; ODE calls this for each pair that may touch."""
    words, numbers = carray(block, BLOCK, np.int64), carray(block, BLOCK, np.float64)
    found = collide(first, second, FOUND, words[SELF] + 8 * (CONTACTS + POSITION), 8 * CONTACT)
    first_body, second_body = body_of(first), body_of(second)
    if first_body == 0 and second_body == 0:
        return
    with_ball = first_body == words[BALL] or second_body == words[BALL]
    bounce = numbers[BALL_BOUNCE] if with_ball else numbers[ROBOT_BOUNCE]
    most = words[MOST]
    for number in range(min(found, most)):
        at = CONTACTS + CONTACT * (number if found <= most else deepest(numbers, found))
        mode = PLAIN
        numbers[at + MU], numbers[at + SOFT_ERP] = numbers[FRICTION], numbers[ERP]
        if with_ball or bounce > 0.0:
            mode |= WITH_BOUNCE
            numbers[at + BOUNCE], numbers[at + BOUNCE_VELOCITY] = bounce, numbers[SLOWEST_BOUNCE]
        if words[TURNED]:
            speed = sliding(words, numbers, first_body, second_body, at)
            if speed > SLIDING:
                mode |= WITH_DIRECTION
                if speed > numbers[STOPPED]:
                    mode |= WITH_MU2
                    numbers[at + MU2] = 0.0
        words[at + MODE] = mode
        joint = make_contact(words[WORLD], words[GROUP], words[SELF] + 8 * at)
        attach(joint, first_body, second_body)
        words[MADE] += 1
        numbers[at + DEPTH] = -math.inf  # the joint has a copy; this one is not chosen again
        if with_ball and words[TOUCHED] < ROOM:
            touch = TOUCHES + TOUCH * words[TOUCHED]
            words[TOUCHED] += 1
            words[touch + OTHER] = second if first_body == words[BALL] else first
            for axis in range(3):
                numbers[touch + PLACE + axis] = numbers[at + POSITION + axis]
                numbers[touch + ALONG + axis] = numbers[at + NORMAL + axis]
            set_feedback(joint, words[SELF] + 8 * (touch + FEEDBACK))


@njit(cache=True)
def read_joints(joints: NDArray[np.int64], offset: Array, angle: Array, velocity: Array) -> None:
    """Write joint angles [rad] and velocities [rad/s], and follow joints without limits beyond half a turn.

    Args:
        joints: Id of each, whether it slides, whether it has no limits, shape (J, 3).
        offset: What to add to ODE's angles, and ODE's angles at the last step [rad], shape (2, J).
        angle: Shape (J,).
        velocity: Shape (J,).
    """
    for j in range(len(joints)):
        joint = joints[j, 0]
        if joints[j, 1]:
            now, velocity[j] = slider_place(joint), slider_rate(joint)
        else:
            now, velocity[j] = hinge_angle(joint), hinge_rate(joint)
        if joints[j, 2] and abs(now - offset[1, j]) > math.pi:
            offset[0, j] += math.copysign(math.tau, offset[1, j] - now)
        offset[1, j] = now
        angle[j] = now + offset[0, j]


@njit(cache=True)
def step(
    words: NDArray[np.int64],
    numbers: Array,
    joints: NDArray[np.int64],
    offset: Array,
    angle: Array,
    velocity: Array,
    ball_velocity: Array,
    base_velocity: Array,
    base_spin: Array,
    joint_torque: Array,
    ball_force: Array,
    touched: Array,
) -> None:
    """Take a step, and write to `touched` something that is not 0 if the ball touched or something diverged."""
    words[TOUCHED] = words[MADE] = 0
    total = 0.0
    for speeds in (velocity, ball_velocity, base_velocity, base_spin, joint_torque, ball_force):
        for i in range(len(speeds)):
            total += abs(speeds[i])
    words[DIVERGED] = not total < LARGEST
    if not words[DIVERGED]:
        for j in range(len(joints)):
            # ODE forgets torques and forces after every step.
            if joints[j, 1]:
                add_slider_force(joints[j, 0], joint_torque[j])
            else:
                add_hinge_torque(joints[j, 0], joint_torque[j])
        add_force(words[BALL], ball_force[0], ball_force[1], ball_force[2])
        collide_all(words[ROBOT_SPACE], words[FIXED_SPACE], words[SELF], words[MEET])
        collide_all(words[BALL_SHAPE], words[FIXED_SPACE], words[SELF], words[MEET])
        collide_all(words[BALL_SHAPE], words[ROBOT_SPACE], words[SELF], words[MEET])
        if words[SWEEPS]:
            sweep(words[WORLD], numbers[TIMESTEP])
        else:
            solve(words[WORLD], numbers[TIMESTEP])
        remove_all(words[GROUP])
        read_joints(joints, offset, angle, velocity)
    touched[0] = words[TOUCHED] + words[DIVERGED]
