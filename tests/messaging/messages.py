"""Random messages of any generated type, made from what lcm-gen writes into the class."""

import math
from typing import Any

from hypothesis import strategies as st

import imolo_msgs

TYPES: dict[str, type[Any]] = {
    name: value for name, value in vars(imolo_msgs).items() if isinstance(value, type) and hasattr(value, "_decode_one")
}
PRIMITIVES: dict[str, st.SearchStrategy[Any]] = {
    "byte": st.integers(0, 255),
    "int8_t": st.integers(-(2**7), 2**7 - 1),
    "int32_t": st.integers(-(2**31), 2**31 - 1),
    "int64_t": st.integers(-(2**63), 2**63 - 1),
    "float": st.floats(width=32, allow_nan=False),
    "double": st.floats(allow_nan=False),
    # ASCII is what a C string of every LCM language holds.
    "string": st.text(st.characters(min_codepoint=1, max_codepoint=127), max_size=20),
}


@st.composite
def messages(draw: st.DrawFn, message_type: type[Any]) -> Any:
    """Draw a message; the fields that give a length are drawn first."""
    message = message_type()
    lengths = {side for sides in message_type.__dimensions__ for side in sides or () if isinstance(side, str)}
    for name in lengths:
        setattr(message, name, draw(st.integers(0, 4)))
    for name, kind, sides in zip(
        message_type.__slots__, message_type.__typenames__, message_type.__dimensions__, strict=True
    ):
        if name in lengths:
            continue
        element = PRIMITIVES[kind] if kind in PRIMITIVES else messages(TYPES[kind.rpartition(".")[2]])
        for side in reversed(sides or ()):
            size = getattr(message, side) if isinstance(side, str) else side
            element = st.lists(element, min_size=size, max_size=size)
        setattr(message, name, draw(element))
    return message


def plain(value: Any) -> Any:
    """Return a message as nested lists, so that two of them can be compared; -0.0 and 0.0 differ."""
    if hasattr(value, "__slots__"):
        return [plain(getattr(value, name)) for name in value.__slots__]
    if isinstance(value, list | tuple | bytes):
        return [plain(element) for element in value]
    return (value, math.copysign(1.0, value)) if isinstance(value, float) else value
