"""What both ends of the link to the valve board tell each other first, and must agree on."""

import hashlib
import hmac
import struct
from collections.abc import Sequence
from enum import StrEnum

from imolo_drivers.board.framing import PAYLOADS, VERSION
from imolo_msgs import board_arm_t, board_hello_t

NONCE_SIZE = 32  # [bytes]
NO_PROOF = bytes(32)


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


def prove_hello(secret: bytes, nonce: bytes, hello: board_hello_t) -> bytes:
    """Return the HMAC-SHA256 by which a client shows that it knows the secret, and that it is who says hello.

    Args:
        secret: What both ends know; empty where there is none.
        nonce: Of the connection, from the board's challenge.
        hello: As it was sent.
    """
    return _hmac(secret, b"hello", nonce, hello.encode())


def prove_arming(secret: bytes, nonce: bytes, sequence: int, message: board_arm_t) -> bytes:
    """Return the HMAC-SHA256 by which an operator shows that a person who knows the secret arms, now.

    Args:
        secret: What both ends know; empty where there is none.
        nonce: Of the connection, from the board's challenge.
        sequence: Of the frame, as its header holds it.
        message: What is asked for.
    """
    asked = struct.pack(">Iqqb", sequence, message.arm_session, message.arm_seen_utime, message.arm)
    return _hmac(secret, b"arm", nonce, asked + message.arm_person.encode())


def _hmac(secret: bytes, purpose: bytes, nonce: bytes, content: bytes) -> bytes:
    return hmac.new(secret, b"imolo board " + purpose + nonce + content, hashlib.sha256).digest()
