"""Every engine gives what the conformance kit knows to be true, or declares with its reason that it does not."""

import pytest
from requirements import AVAILABLE, BACKEND_PARAMS

from imolo.conformance.suite import Suite
from imolo.conformance.testing import BackendCheck, assert_conforms, parametrize_checks
from imolo.contracts.registry import BACKENDS
from imolo_backends.conformance import SCENES


@pytest.mark.parametrize("name", BACKEND_PARAMS)
def test_the_engine_is_there_to_be_checked(name: str) -> None:
    assert BACKENDS.status(name).problem == ""


@parametrize_checks(*AVAILABLE)
def test_an_engine_gives_the_truth_or_declares_what_it_cannot(check: BackendCheck) -> None:
    assert_conforms(check)


@parametrize_checks(Suite("rk4", "mujoco", {"integrator": "rk4"}), only=["free motion", "joints"])
def test_smooth_motions_hold_for_the_fourth_order_integrator(check: BackendCheck) -> None:
    assert_conforms(check)


def test_the_names_of_checks_are_unique() -> None:
    names = [scene.__name__ for scene in SCENES]
    assert len(set(names)) == len(names)
