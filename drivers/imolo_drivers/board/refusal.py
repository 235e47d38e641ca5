"""What the board does not do, and why; and text of others, made fit to be repeated."""

from enum import StrEnum

from imolo.errors import ImoloError

LONGEST_QUOTE = 60  # characters of a text of somebody else


class RefusalCode(StrEnum):
    """Why a frame is not followed."""

    VERSION = "version"
    TYPES = "types"
    SECRET = "secret"
    ROLE = "role"
    BUSY = "busy"
    NOT_ARMED = "not_armed"
    SESSION = "session"
    VALUES = "values"
    TIMES = "times"
    STALE = "stale"
    FRAME = "frame"
    SILENCE = "silence"
    NOISE = "noise"


class RefusedError(ImoloError):
    """The board does not do what it was asked."""

    def __init__(self, code: RefusalCode, reason: str) -> None:
        """Keep the code for programs and the reason for people."""
        super().__init__(reason)
        self.code = code


def quote(text: str, longest: int = LONGEST_QUOTE) -> str:
    """Return a text of somebody else without what would steer a terminal, and cut."""
    cut = text if len(text) <= longest else text[: longest - 3] + "..."
    return "".join(letter if letter.isprintable() else "?" for letter in cut)
