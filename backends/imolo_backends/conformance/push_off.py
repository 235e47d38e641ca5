"""The robot pushes itself off by its own contacts: how rigid and how quick these are."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from imolo.conformance import Measurement
from imolo.contracts.engine import Array
from imolo_backends.conformance.bodies import (
    CONTACT_TIME,
    CONTACT_TIMESTEP,
    GRAVITY,
    LEG_COM,
    LEG_INERTIA,
    LEG_LENGTH,
    LEG_MASS,
    SOLE_RADIUS,
    TRUNK_MASS,
    straddling_scene,
)
from imolo_backends.conformance.reference import Mechanism
from imolo_backends.conformance.subject import Errors, Run, SceneCheck, Subject

SPLAY = 1.0  # [rad] of each leg from the vertical at the start
TORQUE = 25.0  # [N·m] that closes each leg
IN_CONTACT, IN_FLIGHT = 0.03, 0.16  # [s] the feet leave the floor in between
MASS = TRUNK_MASS + 2.0 * LEG_MASS


def _inertia(splay: float) -> tuple[float, float]:
    """Return the inertia I of the splay while the feet stand [kg m²], and dI/dsplay."""
    rising = TRUNK_MASS * LEG_LENGTH**2 + 2.0 * LEG_MASS * (LEG_LENGTH - LEG_COM) ** 2
    sideways = 2.0 * LEG_MASS * LEG_COM**2
    sine, cosine = np.sin(splay), np.cos(splay)
    value = rising * sine**2 + sideways * cosine**2 + 2.0 * LEG_INERTIA
    return float(value), float(2.0 * (rising - sideways) * sine * cosine)


def _lever() -> float:
    """Return d(COM height)/d(cos splay) times the mass while the feet stand [kg m]."""
    return TRUNK_MASS * LEG_LENGTH + 2.0 * LEG_MASS * (LEG_LENGTH - LEG_COM)


def _rates(_: float, state: Array) -> Array:
    """Lagrange's equation of the splay: I a + ½ I' w² - g lever sin(splay) = -2 torque."""
    splay, rate = state
    inertia, slope = _inertia(splay)
    force = -2.0 * TORQUE - 0.5 * slope * rate**2 + GRAVITY * _lever() * np.sin(splay)
    return np.array([rate, force / inertia])


def _normal_force(time: float, state: Array) -> float:
    """Return the normal force of all feet [N]."""
    splay, rate = state
    rise = -_lever() * (np.cos(splay) * rate**2 + np.sin(splay) * _rates(time, state)[1])
    return float(MASS * GRAVITY + rise)


def push_off_truth() -> tuple[float, float, float]:
    """Return the trunk's height at `IN_CONTACT`, the COM's rise at `IN_FLIGHT` [m], and the hardest push [m/s²]."""
    lift_off: Any = lambda time, state: _normal_force(time, state)  # noqa: E731 (solve_ivp wants an attribute on it)
    lift_off.terminal = True
    solution = solve_ivp(
        _rates, (0.0, 1.0), [SPLAY, 0.0], method="DOP853", rtol=1e-12, atol=1e-12, events=lift_off, dense_output=True
    )
    splay, rate = solution.y[:, -1]
    flight = IN_FLIGHT - float(solution.t[-1])
    climb = -_lever() / MASS * float(np.sin(splay) * rate)
    rise = _lever() / MASS * float(np.cos(splay) - np.cos(SPLAY)) + climb * flight - 0.5 * GRAVITY * flight**2
    pushes = [_normal_force(t, state) for t, state in zip(solution.t, solution.y.T, strict=True)]
    height = SOLE_RADIUS + LEG_LENGTH * float(np.cos(solution.sol(IN_CONTACT)[0]))
    return height, rise, max(pushes) / MASS


def push_off(subject: Subject) -> Iterator[Measurement]:
    """Two legs, splayed on a floor without friction, close and throw the body up."""
    height, rise, push = push_off_truth()
    scene = straddling_scene(SPLAY)
    mechanism = Mechanism(scene)
    torque = np.full(2, -TORQUE)

    def standing(run: Run) -> Errors:
        state = run.advance(IN_CONTACT, torque)
        soles = state.link_position[1:, 2] + state.link_rotation[1:, 2] @ [0.0, 0.0, -LEG_LENGTH] - SOLE_RADIUS
        return {
            "place of the trunk while it stands [m]": (state.link_position[0] - [0.0, 0.0, height], rise),
            "height of the soles [m]": (soles, rise),
        }

    def flying(run: Run) -> Errors:
        start = mechanism.center_of_mass(run.engine.read())
        risen = mechanism.center_of_mass(run.advance(IN_FLIGHT, torque)) - start
        return {"rise of the COM in flight [m]": (risen - [0.0, 0.0, rise], rise)}

    # The legs close with up to 10 rad/s. Where the soles leave the floor, a step of push may be lost or given twice.
    rate, soft = 10.0, push * CONTACT_TIME**2
    late = push * CONTACT_TIMESTEP * (IN_FLIGHT - IN_CONTACT)
    yield from subject.converge_in_contact(scene, rate, IN_CONTACT, standing, soft)
    yield from subject.converge_in_contact(scene, rate, IN_FLIGHT, flying, soft + late)


SCENES: tuple[SceneCheck, ...] = (push_off,)
