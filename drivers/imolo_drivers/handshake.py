"""What both ends of the link to the valve board tell each other first, and must agree on."""

from collections.abc import Sequence
from enum import StrEnum

from imolo_drivers.framing import PAYLOADS, VERSION
from imolo_msgs import board_hello_t


class ClientRole(StrEnum):
    """What a client of the board is there for."""

    CONTROLLER = "controller"
    OPERATOR = "operator"


def fingerprints() -> dict[str, int]:
    """Return the fingerprint that LCM gives each message type of the link."""
    return {
        payload.__name__: int.from_bytes(payload._get_packed_fingerprint(), "big", signed=True)
        for payload in PAYLOADS.values()
    }


def make_hello(role: ClientRole, name: str, dry_run: bool = False) -> board_hello_t:
    """Return the first message of a client."""
    message = board_hello_t()
    message.hello_version = VERSION
    message.client_role, message.client_name = role.value, name
    message.wants_dry_run = int(dry_run)
    types = fingerprints()
    message.num_hello_types = len(types)
    message.hello_type, message.hello_fingerprint = list(types), list(types.values())
    return message


def type_mismatch(names: Sequence[str], values: Sequence[int]) -> str:
    """Return which message types a hello names otherwise than ours; empty where all are the same."""
    theirs = dict(zip(names, values, strict=True))
    return ", ".join(name for name, value in fingerprints().items() if theirs.get(name) != value)
