"""The .lcm files of our messages: where they are, and the units that their comments give."""

import re
from functools import cache
from pathlib import Path

import imolo_msgs

UNIT = re.compile(r"\[([^\]\s]+)\]")
FIELD = re.compile(r"^\s*\w+\s+(\w+)\s*(?:\[[^;]*)?;")


def definition_files() -> list[Path]:
    """Return the .lcm files: beside the package in a wheel, above it in a checkout; empty if there are none."""
    package = Path(imolo_msgs.__file__).parent
    return sorted(package.parent.glob("*_t.lcm")) or sorted(package.glob("*_t.lcm"))


@cache
def field_units() -> dict[tuple[str, str], tuple[str, ...]]:
    """Return the units in the comment before each field, by type and field; a field without a unit is left out."""
    units = {}
    for path in definition_files():
        comment = ""
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.strip().startswith("//"):
                comment += line
                continue
            found = FIELD.match(line)
            if found and (given := tuple(UNIT.findall(comment))):
                units[path.stem, found[1]] = given
            comment = ""
    return units


def unit_of(type_name: str, field: str, element: int | None = None) -> str:
    """Return the unit of a field, or of one of its elements where the comment gives several; empty if unknown."""
    given = field_units().get((type_name, field), ())
    if len(given) == 1:
        return given[0]
    return "" if element is None or element >= len(given) else given[element]
