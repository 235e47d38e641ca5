"""What the checks do not measure of motors."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from imolo_backends.actuators.motors import Motor, Motors, MotorsConfig

TIMESTEP = 1e-3  # [s]
SPEED = 2.0  # [rad/s]


@pytest.mark.parametrize("behind", [0.0, 0.01, -0.02])
def test_joint_that_moves_with_its_target_is_pulled_by_what_it_is_behind_alone(behind: float) -> None:
    """The law knows the speed of the target, so that damping brakes no motion that is wanted; both ways."""
    motor = Motor(name="elbow", stiffness=30.0, damping=4.0, torque_limit=100.0, speed_limit=SPEED, low=-1.0, high=1.0)
    for direction in (1.0, -1.0):
        motors = Motors(MotorsConfig(motors=(motor,)), TIMESTEP, np.zeros(1), np.zeros(1), np.ones(1))
        motors.target[:] = direction
        for step in range(1, 20):
            at = direction * SPEED * TIMESTEP * step
            motors.step(np.array([at - behind]), np.array([direction * SPEED]))
            assert_allclose(motors.joint_torque, [30.0 * behind], rtol=0.0, atol=1e-10)
