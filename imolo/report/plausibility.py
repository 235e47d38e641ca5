"""Numbers of a results file that cannot be: edited by hand, or written by something else."""

import json
import math
from collections.abc import Mapping
from typing import Any

from imolo.trials.metrics import MethodResult, judge_campaign, wilson_interval

LARGEST = 2**63  # integer
ROUNDING = 1e-9  # relative; sums may be taken in another order on another processor


def check_numbers(text: str) -> None:
    """Check the JSON of any results: numbers are finite, distances and counts not negative, rates as their counts say.

    Raises:
        ValueError: A number cannot be; it is named with its place.
    """
    for place, value in _places(json.loads(text)):
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{place} is {value}, no finite number")
        if isinstance(value, int) and abs(value) > LARGEST:
            raise ValueError(f"{place} has {len(str(abs(value)))} digits, which no number of ours has")
        if isinstance(value, dict):
            # What has an interval may be a difference, and a task may measure what can be negative.
            may_be_negative = "low" in value or ".measures." in place
            sizes = {"sd", "count"} if may_be_negative else {"mean", "sd", "count"}
            for key in sizes & value.keys() if {"mean", "sd"} <= value.keys() else ():
                if isinstance(value[key], int | float) and value[key] < 0:
                    raise ValueError(f"{place}.{key} is {value[key]}, less than nothing")
            if {"hits", "balls", "interval"} <= value.keys():
                _check_rate(place, value)


def check_result(place: str, result: MethodResult) -> None:
    """Check that a summary is that of its trials.

    Raises:
        ValueError: A number is not.
    """
    trials = [trial.trial for trial in result.trials]
    if len(set(trials)) < len(trials):
        raise ValueError(f"{place}.trials has a trial twice")
    right = dict(_places(judge_campaign(result.trials).model_dump(mode="json"), place))
    # What an older imolo did not tell is not asked for.
    for name, told in _places(result.model_dump(mode="json"), place):
        if not isinstance(told, dict | list) and not _same(told, right.get(name)):
            raise ValueError(f"{name} is {told}, but its trials say {right.get(name)}")


def _check_rate(place: str, value: Mapping[str, Any]) -> None:
    hits, balls = value["hits"], value["balls"]
    if not (isinstance(hits, int) and isinstance(balls, int) and 0 <= hits <= balls):
        raise ValueError(f"{place} has {hits} hits of {balls} balls")
    if not all(map(_same, value["interval"], wilson_interval(hits, balls))):
        raise ValueError(f"{place}.interval is {value['interval']}, not that of {hits} hits of {balls} balls")


def _same(told: Any, right: Any) -> bool:
    if isinstance(told, int | float) and isinstance(right, int | float):
        return math.isclose(told, right, rel_tol=ROUNDING, abs_tol=ROUNDING)
    return bool(told == right)


def _places(value: Any, place: str = "") -> list[tuple[str, Any]]:
    """Return a value and everything in it, each with the names that lead there."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    found = [(place, value)]
    for key, one in inner:
        found += _places(one, f"{place}.{key}" if place else str(key))
    return found
