"""Names and units of the elements of messages, as the robot of a log says them: "right knee" instead of [1]."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from imolo.command_line.terminal import plain
from imolo.messaging.channels import ROBOT, TRIAL
from imolo.messaging.log import decode
from imolo.messaging.log_file import LogReader
from imolo_msgs import robot_t

# By field: which of its indices has a name, the names in robot_t, the units there, and what follows them.
NAMED = {
    ("ACTUATOR_COMMAND", "target"): (1, "channel_name", "channel_unit", ""),
    ("ACTUATOR_STATE", "measured"): (0, "channel_name", "channel_unit", ""),
    ("PLAN", "theta"): (0, "parameter_name", "parameter_unit", ""),
    ("TRUTH_ROBOT", "joint_angle"): (0, "joint_name", "joint_unit", ""),
    ("TRUTH_ROBOT", "joint_velocity"): (0, "joint_name", "joint_unit", "/s"),
    ("TRUTH_ROBOT", "effector_position"): (0, "effector_name", "", ""),
}


LONGEST = 40  # characters of a name that are shown


@dataclass(frozen=True, eq=False)
class Names:
    """What the elements of a log are called; indices where the robot is not known.

    Attributes:
        robot: The log's ROBOT message; None where it has none.
    """

    robot: robot_t | None = None

    @classmethod
    def of(cls, path: Path) -> "Names":
        """Return the names of a log, from its first ROBOT message, which comes with the start of its first trial.

        Raises:
            BusError: The log cannot be read.
        """
        started = b""
        with LogReader(path, (ROBOT, TRIAL), quiet=True) as reader:
            for event in reader:
                if event.channel == ROBOT and (message := decode(ROBOT, event.data)) is not None:
                    return cls(message)
                if event.channel == TRIAL:
                    if started not in (b"", event.data):
                        break  # the trial goes on; a copy of its start would tell nothing
                    started = event.data
        return cls()

    def label(self, channel: str, field: str, index: tuple[int, ...]) -> str:
        """Return what follows the name of a field to tell which of its elements is meant.

        Args:
            channel: Of the message.
            field: Name of the array, without the names of what it is nested in.
            index: One number for each dimension of the array, from 0.
        """
        named, names, *_ = NAMED.get((channel, field), (-1, "", "", ""))
        known = self._shown(names)
        parts = [
            known[number] if dimension == named and 0 <= number < len(known) else str(number)
            for dimension, number in enumerate(index)
        ]
        return "".join(f"[{part}]" for part in parts)

    def unit(self, channel: str, field: str, index: tuple[int, ...]) -> str:
        """Return the unit of an element of a field, as the robot says it; empty where it says none.

        Args:
            channel: Of the message.
            field: Name of the array.
            index: One number for each dimension of the array.
        """
        named, _, units, suffix = NAMED.get((channel, field), (-1, "", "", ""))
        known = self._shown(units)
        number = index[named] if 0 <= named < len(index) else len(known)
        return known[number] + suffix if -len(known) <= number < len(known) else ""

    def _shown(self, field: str) -> list[str]:
        """Return names of the robot fit for a figure or a terminal, whatever is in them."""
        names: Sequence[str] = getattr(self.robot, field, ()) if self.robot is not None else ()
        return [plain(name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…") for name in names]


INDICES = Names()
"""Where no robot is known."""
