"""What `imolo check wrapped` says, as tests."""

from imolo.conformance.testing import BackendCheck, assert_conforms, parametrize_checks


@parametrize_checks("wrapped")
def test_conformance(check: BackendCheck) -> None:
    """The engine does what it says."""
    assert_conforms(check)
