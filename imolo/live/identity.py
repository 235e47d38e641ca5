"""What two programs must agree on before a robot may move."""

import hashlib
import json
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from typing import TYPE_CHECKING

import imolo_msgs

# Recorder and operator need neither, and scikit-learn behind them takes seconds.
if TYPE_CHECKING:
    from imolo.config.experiment import ExperimentConfig
    from imolo.method.motion import MotionTemplate

# What surrounds the robot is the backend's business alone, and so is which backend it is.
SHARED_SECTIONS = ("motion", "robot", "task", "tracker", "training", "methods")


class Role(StrEnum):
    """What a program does in a session."""

    BACKEND = "backend"
    PLANNER = "planner"
    RECORDER = "recorder"
    OPERATOR = "operator"  # asks for throws


class ClockMode(StrEnum):
    """Who waits for whom."""

    LOCKSTEP = "lockstep"  # the backend for the planner: repeats exactly, at any speed
    REALTIME = "realtime"  # the backend for the clock on the wall


@dataclass(frozen=True)
class Identity:
    """What a program is.

    Attributes:
        role: What it does.
        robot: Robot that moves, or on which the table was learned; empty where it needs none.
        clock: Of the backend; empty for a program that follows.
        sections: Hash of each section of the config that both sides must share.
    """

    role: Role
    robot: str = ""
    clock: str = ""
    sections: dict[str, str] = field(default_factory=dict)


@cache
def protocol() -> int:
    """Return a hash over names and fingerprints of all message types, 64 bits, signed."""
    types = {
        name: value._get_packed_fingerprint()
        for name, value in vars(imolo_msgs).items()
        if hasattr(value, "_get_packed_fingerprint")
    }
    content = b"".join(name.encode() + types[name] for name in sorted(types))
    return int.from_bytes(hashlib.sha256(content).digest()[:8], "big", signed=True)


def shared_sections(config: "ExperimentConfig", template: "MotionTemplate | None" = None) -> dict[str, str]:
    """Return a short hash of each section of the config that backend and planner must share.

    Args:
        config: Of the program.
        template: Of the table, which is what the planner commands; that of the config if not given.
    """
    content = config.model_dump(mode="json", include=set(SHARED_SECTIONS))
    if template is not None:
        content["motion"] = template.model_dump(mode="json")
    return {
        name: hashlib.sha256(json.dumps(content[name], sort_keys=True).encode()).hexdigest()[:8]
        for name in SHARED_SECTIONS
    }


def mismatch(own: Identity, other: Identity, other_protocol: int) -> str:
    """Return why two programs must not work together, and the remedy; empty where they may.

    A program in another language says 0 for the protocol and no sections; LCM's own fingerprints guard its messages.
    """
    if other_protocol not in (protocol(), 0):
        return "it speaks other message types; run both from the same version of imolo"
    if {own.role, other.role} != {Role.BACKEND, Role.PLANNER}:
        return ""
    if own.robot != other.robot:
        return (
            f"it is for robot {other.robot!r}, this one for {own.robot!r}; give a table that was learned on the robot"
        )
    shared = [name for name in own.sections if name in other.sections]
    different = [name for name in shared if own.sections[name] != other.sections[name]]
    if different:
        return f"its config differs in {', '.join(different)}; start both with the same config"
    return ""
