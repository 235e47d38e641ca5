"""Read recorded flights from a CSV file: flight, time_s, x_m, y_m, z_m."""

import csv
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imolo.ball.bounce import before_bounce
from imolo.ball.flight import FEWEST_SAMPLES, Flight
from imolo.errors import TrainingDataError, did_you_mean

Array = NDArray[np.float64]

NUMBERS = ("time_s", "x_m", "y_m", "z_m")
COLUMNS = ("flight", *NUMBERS)


@dataclass(frozen=True, eq=False)
class FlightFile:
    """The free flights of a file.

    Attributes:
        flights: Free flight before the first bounce, by the name in the column `flight`.
        left_out: Why a flight cannot be used, by the same name.
    """

    flights: dict[str, Flight]
    left_out: dict[str, str]


def read_flights(path: Path, min_duration: float) -> FlightFile:
    """Read a file and cut the free flight before the bounce out of each of its tracks.

    Args:
        path: CSV file, see `read_tracks`.
        min_duration: Shortest free flight that is used [s].

    Raises:
        TrainingDataError: The file cannot be read, see `read_tracks`.
    """
    flights, left_out = {}, {}
    for name, track in read_tracks(path).items():
        try:
            flight = before_bounce(track.time, track.position)
        except TrainingDataError as error:
            left_out[name] = str(error)
            continue
        duration, count = float(np.ptp(flight.time)), len(flight.time)
        if count < FEWEST_SAMPLES or duration < min_duration:
            left_out[name] = f"its free flight has {count} samples in {duration:.3f} s; needed are {min_duration:g} s"
        else:
            flights[name] = flight
    return FlightFile(flights, left_out)


def read_tracks(path: Path) -> dict[str, Flight]:
    """Read everything a file holds, bounces included.

    Args:
        path: CSV with a header that names flight, time_s, x_m, y_m, z_m in any order, z up; other columns are passed
            over, and so are empty lines. A flight's rows are in order of time.

    Returns:
        Tracks by the text in the column `flight`, in order of appearance.

    Raises:
        TrainingDataError: The file cannot be read, a column is missing, or a value is not a finite number or out of
            order; file, line, value and fix are named.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return _parse(path, file)
    except OSError as error:
        raise TrainingDataError(f"cannot read the flights {path}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TrainingDataError(f"{path} is no CSV text: {error}; save it as UTF-8 with commas") from error


def _parse(path: Path, lines: Iterable[str]) -> dict[str, Flight]:
    reader = csv.reader(lines, skipinitialspace=True, strict=True)
    header = [name.strip() for name in next(reader, [])]
    for name in COLUMNS:
        if header.count(name) != 1:
            problem = "is missing" if name not in header else "is there twice"
            others = [other for other in header if other not in COLUMNS]
            raise TrainingDataError(
                f"{path}: the column {name!r} {problem}{did_you_mean(name, others)}; the first line must name "
                f"{', '.join(COLUMNS)}"
            )
    samples: dict[str, list[tuple[float, ...]]] = {}
    for row in reader:
        if not any(field.strip() for field in row):
            continue
        where = f"{path}, line {reader.line_num}"
        if len(row) != len(header):
            raise TrainingDataError(f"{where}: {len(row)} values for {len(header)} columns; mend or delete the line")
        fields = dict(zip(header, (field.strip() for field in row), strict=True))
        flight = samples.setdefault(_name(fields, where), [])
        sample = tuple(_number(fields, name, where) for name in NUMBERS)
        if flight and sample[0] <= flight[-1][0]:
            raise TrainingDataError(
                f"{where}: time_s {sample[0]:g} of flight {fields['flight']!r} does not come after {flight[-1][0]:g}; "
                "sort its rows, drop repeated ones, or give the next throw another name"
            )
        flight.append(sample)
    if not samples:
        raise TrainingDataError(f"{path} holds no samples, only a header; record some flights")
    tables = {name: np.array(rows) for name, rows in samples.items()}
    return {name: Flight(time=table[:, 0], position=table[:, 1:]) for name, table in tables.items()}


def _name(fields: Mapping[str, str], where: str) -> str:
    if not fields["flight"]:
        raise TrainingDataError(f"{where}: the flight has no name; number the flights in the column 'flight'")
    return fields["flight"]


def _number(fields: Mapping[str, str], name: str, where: str) -> float:
    text = fields[name]
    try:
        value = float(text)
    except ValueError:
        value = math.nan
        fix = "give a number with a decimal point"
    else:
        fix = "leave samples out in which the ball was not seen"
    if not math.isfinite(value):
        raise TrainingDataError(f"{where}: {name} is {text!r}, no finite number; {fix}")
    return value
