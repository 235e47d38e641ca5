"""Read recorded flights from a CSV file: flight, time_s, x_m, y_m, z_m, or what Motive exports."""

import csv
import math
import re
import shlex
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from itertools import chain
from pathlib import Path
from typing import TextIO

import numpy as np

from imolo.ball.bounce import before_bounce
from imolo.ball.csv_format import SEPARATORS, CsvFormat, find_columns
from imolo.ball.flight import FEWEST_SAMPLES, Flight
from imolo.ball.flight_units import suspect
from imolo.ball.motive_csv import FIRST, parse_motive
from imolo.errors import TrainingDataError
from imolo.machine.files import open_bounded

NUMBERS = ("time", "x", "y", "z")
COLUMNS = ("flight", *NUMBERS)
MOST_BYTES = 200_000_000  # an hour of a ball at 1 kHz
MOST_LINE = 1_000_000  # [characters]
AS_IT_SAYS = CsvFormat()

_NOT_SEEN = "leave samples out in which the ball was not seen"
_SEPARATOR_LINE = re.compile(r"sep=([,;|\t])", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


@dataclass(frozen=True, eq=False)
class FlightFile:
    """The free flights of a file.

    Attributes:
        flights: Free flight before the first bounce, by the name in the column `flight`.
        left_out: Why a flight cannot be used, by the same name.
    """

    flights: dict[str, Flight]
    left_out: dict[str, str]


def read_flights(path: Path, min_duration: float, form: CsvFormat = AS_IT_SAYS) -> FlightFile:
    """Read a file and cut the free flight before the bounce out of each of its tracks.

    Args:
        path: CSV file, see `read_tracks`.
        min_duration: Shortest free flight that is used [s].
        form: What is said about units, axes, separators and decimals.

    Raises:
        TrainingDataError: The file cannot be read, see `read_tracks`, or its balls do not fall at g along its z, but
            would in other units or along another axis.
    """
    tracks = read_tracks(path, form)
    if suspicion := suspect(tracks.values(), form):
        raise TrainingDataError(f"{path}: {suspicion}; give that, or what is right")
    flights, left_out = {}, {}
    for name, track in tracks.items():
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


def read_tracks(path: Path, form: CsvFormat = AS_IT_SAYS) -> dict[str, Flight]:
    """Read everything a file holds, bounces included.

    Args:
        path: What Motive exported, or CSV with a header that names flight, time_s, x_m, y_m, z_m in any order, z up;
            other columns are passed over, and so are empty lines. A flight's rows are in order of time.
        form: What is said about units, axes, separators and decimals.

    Returns:
        Tracks by the text in the column `flight`, or by the marker's name, in order of appearance.

    Raises:
        TrainingDataError: The file cannot be read, a column is missing, or a value is not a finite number or out of
            order; file, line, value and fix are named.
    """
    try:
        with open_bounded(path, MOST_BYTES) as binary, TextIOWrapper(binary, "utf-8-sig", newline="") as file:
            return _parse(path, file, form)
    except OSError as error:
        raise TrainingDataError(f"cannot read the flights {path}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TrainingDataError(f"{path} is no CSV text: {error}; save it as UTF-8 with commas") from error


def _parse(path: Path, file: TextIO, form: CsvFormat) -> dict[str, Flight]:
    first = file.readline(MOST_LINE)
    separator = SEPARATORS[form.separator or ","]
    if told := _SEPARATOR_LINE.fullmatch(first.strip("\r\n")):  # as Excel has it
        first, separator = file.readline(MOST_LINE), separator if form.separator else told[1]
    rows = _rows(chain([first], iter(lambda: file.readline(MOST_LINE), "")), separator)
    try:
        if first.startswith(FIRST):
            return parse_motive((row for _, row in rows), form)
        others = [name for name, mark in SEPARATORS.items() if mark in first and mark != separator]
        header = [name.strip() for name in next(rows, (1, []))[1]]
        if len(header) < len(COLUMNS) and others:
            raise TrainingDataError(
                f"the first line has {len(header)} columns between {separator!r}; it looks like --separator "
                f"{shlex.quote(others[0])}; give that, or what is right"
            )
        if len(header) < len(COLUMNS) <= len(first.split()):
            raise TrainingDataError("its columns are parted by spaces; write it with commas")
        return _parse_rows(rows, find_columns(header, form), len(header), form)
    except TrainingDataError as error:
        raise TrainingDataError(f"{path}{error}" if str(error).startswith(", line") else f"{path}: {error}") from error


def _rows(lines: Iterable[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows with the number of their line; one that has no end is refused."""
    size = 0

    def counted() -> Iterator[str]:
        nonlocal size
        for line in lines:
            size += len(line)
            if size > 2 * MOST_LINE:
                raise TrainingDataError(f"a row has more than {MOST_LINE} characters; is a quote left open?")
            yield line

    reader = csv.reader(counted(), delimiter=separator, skipinitialspace=True, strict=True)
    for row in reader:
        size = 0
        yield reader.line_num, row


def _parse_rows(
    rows: Iterable[tuple[int, list[str]]], columns: Mapping[str, int], width: int, form: CsvFormat
) -> dict[str, Flight]:
    """Return the tracks of rows; an error that begins with a comma names the line."""
    samples: dict[str, array[float]] = {}
    for line, row in rows:
        if not any(field.strip() for field in row):
            continue
        where = f", line {line}"
        if len(row) != width:
            raise TrainingDataError(f"{where}: {len(row)} values for {width} columns; {_why_so_many(row, width)}")
        fields = {name: row[column].strip() for name, column in columns.items()}
        name = fields["flight"]
        if not name:
            raise TrainingDataError(f"{where}: the flight has no name; number the flights in the column 'flight'")
        flight = samples.setdefault(name, array("d"))
        sample = [_number(fields[title], title, where, form) for title in NUMBERS]
        if flight and sample[0] <= flight[-4]:
            raise TrainingDataError(
                f"{where}: {_titled('time', form)} {sample[0]:g} of flight {name[:40]!r} does not come after "
                f"{flight[-4]:g}; sort its rows, drop repeated ones, or give the next throw another name"
            )
        flight.extend(sample)
    if not samples:
        raise TrainingDataError("it holds no samples, only a header; record some flights")
    tables = {name: np.array(flight).reshape(-1, 4) for name, flight in samples.items()}
    return {
        name: Flight(time=form.to_seconds(table[:, 0]), position=form.to_metres(table[:, 1:]))
        for name, table in tables.items()
    }


def _why_so_many(row: Sequence[str], width: int) -> str:
    # A decimal comma in each of the four numbers, or in three beside a time without one.
    if width + 3 <= len(row) <= 2 * width:
        return (
            "with decimal commas the separator must be another: export it with ';' and give --separator ';' --decimal ,"
        )
    return "mend or delete the line"


def _titled(quantity: str, form: CsvFormat) -> str:
    return f"{quantity}_{(form.time or 's') if quantity == 'time' else (form.units or 'm')}"


def _number(text: str, quantity: str, where: str, form: CsvFormat) -> float:
    # 1_000 is a number to Python; 1.234,5 has a mark of thousands.
    plain = "" if "_" in text or (form.decimal == "," and "." in text) else text
    try:
        value = float(plain.replace(",", ".") if form.decimal == "," else plain)
    except ValueError:
        value = math.nan
        fix = f"give a number with a decimal {'comma' if form.decimal == ',' else 'point'}" if text else _NOT_SEEN
        if _DECIMAL_COMMA.fullmatch(text) and form.decimal is None:
            fix = "it looks like --decimal ,; give that, or what is right"
    else:
        fix = _NOT_SEEN
    if not math.isfinite(value):
        raise TrainingDataError(f"{where}: {_titled(quantity, form)} is {text[:40]!r}, no finite number; {fix}")
    return value
