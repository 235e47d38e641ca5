"""How MuJoCo's soft contacts are made to bounce."""

import numpy as np


def damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a spring-damper contact that can only push and bounces with this restitution.

    A ratio of sin(a) bounces with exp(-(pi - 2 a) tan(a)); see Schwager and Pöschel, Granular Matter 9, 465 (2007).
    Below .135, which is critical damping, the ratio stays 1.
    """
    angle = np.linspace(0.0, 0.5 * np.pi, 2001)[:-1]
    bounce = np.exp(-(np.pi - 2.0 * angle) * np.tan(angle))
    return float(np.sin(np.interp(-restitution, -bounce, angle, right=0.5 * np.pi)))


def bouncing_solref(frequency: float, restitution: float, timestep: float) -> tuple[float, float]:
    """Return the `solref` of contacts of a natural frequency [rad/s] that bounce."""
    # Ten steps per radian keep the explicit damper stable. Negative numbers are stiffness and damping per mass.
    frequency = min(frequency, 0.2 / timestep)
    return -(frequency**2), -2.0 * damping_ratio(restitution) * frequency
