"""The capability page docs/engines.md holds; where it does not, the failure names the number and the command."""

from dataclasses import replace
from pathlib import Path

import pytest

from imolo.conformance import Measurement, Outcome, Verdict
from imolo.conformance.page import counterpart, differences, render_page, write_page
from imolo.conformance.record import Record, load_records, record
from imolo.conformance.runner import run_suites
from imolo.conformance.suite import suites
from imolo.contracts.registry import BACKENDS
from imolo.errors import ResultsError

REQUIRED = ("dart", "mujoco", "pybullet")
PAGE = Path(__file__).parents[2] / "docs" / "engines.md"
COMMAND = "imolo check --page docs/engines.md"


@pytest.fixture(scope="module")
def recorded() -> dict[str, Record]:
    return {one.label: one for one in load_records(counterpart(PAGE))}


def test_every_required_engine_is_on_the_page(recorded: dict[str, Record]) -> None:
    assert set(recorded) >= set(REQUIRED)


def test_page_is_what_its_numbers_say(recorded: dict[str, Record]) -> None:
    page = render_page(list(recorded.values()), Path("docs/engines.md"))
    assert PAGE.read_text(encoding="utf-8") == page, f"run `{COMMAND}`"


def test_nothing_on_the_page_has_failed_or_is_a_warning(recorded: dict[str, Record]) -> None:
    fine = (Verdict.PASS, Verdict.UNSUPPORTED)
    assert [(one.label, o.check) for one in recorded.values() for o in one.outcomes if o.verdict not in fine] == []


@pytest.mark.slow
def test_numbers_on_the_page_are_measured_again(recorded: dict[str, Record]) -> None:
    """Measure all engines of the page that are installed; a required one that is not is an error."""
    chosen = suites([label for label in recorded if label in REQUIRED or BACKENDS.status(label).plugin is not None])
    outcomes = run_suites(chosen, jobs=2)
    now = [record(suite, outcomes[suite.label]) for suite in chosen]
    changed = [line for one in now for line in differences(recorded[one.label], one)]
    assert changed == [], "\n".join([f"docs/engines.md no longer holds; run `{COMMAND}` and look at:", *changed])


# What counts as a difference, and what a page keeps.


def outcome(
    measured: float = 0.62, tolerance: float = 0.01, verdict: Verdict = Verdict.UNSUPPORTED, truth: float = 0.8
) -> Outcome:
    number = Measurement("mu got", "", truth, measured, tolerance, "given")
    return Outcome("slide", "friction", "A box slides", verdict, number, "a pyramid")


def made(*outcomes: Outcome, label: str = "one") -> Record:
    return Record(label, label, {}, {}, outcomes)


@pytest.mark.parametrize(
    ("measured", "tolerance"),
    # By a thousandth of itself, and by a tenth of the tolerance.
    [(0.62 * 1.0009, 1e-6), (0.62 * 0.9991, 1e-6), (0.6209, 0.01), (0.6191, 0.01)],
)
def test_number_that_moves_less_than_the_page_tells_still_holds(measured: float, tolerance: float) -> None:
    before, after = outcome(tolerance=tolerance), outcome(measured, tolerance)
    assert differences(made(before), made(after)) == []


@pytest.mark.parametrize(
    ("now", "parts"),
    [
        (outcome(0.6212), ("0.62 of 0.8 ± 0.01", "0.6212 of 0.8")),
        (outcome(verdict=Verdict.FAIL), ("unsupported", "fail")),
        (outcome(truth=0.9), ("of 0.8", "of 0.9")),
        (outcome(tolerance=0.02), ("± 0.01", "± 0.02")),
        (outcome(float("nan")), ("nan",)),
        (replace(outcome(), remark="soft"), ("a pyramid", "soft")),
        (replace(outcome(), measurement=None), ("slide", "no longer measured")),
    ],
)
def test_what_changed_is_told_with_both_numbers(now: Outcome, parts: tuple[str, ...]) -> None:
    told = "\n".join(differences(made(outcome()), made(now)))
    assert told.startswith("one, slide, mu got: ")
    assert all(part in told for part in parts)


def test_numbers_that_come_and_go_are_told() -> None:
    other = replace(outcome(), check="roll")
    assert differences(made(outcome()), made(outcome(), other))[0].startswith("one, roll, mu got: measured")
    assert differences(made(outcome(), other), made(outcome())) == [
        "one, roll, mu got: on the page, but no longer measured"
    ]


def test_engine_that_was_not_checked_stays_on_the_page(tmp_path: Path) -> None:
    page = tmp_path / "engines.md"
    write_page(page, [made(outcome(), label="old"), made(outcome(), label="both")])
    write_page(page, [made(outcome(0.7), label="both")])
    kept = {one.label: one.outcomes for one in load_records(counterpart(page))}
    assert kept == {"old": (outcome(),), "both": (outcome(0.7),)}
    assert "| `slide` | mu got | 0.8 | **0.7** | **0.62** |" in page.read_text(encoding="utf-8")


def test_records_survive_being_saved(tmp_path: Path) -> None:
    broken = Outcome("crash", "friction", "A crash", Verdict.FAIL, None, "died")
    infinite = outcome(float("inf"), verdict=Verdict.FAIL)
    before = Record("mine", "mujoco", {"integrator": "rk4"}, {"mujoco": "4"}, (outcome(), broken, infinite))
    write_page(tmp_path / "page.md", [before])
    assert load_records(tmp_path / "page.json") == [before]


def test_file_that_holds_no_numbers_is_refused(tmp_path: Path) -> None:
    (tmp_path / "page.json").write_text("[1]", encoding="utf-8")
    with pytest.raises(ResultsError, match="does not hold what `imolo check` wrote"):
        write_page(tmp_path / "page.md", [])


def test_page_says_once_why_for_all_quantities_of_one_cause() -> None:
    pyramid = [outcome(), replace(outcome(), check="roll")]
    soft = replace(outcome(), check="rest", remark="soft")
    page = render_page([made(pyramid[0], soft, pyramid[1])], Path("page.md"))
    rows = [line.split(" | ")[1:3] for line in page.partition("## Limitations")[2].splitlines() if "`" in line]
    assert rows == [["a pyramid", "`slide`"], ["", "`roll`"], ["soft", "`rest`"]]
