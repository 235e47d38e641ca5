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
def field_units() -> dict[tuple[str, str], str]:
    """Return the unit in the comment before each field, by type and field; a field without a unit is left out."""
    units = {}
    for path in definition_files():
        comment = ""
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.strip().startswith("//"):
                comment += line
                continue
            found = FIELD.match(line)
            if found and (given := UNIT.search(comment)):
                units[path.stem, found[1]] = given[1]
            comment = ""
    return units
