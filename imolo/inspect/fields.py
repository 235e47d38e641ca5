"""Fields of messages by name: whole messages as flat columns, and `CHANNEL.field[index]` as a series over time."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imolo.errors import FieldError, did_you_mean
from imolo.inspect.definitions import unit_of
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import Log

Array = NDArray[np.float64]
Value = int | float | str

TOKEN = re.compile(r"\.(?P<name>\w+)|\[(?P<index>-?\d+)\]|\[(?P<slice>-?\d*:-?\d*)\]")


def flatten(message: Any, prefix: str = "") -> Iterator[tuple[str, Value]]:
    """Yield name and value of every number and text in a message; elements of arrays are called `name_0`, `name_1`."""
    for name in message.__slots__:
        yield from _flatten_value(getattr(message, name), prefix + name)


def _flatten_value(value: Any, name: str) -> Iterator[tuple[str, Value]]:
    if isinstance(value, list | tuple):
        for index, element in enumerate(value):
            yield from _flatten_value(element, f"{name}_{index}")
    elif hasattr(value, "__slots__"):
        yield from flatten(value, f"{name}_")
    else:
        yield name, value


def columns(messages: Sequence[Any]) -> dict[str, list[Value | None]]:
    """Return messages of one type as columns; a shorter array leaves None in the columns it does not reach."""
    rows: list[dict[str, Value]] = [dict(flatten(message)) for message in messages]
    # The longest message names the columns in the order of the type; a column that only others have comes at the end.
    longest: dict[str, Value] = max(rows, key=len) if rows else {}
    names = dict.fromkeys(longest)
    for row in rows:
        names.update(dict.fromkeys(row))
    return {name: [row.get(name) for row in rows] for name in names}


@dataclass(frozen=True)
class Selector:
    """A field of a channel, such as `TRUTH_ROBOT.joint_angle[0:3]`.

    Attributes:
        text: As the user wrote it.
        channel: Name of the channel.
        steps: Names, indices and slices that lead from the message to the numbers.
        unit: From the comment of the .lcm file; empty if unknown.
    """

    text: str
    channel: str
    steps: tuple[str | int | slice, ...]
    unit: str

    @property
    def label(self) -> str:
        """The text with the unit."""
        return f"{self.text} [{self.unit}]" if self.unit else self.text


@dataclass(frozen=True)
class Series:
    """Numbers over time.

    Attributes:
        time: Time of the messages [s], shape (N,).
        values: Shape (N, K); NaN where a message has no such element.
        labels: What each of the K columns is.
    """

    time: Array
    values: Array
    labels: tuple[str, ...]


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
    return Selector(text, channel, tuple(steps), _check(text, channel, steps))


def _check(text: str, channel: str, steps: Sequence[str | int | slice]) -> str:
    """Follow the steps through the types; return the unit."""
    kind: Any = CHANNELS[channel].message_type
    open_sides: list[Any] = []
    unit = ""
    for number, step in enumerate(steps):
        if isinstance(step, str):
            if not hasattr(kind, "__slots__") or any(True for _ in open_sides):
                raise FieldError(f"{text!r}: .{step} needs a message before it; give an index such as [0] first")
            if step not in kind.__slots__:
                raise FieldError(
                    f"{channel} has no field {step!r}{did_you_mean(step, kind.__slots__)}; "
                    f"fields: {', '.join(kind.__slots__)}"
                )
            field = kind.__slots__.index(step)
            element = next((s for s in steps[number + 1 : number + 2] if isinstance(s, int)), None)
            unit = unit_of(kind.__name__, step, element)
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
    return unit


def _nested_type(type_name: str) -> Any:
    import imolo_msgs

    return getattr(imolo_msgs, type_name.rpartition(".")[2], type_name)


def _show(step: int | slice) -> str:
    return f"[{step}]" if isinstance(step, int) else f"[{step.start or ''}:{step.stop or ''}]"


def series(log: Log, selector: Selector) -> Series:
    """Return a field of a log over the time of its messages.

    Raises:
        FieldError: The channel is silent in the log.
    """
    messages = log.messages[selector.channel]
    if not messages:
        heard = [name for name, found in log.messages.items() if found]
        raise FieldError(f"{log.path} has no {selector.channel}; it has {', '.join(heard) or 'no message of ours'}")
    rows = [dict(_select(message, selector.steps, selector.channel)) for message in messages]
    labels = tuple(dict.fromkeys(label for row in sorted(rows, key=len, reverse=True) for label in row))
    values = np.array([[row.get(label, np.nan) for label in labels] for row in rows], dtype=np.float64)
    return Series(np.array([message.utime for message in messages]) * 1e-6, values, labels)


def _select(value: Any, steps: Sequence[str | int | slice], label: str) -> Iterator[tuple[str, float]]:
    if not steps:
        if isinstance(value, list | tuple):
            for index, element in enumerate(value):
                yield from _select(element, (), f"{label}[{index}]")
        else:
            yield label, value
        return
    step, rest = steps[0], steps[1:]
    if isinstance(step, str):
        yield from _select(getattr(value, step), rest, f"{label}.{step}")
        return
    indices = range(len(value))[step] if isinstance(step, slice) else (step,)
    for index in indices:
        if -len(value) <= index < len(value):
            yield from _select(value[index], rest, f"{label}[{index}]")
