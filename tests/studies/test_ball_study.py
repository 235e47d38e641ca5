"""`imolo ball`: models rated on flights that nobody here made, and on made-up ones."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from imolo.ball.evaluation import PROTOCOLS, leave_one_out
from imolo.ball.fit import fit_ball_model
from imolo.ball.flight_file import read_flights
from imolo.ball.model import BallModelConfig
from imolo.ball.prediction import prediction_errors
from imolo.command_line.main import main
from imolo.errors import ConfigError, TrainingDataError
from imolo.studies.ball_study import parse_horizons, parse_models

REAL = Path(__file__).parents[1] / "data" / "ball_flights"
MANY, FEW = REAL / "aimy_robot_simple_0-23.csv", REAL / "aimy_mn5008_no_spin_0-4.csv"
QUICK = BallModelConfig(kind="spin", acceleration_density=3e-3)


@pytest.mark.slow
def test_real_flights_are_predicted_within_the_targets() -> None:
    # Issue 4: mean over the 24 flights, each predicted with a model of the 23 others.
    flights = read_flights(MANY, 0.3).flights
    assert len(flights) == 24
    targets = {0.1: 0.006, 0.2: 0.011, 0.3: 0.017, 0.4: 0.027}
    result = leave_one_out(MANY.name, flights, {}, [BallModelConfig(kind="spin")], list(targets), jobs=2)
    rated = {r.horizon: r for r in result.ratings if r.protocol == "last point"}
    for horizon, target in targets.items():
        assert rated[horizon].count == 24
        assert rated[horizon].mean <= target
        assert 0.5 <= rated[horizon].nees <= 1.5
        # 24 flights: the share in the 95 % ellipsoid has a standard deviation of 4 %.
        assert rated[horizon].inside >= 0.80


def test_rating_is_leave_one_out_by_hand() -> None:
    flights = read_flights(FEW, 0.3).flights
    result = leave_one_out("five", flights, {}, [QUICK], (0.2,))
    assert result.flights == tuple("01234")
    expected, normalised = [], []
    for name, flight in flights.items():
        model = fit_ball_model([other for label, other in flights.items() if label != name], QUICK)
        errors, covariances = prediction_errors(model, flight, 0.2, 0.0)
        expected.append(np.linalg.norm(errors[-1]))
        normalised.append(errors[-1] @ np.linalg.inv(covariances[-1]) @ errors[-1] / 3.0)
    assert result.distances["spin"]["0.2"] == pytest.approx(expected, rel=1e-12)
    (last,) = (r for r in result.ratings if r.protocol == "last point")
    assert (last.mean, last.count) == (pytest.approx(np.mean(expected), rel=1e-12), 5)
    assert last.nees == pytest.approx(np.mean(normalised), rel=1e-9)


def test_nothing_of_the_tested_flight_reaches_its_own_prediction() -> None:
    # The last sample is moved by a metre: what was predicted for it stays where it was.
    flights = dict(read_flights(FEW, 0.3).flights)
    before = leave_one_out("five", flights, {}, [QUICK], (0.2,)).distances["spin"]["0.2"][0]
    first = flights["0"]
    moved = first.position.copy()
    moved[-1] += (0.0, 1.0, 0.0)
    flights["0"] = type(first)(first.time, moved)
    after = leave_one_out("five", flights, {}, [QUICK], (0.2,)).distances["spin"]["0.2"][0]
    assert after is not None
    assert before is not None
    assert abs(after - 1.0) <= before


def test_lead_time_longer_than_the_flights_is_left_out_of_the_table() -> None:
    result = leave_one_out("five", read_flights(FEW, 0.3).flights, {}, [QUICK], (0.2, 3.0))
    assert {(r.protocol, r.horizon) for r in result.ratings} == {(protocol, 0.2) for protocol in PROTOCOLS}
    assert result.distances["spin"]["3"] == (None,) * 5


def test_too_few_flights_say_why_the_others_were_left_out() -> None:
    flights = dict(list(read_flights(FEW, 0.3).flights.items())[:3])
    with pytest.raises(TrainingDataError, match=r"3 usable flights.*needs 4.*'7' was left out: too short"):
        leave_one_out("file.csv", flights, {"7": "too short"}, [QUICK], (0.2,))


@pytest.mark.parametrize(("text", "message"), [("linear,dragg", "did you mean 'drag'"), (" , ", "no ball model")])
def test_unknown_models_are_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_models(text)


@pytest.mark.parametrize("text", ["0.1,x", "0", "-0.2", "nan", "inf", ","])
def test_impossible_lead_times_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"such as .*0\.1,0\.2"):
        parse_horizons(text, recorded=True)


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["imolo", "ball", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def test_command_writes_table_numbers_and_figure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(monkeypatch, "--data", FEW, "--models", "drag", "--out", tmp_path, "--jobs", 1) == 0
    output = capsys.readouterr().out
    assert "leave-one-out, 5 flights" in " ".join(output.split())
    numbers = json.loads((tmp_path / "ball.json").read_text())
    assert {rating["horizon"] for rating in numbers["ratings"]} == {0.1, 0.2, 0.3, 0.4}
    assert (tmp_path / "ball.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "either the config of a backend or --data"),
        (("config.yaml", "--data", "f.csv"), "either the config of a backend or --data"),
        (("--data", "nowhere.csv"), "cannot read the flights nowhere.csv"),
    ],
)
def test_mistakes_end_in_one_line(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, *arguments) == 2
    errors = capsys.readouterr().err
    assert message in errors
    assert errors.count("\n") == 1
