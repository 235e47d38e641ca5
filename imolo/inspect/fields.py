"""Fields of messages by name: every number in a message, and what `CHANNEL.field[index]` selects."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Any

from imolo.errors import FieldError, did_you_mean
from imolo.inspect.definitions import field_units
from imolo.inspect.names import INDICES, Names
from imolo.messaging.channels import CHANNELS

Value = int | float | str
Path = tuple[str | int, ...]

TOKEN = re.compile(r"\.(?P<name>\w+)|\[(?P<index>-?\d+)\]|\[(?P<slice>-?\d*:-?\d*)\]")


def leaves(value: Any, path: Path = ()) -> Iterator[tuple[Path, Value]]:
    """Yield every number and text in a message, with the names and indices that lead to it."""
    if hasattr(value, "__slots__"):
        for name in value.__slots__:
            yield from leaves(getattr(value, name), (*path, name))
    elif isinstance(value, list | tuple):
        for index, element in enumerate(value):
            yield from leaves(element, (*path, index))
    else:
        yield path, value


@lru_cache(maxsize=1 << 14)
def column_name(path: Path) -> str:
    """Return what a leaf is called in a table, such as `markers_0_marker_position_2`: the same for every robot."""
    return "_".join(map(str, path))


def leaf_name(channel: str, path: Path, names: Names = INDICES) -> str:
    """Return what a leaf is called to people, such as `markers[0].marker_position[2]` or `joint_angle[right_knee]`."""
    parts: list[str] = []
    for is_index, steps in groupby(path, key=lambda step: isinstance(step, int)):
        if is_index:
            parts[-1] += names.label(channel, parts[-1], tuple(step for step in steps if isinstance(step, int)))
        else:
            parts.extend(str(step) for step in steps)
    return ".".join(parts)


def leaf_unit(channel: str, path: Path, names: Names = INDICES) -> str:
    """Return the unit of a leaf, from the .lcm files or the robot of the log; empty where it has none."""
    kind: Any = CHANNELS[channel].message_type
    unit, last = "", 0
    for number, step in enumerate(path):
        if isinstance(step, str):
            unit, last = field_units().get((kind.__name__, step), ""), number
            kind = _nested_type(kind.__typenames__[kind.__slots__.index(step)])
    steps = tuple(step for step in path[last + 1 :] if isinstance(step, int))
    return unit or names.unit(channel, str(path[last]), steps)


@dataclass(frozen=True)
class Selector:
    """A field of a channel, such as `TRUTH_ROBOT.joint_angle[0:3]`.

    Attributes:
        text: As the user wrote it.
        channel: Name of the channel.
        steps: Names, indices and slices that lead from the message to the numbers.
    """

    text: str
    channel: str
    steps: tuple[str | int | slice, ...]


def parse_selector(text: str) -> Selector:
    """Read `CHANNEL.field`, with indices or slices of arrays and fields of nested messages.

    Raises:
        FieldError: Channel or field are unknown, the text cannot be read, or the field holds text.
    """
    channel = re.match(r"\w*", text)[0]  # type: ignore[index]
    if channel not in CHANNELS:
        raise FieldError(f"unknown channel {channel!r}{did_you_mean(channel, CHANNELS)}; known: {', '.join(CHANNELS)}")
    steps: list[str | int | slice] = []
    position = len(channel)
    while position < len(text):
        token = TOKEN.match(text, position)
        if token is None:
            raise FieldError(
                f"cannot read {text[position:]!r} in {text!r}; write CHANNEL.field, .field[2] or .field[0:3]"
            )
        if token["slice"] is not None:
            low, high = token["slice"].split(":")
            steps.append(slice(int(low) if low else None, int(high) if high else None))
        else:
            steps.append(token["name"] if token["name"] is not None else int(token["index"]))
        position = token.end()
    _check(text, channel, steps)
    return Selector(text, channel, tuple(steps))


def _check(text: str, channel: str, steps: Sequence[str | int | slice]) -> None:
    """Follow the steps through the types."""
    kind: Any = CHANNELS[channel].message_type
    open_sides: list[Any] = []
    for step in steps:
        if isinstance(step, str):
            if not hasattr(kind, "__slots__") or any(True for _ in open_sides):
                raise FieldError(f"{text!r}: .{step} needs a message before it; give an index such as [0] first")
            if step not in kind.__slots__:
                raise FieldError(
                    f"{channel} has no field {step!r}{did_you_mean(step, kind.__slots__)}; "
                    f"fields: {', '.join(kind.__slots__)}"
                )
            field = kind.__slots__.index(step)
            open_sides = list(kind.__dimensions__[field] or ())
            type_name = kind.__typenames__[field]
            kind = _nested_type(type_name)
        elif not open_sides:
            raise FieldError(f"{text!r}: there is no array to take {_show(step)} of")
        else:
            side = open_sides.pop(0)
            if isinstance(step, int) and isinstance(side, int) and not -side <= step < side:
                raise FieldError(f"{text!r}: index {step} is out of range; the array has {side} elements")
    if not steps or hasattr(kind, "__slots__"):
        raise FieldError(f"{text!r} names no field; fields: {', '.join(kind.__slots__)}")
    if kind == "string":
        raise FieldError(f"{text!r} holds text, not numbers")


def _nested_type(type_name: str) -> Any:
    import imolo_msgs

    return getattr(imolo_msgs, type_name.rpartition(".")[2], type_name)


def _show(step: int | slice) -> str:
    return f"[{step}]" if isinstance(step, int) else f"[{step.start or ''}:{step.stop or ''}]"


def selected(message: Any, steps: Sequence[str | int | slice]) -> Iterator[tuple[Path, Value]]:
    """Yield what the steps of a selector lead to in a message; elements that it does not have are left out."""
    return _selected(message, steps, ())


def _selected(value: Any, steps: Sequence[str | int | slice], path: Path) -> Iterator[tuple[Path, Value]]:
    if not steps:
        yield from leaves(value, path)
        return
    step, rest = steps[0], steps[1:]
    if isinstance(step, str):
        yield from _selected(getattr(value, step), rest, (*path, step))
        return
    indices = range(len(value))[step] if isinstance(step, slice) else (step,)
    for index in indices:
        if -len(value) <= index < len(value):
            yield from _selected(value[index], rest, (*path, index))
