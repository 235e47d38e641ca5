"""Articulated bodies: torques, pendulums, and the robot as a mechanism."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.special import ellipk

from imolo.conformance import Measurement
from imolo.contracts.engine import Array, EngineState, Scene
from imolo_backends.conformance.bodies import (
    GRAVITY,
    JOINT_LIMITS,
    JOINT_NAMES,
    ROD_INERTIA,
    ROD_LENGTH,
    ROD_MASS,
    WEIGHTLESS,
    flying_robot,
    pendulum_scene,
)
from imolo_backends.conformance.reference import Mechanism, double_pendulum_angles, rotation_of
from imolo_backends.conformance.subject import ROUNDING, Errors, Run, SceneCheck, Subject, at_timestep

ROD_ABOUT_END = ROD_INERTIA + 0.25 * ROD_MASS * ROD_LENGTH**2  # [kg m²]
ROD_WEIGHT = 0.5 * ROD_MASS * GRAVITY * ROD_LENGTH  # [N·m] about the pivot, of a level rod
# Left and right differ, so that nothing is hidden by symmetry.
CROOKED = JOINT_LIMITS.mean(axis=1) + np.array([0.3, -0.2, 0.1, -0.4, 0.5, -0.2, 0.6, -0.3])  # [rad]

SOFTEST_STOP = 0.002  # [s] time constant of the softest stop that counts as one, critically damped


def joint_torque(subject: Subject) -> Iterator[Measurement]:
    """A torque turns a weightless rod on a stand, and a free pair of bodies against each other."""
    torque, duration, timestep = np.array([0.2]), 0.5, 5e-4
    scene = replace(pendulum_scene(), gravity=WEIGHTLESS)
    state = subject.final_state(at_timestep(scene, timestep), duration, torque)
    acceleration = float(torque[0]) / ROD_ABOUT_END
    lead = timestep if subject.order == 1 else 0.0
    angle = 0.5 * acceleration * duration * (duration + lead)
    velocity = acceleration * duration
    moved = float(np.abs(state.link_position[0] - scene.base_position).max())
    yield Measurement("velocity", "rad/s", velocity, float(state.joint_velocity[0]), ROUNDING, "τ t / I, rounding")
    yield Measurement(
        "angle", "rad", angle, float(state.joint_angle[0]), ROUNDING, "½ τ t² / I and ½ τ t dt / I more (order 1)"
    )
    yield Measurement("way of the stand", "m", 0.0, moved, ROUNDING, "it is fixed; single precision")

    free = replace(scene, fixed_base=False, base_position=(0.0, 0.0, 2.0))
    mechanism = Mechanism(free)

    def errors(run: Run) -> Errors:
        start = mechanism.center_of_mass(run.engine.read())
        window = run.window(duration, torque)
        momentum = mechanism.angular_momentum(window)
        return {
            "COM of the free pair [m]": (mechanism.center_of_mass(window[2]) - start, ROD_LENGTH),
            "angular momentum of the free pair [kg m²/s]": (momentum, float(torque[0]) * duration),
        }

    # At the end the two turn against each other with 10 rad/s.
    yield from subject.converge(free, 10.0, duration, errors)


def turns(subject: Subject) -> Iterator[Measurement]:
    """A joint without limits counts its turns, from wherever it starts."""
    torque, duration, timestep = 1.0, 3.0, 1e-3
    scene = at_timestep(replace(pendulum_scene(), gravity=WEIGHTLESS), timestep)
    lead = timestep if subject.order == 1 else 0.0
    for start in (0.0, 7.0, -7.0):
        way = float(np.copysign(0.5 * torque / ROD_ABOUT_END * duration * (duration + lead), start))
        from_start = replace(scene, joint_angle=(start,))
        state = subject.final_state(from_start, duration, np.array([np.copysign(torque, start)]))
        measured = float(state.joint_angle[0])
        yield Measurement(f"angle from {start:g} on", "rad", start + way, measured, 1e-4 * abs(way), "½ τ t² / I")


def spinning_joint(subject: Subject) -> Iterator[Measurement]:
    """A spinning rod keeps its speed for 10 s."""
    speed, timestep = 5.0, 1e-3
    scene = at_timestep(replace(pendulum_scene(), gravity=WEIGHTLESS), timestep)
    with subject.run(scene) as run:
        run.advance(timestep, np.array([speed * ROD_ABOUT_END / timestep]))
        state = run.advance(10.0)
    measured, tolerance = float(state.joint_velocity[0]), subject.rounding(speed, 10000, ROUNDING)
    yield Measurement("velocity", "rad/s", speed, measured, tolerance, "nothing brakes it; rounding of 10000 steps")


def rod_pendulum(subject: Subject) -> Iterator[Measurement]:
    """A rod released level swings for 20 s."""
    duration = 20.0
    frequency = float(np.sqrt(ROD_WEIGHT / ROD_ABOUT_END))  # [rad/s] of small swings
    timestep = subject.timesteps[0]
    scene = at_timestep(replace(pendulum_scene(), joint_angle=(0.5 * np.pi,)), timestep)
    with subject.run(scene) as run:
        angle, velocity = (part[:, 0] for part in run.joint_motion(duration))
    crossings = np.flatnonzero((angle[:-1] > 0.0) & (angle[1:] <= 0.0))
    crossed = crossings + angle[crossings] / (angle[crossings] - angle[crossings + 1])
    period = float(crossed[-1] - crossed[0]) / (len(crossed) - 1) * timestep
    exact = 4.0 / frequency * float(ellipk(np.sin(0.25 * np.pi) ** 2))
    step = frequency * timestep
    yield Measurement(
        "period",
        "s",
        exact,
        period,
        exact * step ** max(2, subject.order),
        "elliptic integral; the phase is right to (w dt)² (order 1, which is Störmer-Verlet here) or (w dt)⁴",
    )
    energy = 0.5 * ROD_ABOUT_END * velocity**2 - ROD_WEIGHT * np.cos(angle)
    if subject.order == 1:
        # Semi-implicit Euler conserves H - ½ dt H_q H_p (backward error analysis) up to dt²; here H_q H_p is at most
        # W² sqrt(2 cos q / I W) sin q, largest where tan² q = 2.
        cosine, sine = np.sqrt(1.0 / 3.0), np.sqrt(2.0 / 3.0)
        swing = 0.5 * ROD_WEIGHT * float(np.sqrt(2.0 * cosine) * sine) * step
        largest = float(np.abs(energy).max())
        yield Measurement("swing of the energy", "J", swing, largest, 2.0 * step * swing, "½ dt |H_q H_p|, next order")
        energy = energy - 0.5 * timestep * ROD_WEIGHT * np.sin(angle) * velocity
    yield Measurement(
        "energy that is conserved, largest change",
        "J",
        0.0,
        float(np.abs(energy).max()),
        ROD_WEIGHT * (step**2 if subject.order == 1 else duration * frequency * step ** (subject.order + 1)),
        "H - ½ dt H_q H_p up to dt² (order 1), H up to t dt⁵ (order 4)",
    )


def double_pendulum(subject: Subject) -> Iterator[Measurement]:
    """Two rods swing for 2 s."""
    duration, start = 2.0, (2.2, -1.0)
    truth = double_pendulum_angles(start, duration)
    scene = replace(pendulum_scene(rods=2), joint_angle=start)

    def errors(run: Run) -> Errors:
        return {"joint angles [rad]": (run.advance(duration).joint_angle - truth, 1.0)}

    # The faster of the two modes.
    yield from subject.converge(scene, 10.0, duration, errors)


def mass_matrix(subject: Subject) -> Iterator[Measurement]:
    """From rest, a step under the torque of one joint gives the robot what the mass matrix says."""
    timestep, torque = 1e-4, 0.3
    scene = flying_robot(timestep=timestep, gravity=WEIGHTLESS, joint_angle=tuple(CROOKED.tolist()))
    matrix = Mechanism(scene).mass_matrix(CROOKED, np.eye(3))
    inverse = np.linalg.inv(matrix)[6:, 6:]
    tolerance = subject.rounding(float(np.linalg.cond(matrix)), least=ROUNDING)
    for joint, name in enumerate(JOINT_NAMES):
        response = subject.final_state(scene, timestep, torque * np.eye(8)[joint]).joint_velocity / (torque * timestep)
        error = float(np.abs(response - inverse[joint]).max() / inverse[joint, joint])
        basis = "M⁻¹ from the URDF, relative to its diagonal; COMs in single precision, or its condition times rounding"
        yield Measurement(f"response to {name}, largest error", "", 0.0, error, tolerance, basis)


def robot_drop(subject: Subject) -> Iterator[Measurement]:
    """The robot falls and turns while its joints work."""
    duration = 0.3
    torque = np.array([0.1, -0.06, 0.01, -0.05, 0.05, -0.004, 0.05, -0.08])  # no joint meets a stop
    scene = flying_robot(
        joint_angle=tuple(CROOKED.tolist()),
        base_position=(0.0, 0.0, 3.0),
        base_velocity=(0.5, -0.3, 1.0),
        base_angular_velocity=(0.5, 1.0, -0.7),
    )
    mechanism = Mechanism(scene)

    def errors(run: Run) -> Errors:
        first = run.engine.read()
        velocity, momentum = _locked_motion(mechanism, first, run.scene)
        lead = run.scene.timestep if subject.order == 1 else 0.0
        fall = 0.5 * np.array(run.scene.gravity) * duration * (duration + lead)
        window = run.window(duration, torque)
        moved = mechanism.center_of_mass(window[2]) - mechanism.center_of_mass(first)
        return {
            "COM [m]": (moved - velocity * duration - fall, float(np.linalg.norm(moved))),
            "angular momentum about the COM [kg m²/s]": (
                mechanism.angular_momentum(window) - momentum,
                float(np.linalg.norm(momentum)),
            ),
        }

    # The ankles turn fastest.
    yield from subject.converge(scene, 10.0, duration, errors)


def _locked_motion(mechanism: Mechanism, state: EngineState, scene: Scene) -> tuple[Array, Array]:
    """Return velocity of the COM and angular momentum about it, both (3,), while the joints stand still."""
    twist = np.array([*scene.base_velocity, *scene.base_angular_velocity])
    momentum = mechanism.mass_matrix(state.joint_angle, rotation_of(state))[:6, :6] @ twist
    lever = mechanism.center_of_mass(state) - state.link_position[0]
    return momentum[:3] / mechanism.mass, momentum[3:] - np.cross(lever, momentum[:3])


def joint_limits(subject: Subject) -> Iterator[Measurement]:
    """Each joint is driven into both of its stops."""
    approach, speed, timestep, duration = 0.05, 2.0, 1e-4, 0.1
    acceleration = 0.5 * speed**2 / approach
    scene = flying_robot(timestep=timestep, gravity=WEIGHTLESS, fixed_base=True)
    middle = JOINT_LIMITS.mean(axis=1)
    mechanism = Mechanism(scene)
    found = []
    for joint in range(len(JOINT_NAMES)):
        for side, sign in ((0, -1.0), (1, 1.0)):
            start = middle.copy()
            start[joint] = JOINT_LIMITS[joint, side] - sign * approach
            response = np.linalg.inv(mechanism.mass_matrix(start, np.eye(3))[6:, 6:])[joint, joint]
            torque = np.eye(8)[joint] * sign * acceleration / response
            with subject.run(replace(scene, joint_angle=tuple(start.tolist()))) as run:
                angle, velocity = (sign * part[:, joint] for part in run.joint_motion(duration, torque))
            beyond = angle - sign * JOINT_LIMITS[joint, side]
            hit = int(np.argmax(velocity))
            found.append((beyond.max(), -velocity[hit:].min() / velocity.max(), abs(beyond[-1])))
    overshoot, rebound, gap = np.max(found, axis=0).tolist()
    give = acceleration * SOFTEST_STOP**2
    basis = "½ v T + α T², T = 2 ms; critical damping: v T / e"
    yield Measurement("overshoot", "rad", 0.0, overshoot, 0.5 * speed * SOFTEST_STOP + give, basis)
    basis = "what gives back a fifth of the error per step; critical damping: e⁻²"
    yield Measurement("rebound over impact", "", 0.0, rebound, 0.2, basis)
    yield Measurement("distance held", "rad", 0.0, gap, give, "α T², T = 2 ms")


SCENES: tuple[SceneCheck, ...] = (
    joint_torque,
    turns,
    spinning_joint,
    rod_pendulum,
    double_pendulum,
    mass_matrix,
    robot_drop,
    joint_limits,
)
