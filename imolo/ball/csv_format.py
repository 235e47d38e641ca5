"""How a CSV file of flights is written, as far as it does not say so itself."""

import re
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from imolo.errors import TrainingDataError, did_you_mean

Array = NDArray[np.float64]

LENGTHS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}  # in a metre
TIMES = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}  # in a second
SEPARATORS = {",": ",", ";": ";", "tab": "\t", "|": "|"}
DECIMALS = {".": ".", ",": ","}
# Which of the file's axes are ours, x forward, y left, z up; all right-handed. That of y is Motive's.
AXES = {"z": [0, 1, 2], "y": [2, 0, 1], "x": [1, 2, 0]}
UPS = ("z", "-z", "y", "-y", "x", "-x")

WORDS = {"\u00b5s": "us", "\u03bcs": "us", "sec": "s"} | {
    f"{prefix}{word}{plural}": short + unit
    for prefix, short in (("", ""), ("centi", "c"), ("milli", "m"), ("micro", "u"), ("nano", "n"))
    for word, unit in (("meter", "m"), ("metre", "m"), ("second", "s"))
    for plural in ("", "s")
}
"""Units by other names, those that nobody uses included."""

_UNITS = "|".join((*LENGTHS, *TIMES, *WORDS))
_NAME = re.compile(rf"(time|t|x|y|z)(?:[\s_]*[_\s(\[]({_UNITS})[\])]?)?", re.IGNORECASE)


@dataclass(frozen=True)
class CsvFormat:
    """What was said about a file; None where nothing was, so that what looks otherwise is told.

    Attributes:
        units: Of positions, one of `LENGTHS`; m if not given.
        time: Unit of times, one of `TIMES`; s if not given.
        up: The axis that points upwards, one of `UPS`; z if not given, y for what Motive wrote.
        separator: Of columns, one of `SEPARATORS`; a comma if not given.
        decimal: Mark of decimals, one of `DECIMALS`; a point if not given.
    """

    units: str | None = None
    time: str | None = None
    up: str | None = None
    separator: str | None = None
    decimal: str | None = None

    def __post_init__(self) -> None:
        known = {"units": LENGTHS, "time": TIMES, "up": UPS, "separator": SEPARATORS, "decimal": DECIMALS}
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and value not in known[field.name]:
                listed = " ".join(known[field.name])
                raise TrainingDataError(f"unknown --{field.name} {value!r}; give one of: {listed}")

    def to_metres(self, position: Array) -> Array:
        """Return positions with z up [m], of positions as in the file, shape (N, 3)."""
        turned = position[:, AXES[(self.up or "z")[-1]]] / LENGTHS[self.units or "m"]
        return turned * [1.0, -1.0, -1.0] if (self.up or "z").startswith("-") else turned

    def to_seconds(self, time: Array) -> Array:
        """Return times [s] of times as in the file."""
        return time / TIMES[self.time or "s"]

    def or_else(self, other: "CsvFormat") -> Self:
        """Return what this says, and what the other says where this says nothing."""
        said = {field.name: getattr(self, field.name) or getattr(other, field.name) for field in fields(self)}
        return type(self)(**said)


def find_columns(header: list[str], said: CsvFormat) -> dict[str, int]:
    """Return the number of the column of flight, time, x, y and z.

    Raises:
        TrainingDataError: One is missing or there twice, or is in another unit than was said or than the others.
    """
    wanted = {"flight": "", "time": said.time or "s"} | dict.fromkeys("xyz", said.units or "m")
    found: dict[str, str] = {}
    for name, unit in wanted.items():
        full = f"{name}_{unit}" if unit else name
        if header.count(full) > 1:
            raise TrainingDataError(f"the column {full!r} is there twice; {_must_name(wanted)}")
        alike = [column for column in header if _parsed(column)[0] == name]
        if full not in header and len(alike) != 1:
            near = did_you_mean(full, [column for column in header if not _parsed(column)[0]][:1000])
            raise TrainingDataError(f"the column {full!r} is missing{near}; {_must_name(wanted)}")
        found[name] = full if full in header else alike[0]
    units = {name: _parsed(column)[1] for name, column in found.items()}
    if len({units[axis] for axis in "xyz"} - {""}) > 1:
        axes = ", ".join(repr(found[axis]) for axis in "xyz")
        raise TrainingDataError(f"the columns {axes} are in different units; write them in one")
    others = {
        name: column for name, column in found.items() if units[name] != wanted[name] and not _is_said(name, said)
    }
    if others:
        raise TrainingDataError(_of_another_unit(others, said))
    return {name: header.index(column) for name, column in found.items()}


def _parsed(column: str) -> tuple[str, str]:
    """Return the quantity and the unit that a column's name says."""
    if column.lower() == "flight":
        return "flight", ""
    found = _NAME.fullmatch(column)
    if found is None:
        return "", ""
    quantity, unit = found[1].lower(), (found[2] or "").lower()
    return "time" if quantity == "t" else quantity, WORDS.get(unit, unit)


def _is_said(name: str, said: CsvFormat) -> bool:
    """Tell whether the unit of a column was said, which goes before what its name says."""
    return name == "flight" or (said.time if name == "time" else said.units) is not None


def _of_another_unit(columns: dict[str, str], said: CsvFormat) -> str:
    options, seen = [], []
    for name, option, known in (("time", "--time", TIMES), ("xyz", "--units", LENGTHS)):
        mine = [column for quantity, column in columns.items() if quantity in (name, *name)]
        if mine:
            unit = _parsed(mine[0])[1]
            seen.append(f"{', '.join(map(repr, mine))} {f'in {unit}' if unit else 'without a unit'}")
            options.append(f"{option} {unit}" if unit in known else f"{option} with one of {' '.join(known)}")
    return f"the header has {' and '.join(seen)}, not in m and s; give {' '.join(options)}"


def _must_name(wanted: dict[str, str]) -> str:
    names = ", ".join(f"{name}_{unit}" if unit else name for name, unit in wanted.items())
    return f"the first line must name {names}"
