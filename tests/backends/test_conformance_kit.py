"""The kit itself: verdicts, what is asked for, and the helper for pytest."""

import subprocess
import sys
import warnings
from collections.abc import Iterator

import pytest

from imolo.config.model import Model
from imolo.conformance import Check, Limitation, Measurement, Verdict, run_check
from imolo.conformance.record import worst
from imolo.conformance.report import number, short
from imolo.conformance.suite import Suite, check_names, suites
from imolo.conformance.testing import BackendCheck, ConformanceWarning, assert_conforms, parametrize_checks
from imolo.contracts.backend import BackendPlugin
from imolo.errors import BackendNotFoundError, ConfigError


def check(*numbers: float, name: str = "scene") -> Check:
    """Return a check whose numbers should be 1 ± 0.1."""
    found = [Measurement(f"number {index}", "", 1.0, number, 0.1, "given") for index, number in enumerate(numbers)]
    return Check(name, "group", "A scene", lambda: found)


def breaks_off() -> Iterator[Measurement]:
    yield Measurement("number 0", "", 1.0, 1.0, 0.1, "given")
    raise AttributeError("no such thing")


LIMIT = Limitation("soft", {"scene": ["number 0"]})


@pytest.mark.parametrize(
    ("measured", "limitations", "exactly", "verdict", "remark"),
    [
        (1.09, (), True, Verdict.PASS, ""),
        (1.2, (), True, Verdict.FAIL, ""),
        (float("nan"), (), True, Verdict.FAIL, ""),
        (1.2, (LIMIT,), True, Verdict.UNSUPPORTED, "soft"),
        (1.0, (LIMIT,), True, Verdict.WARNING, "declared unsupported (soft), but it is within its tolerance"),
        (float("nan"), (LIMIT,), True, Verdict.FAIL, "declared unsupported (soft), but there is no number to report"),
        # Limitations are declared for the default options.
        (1.2, (LIMIT,), False, Verdict.UNSUPPORTED, "soft"),
        (1.0, (LIMIT,), False, Verdict.PASS, ""),
    ],
)
def test_verdict_weighs_the_number_and_the_declaration(
    measured: float, limitations: tuple[Limitation, ...], exactly: bool, verdict: Verdict, remark: str
) -> None:
    (outcome,) = run_check(check(measured), limitations, exactly)
    assert (outcome.verdict, outcome.remark) == (verdict, remark)


def test_declaration_of_what_is_not_measured_fails() -> None:
    stale = Limitation("soft", {"scene": ["number 7"]})
    passed, failed = run_check(check(1.0), [stale])
    assert (passed.verdict, failed.verdict) == (Verdict.PASS, Verdict.FAIL)
    assert "'number 7', which this check does not measure" in failed.remark
    assert len(run_check(check(1.0), [stale], exactly=False)) == 1


def test_one_declaration_names_all_that_one_cause_puts_out_of_tolerance() -> None:
    pyramid = Limitation("a pyramid", {"first": ["number 0", "number 2"], "second": ["number 0"]})
    first = run_check(check(0.7, 1.0, 1.4, name="first"), [pyramid])
    second = run_check(check(0.8, name="second"), [pyramid])
    assert [outcome.verdict.value for outcome in first] == ["unsupported", "pass", "unsupported"]
    assert [outcome.remark for outcome in [*first, *second]] == ["a pyramid", "", "a pyramid", "a pyramid"]


def test_what_python_warns_of_is_a_warning_and_the_numbers_stand() -> None:
    def warns() -> Iterator[Measurement]:
        for index in range(2):
            warnings.warn("out of date", DeprecationWarning, stacklevel=1)
            yield Measurement(f"number {index}", "", 1.0, 1.0, 0.1, "given")

    outcomes = run_check(Check("scene", "group", "A scene", warns), ())
    assert [outcome.verdict.value for outcome in outcomes] == ["pass", "pass", "warning"]
    assert outcomes[-1].remark.startswith("DeprecationWarning: out of date (test_conformance_kit.py:")


def test_warning_is_worse_than_unsupported_and_better_than_failed() -> None:
    measured = run_check(check(1.0, 1.0), [LIMIT]) + run_check(check(1.3), [LIMIT]) + run_check(check(2.0), ())
    ordered = sorted(measured, key=lambda outcome: list(Verdict).index(outcome.verdict))
    assert [outcome.verdict.value for outcome in ordered] == ["pass", "unsupported", "warning", "fail"]
    assert worst(ordered[:3]) is Verdict.WARNING


def test_check_that_measures_nothing_fails() -> None:
    (outcome,) = run_check(check(), ())
    assert (outcome.verdict, outcome.remark) == (Verdict.FAIL, "measures nothing")


def test_quantity_that_is_measured_twice_fails() -> None:
    twice = [Measurement("number", "", 1.0, 1.0, 0.1, "given")] * 2
    passed, failed = run_check(Check("scene", "group", "A scene", lambda: twice), ())
    assert (passed.verdict, failed.verdict, failed.remark) == (Verdict.PASS, Verdict.FAIL, "measures 'number' twice")


def test_any_error_is_a_failure_that_says_where() -> None:
    passed, failed = run_check(Check("scene", "group", "A scene", breaks_off), ())
    assert (passed.verdict, failed.verdict) == (Verdict.PASS, Verdict.FAIL)
    assert failed.remark.startswith("AttributeError: no such thing (test_conformance_kit.py:")


def suite(*checks: Check, limitations: tuple[Limitation, ...] = ()) -> Suite:
    """Return a suite of a backend that is not installed."""
    made = Suite("made", "made")
    plugin = BackendPlugin("made", Model, lambda *_: pytest.fail("not asked for"), lambda _: checks, limitations)
    # The place of a cached property.
    made.__dict__["plugin"] = plugin
    return made


def test_limitation_of_no_check_is_a_failure_with_the_nearest_name() -> None:
    (outcome,) = suite(check(1.0), limitations=(Limitation("soft", {"scnee": ["number 0"]}),)).misplaced()
    assert outcome.verdict is Verdict.FAIL
    assert outcome.remark.endswith("there is no such check; did you mean 'scene'?")


def test_checks_are_chosen_by_name_and_by_group() -> None:
    one = suite(check(1.0, name="first"), Check("second", "other", "Another", lambda: ()))
    assert one.select(()) == ["first", "second"]
    assert one.select(["first", "other"]) == ["first", "second"]
    assert one.select(["group"]) == ["first"]
    with pytest.raises(ConfigError, match="unknown check or group 'frist'; did you mean 'first'"):
        check_names(["frist"], [one])


def test_one_label_is_not_reported_twice() -> None:
    with pytest.raises(ConfigError, match="'mujoco' would be reported twice"):
        suites(["mujoco", "configs/mujoco.yaml"])


def test_failure_in_pytest_names_backend_scene_quantity_and_numbers() -> None:
    with pytest.raises(AssertionError) as failure:
        assert_conforms(BackendCheck(suite(check(1.0, 1.3)), "scene"))
    assert str(failure.value) == ("made scene: number 1: 1.3 instead of 1 ± 0.1 (3 × the tolerance: given)")


def test_helper_makes_one_test_per_check_with_a_readable_name() -> None:
    mark = parametrize_checks("mujoco", "dart", only=["clock", "free_fall"]).mark
    assert mark.args[0] == "check"
    ids = [parameters.id for parameters in mark.args[1]]
    assert ids == ["mujoco-clock", "mujoco-free_fall", "dart-clock", "dart-free_fall"]


def test_warning_in_pytest_is_a_warning_and_no_failure() -> None:
    stale = suite(check(1.0), limitations=(LIMIT,))
    with pytest.warns(ConformanceWarning, match="made scene: number 0: 1 instead of 1 .*declared unsupported"):
        assert_conforms(BackendCheck(stale, "scene"))


@parametrize_checks("mujoco", only=["free_fall"])
def test_helper_runs_the_check(check: BackendCheck) -> None:
    assert [outcome.verdict for outcome in check.run()] == [Verdict.PASS] * 3
    assert_conforms(check)


def test_helper_refuses_what_is_not_there() -> None:
    with pytest.raises(BackendNotFoundError, match="did you mean 'mujoco'"):
        parametrize_checks("mujco")
    with pytest.raises(ConfigError, match="did you mean 'free_fall'"):
        parametrize_checks("mujoco", only=["free_fal"])
    with pytest.raises(ConfigError, match="needs the name of a backend"):
        parametrize_checks()


@pytest.mark.parametrize(
    ("value", "tolerance", "text"),
    [
        (18.7725, 1e-9, "18.7725"),
        (0.62345, 0.01, "0.623"),
        (3.1234e-13, 1e-9, "3.1e-13"),
        (0.0, 0.0, "0"),
        (12345.678, 1.0, "12345.7"),
        (float("nan"), 0.1, "nan"),
    ],
)
def test_numbers_have_the_digits_that_the_tolerance_makes_matter(value: float, tolerance: float, text: str) -> None:
    assert number(value, tolerance) == text


def test_exponents_have_no_idle_digits() -> None:
    assert (short(1e-9), short(4400.0), short(0.25)) == ("1e-9", "4.4e3", "0.25")


def test_the_kit_knows_no_robot_but_its_own() -> None:
    code = "import sys, imolo_backends.conformance; print([name for name in sys.modules if 'imolo_robots' in name])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.strip() == "[]"
