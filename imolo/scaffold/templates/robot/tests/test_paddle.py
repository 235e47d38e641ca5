"""What `imolo check --robot paddle mujoco` says, as tests."""

from imolo.conformance.robot_suite import robot_suites
from imolo.conformance.testing import BackendCheck, assert_conforms, parametrize_checks


@parametrize_checks(*robot_suites("paddle", ["mujoco"]))
def test_conformance(check: BackendCheck) -> None:
    """The robot is as it says."""
    assert_conforms(check)
