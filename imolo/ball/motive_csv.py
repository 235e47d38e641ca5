"""Tracks of a CSV file as Motive exports it: a line about the take, rows of names, then frames."""

import math
from array import array
from collections.abc import Iterator

import numpy as np

from imolo.ball.csv_format import CsvFormat
from imolo.ball.flight import Flight
from imolo.errors import TrainingDataError

FIRST = "Format Version"
"""How the file begins."""
KINDS = ("Marker", "Rigid Body")  # what can be a ball, the better first; other kinds repeat these
LENGTH_UNITS = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}
LONGEST_GAP = 0.1  # [s] assumed: a marker that is gone for longer comes back with another throw
MOST_HEADER = 20  # [lines]
MOST_COLUMNS = 30_000


def parse_motive(rows: Iterator[list[str]], said: CsvFormat) -> dict[str, Flight]:
    """Return the track of each marker, or of each rigid body if there are no markers, parted where it was not seen.

    Args:
        rows: All rows of the file.
        said: What goes before what the file says.

    Raises:
        TrainingDataError: The file is not as Motive writes it, or holds no positions.
    """
    take = next(rows)
    about = dict(zip(take[::2], take[1::2], strict=False))
    unit = about.get("Length Units", "Meters")
    if said.units is None and unit.lower() not in LENGTH_UNITS:
        raise TrainingDataError(f"its length unit is {unit!r}; give --units with m, cm or mm")
    form = said.or_else(CsvFormat(units=LENGTH_UNITS.get(unit.lower()), up="y"))
    header = _header(rows)
    columns = _positions(header)
    times = {name: array("d") for name in columns}
    places = {name: array("d") for name in columns}
    clock = next((i for i, title in enumerate(header[-1]) if title.startswith("Time")), 1)
    for row in rows:
        if len(row) <= clock or not row[clock].strip():
            continue
        where = f"frame {row[0][:20]}"
        time = _number(row[clock], where)
        for name, first in columns.items():
            cells = row[first : first + 3]
            # Blank where the marker was not seen.
            if len(cells) == 3 and all(cells):
                times[name].append(time)
                places[name].extend(_number(cell, where) for cell in cells)
    tracks: dict[str, Flight] = {}
    for name in columns:
        track = form.to_seconds(np.array(times[name]))
        position = form.to_metres(np.array(places[name]).reshape(-1, 3))
        steps = np.diff(track)
        if (steps <= 0.0).any():
            raise TrainingDataError(f"the times of {name!r} do not rise; export it again")
        ends = np.flatnonzero(steps > LONGEST_GAP) + 1
        pieces = zip(np.split(track, ends), np.split(position, ends), strict=True)
        for number, (part_time, part_position) in enumerate(pieces, 1):
            if len(part_time):
                tracks[name if number == 1 else f"{name}, {number}"] = Flight(time=part_time, position=part_position)
    if not tracks:
        raise TrainingDataError("it holds no positions of markers or rigid bodies; export them from Motive")
    return tracks


def _header(rows: Iterator[list[str]]) -> list[list[str]]:
    """Return the rows of names down to that which begins with Frame."""
    header: list[list[str]] = []
    for row in rows:
        header.append([cell.strip() for cell in row[:MOST_COLUMNS]])
        if header[-1][:1] == ["Frame"] and len(header) > 3:
            return header
        if len(header) > MOST_HEADER:
            break
    raise TrainingDataError("it begins as Motive's, but has no line with Frame,Time (Seconds),X,Y,Z; export it again")


def _positions(header: list[list[str]]) -> dict[str, int]:
    """Return the first of three columns by the name of what is there."""
    axes, parts = header[-1], header[-2]
    named = [row for row in header[:-2] if any(row)]
    if len(named) < 2:
        raise TrainingDataError("it has no rows of types and names; export it from Motive with its header")
    kinds, names = named[0], named[1]
    for kind in KINDS:
        found: dict[str, int] = {}
        for i in range(len(axes) - 2):
            here = min(map(len, (kinds, names, parts))) > i + 2
            if here and kinds[i] == kind and parts[i] == "Position" and axes[i : i + 3] == ["X", "Y", "Z"]:
                found[names[i] if names[i] not in found else f"{names[i]}, column {i + 1}"] = i
        if found:
            return found
    return {}


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TrainingDataError(f"{where}: {text[:40]!r} is no finite number; export it again")
    return value
