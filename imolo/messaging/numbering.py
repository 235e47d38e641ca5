"""The numbers of messages: on which channels they count upwards, and which were passed over."""

from struct import Struct

from imolo.messaging.channels import ACTUATOR_COMMAND, ACTUATOR_STATE, CHANNELS, MOCAP, PLAN

NUMBERED = {
    ACTUATOR_COMMAND: "command_sequence",
    ACTUATOR_STATE: "state_sequence",
    MOCAP: "frame_number",
    PLAN: "answered_frame",
}
"""Field of each numbered channel. All begin anew with every trial."""
FIRST = 1  # number of the first message of a trial
LONGEST_GAP = 100_000  # numbers that no trial passes over; what is further ahead is another sender's
FARTHEST_BACK = 100  # numbers by which a network disorders messages, assumed; what is further back is of the next trial
FINGERPRINT = 8  # [bytes] with which every message begins
FORMATS = {"int8_t": "b", "int16_t": "h", "int32_t": "i", "int64_t": "q", "float": "f", "double": "d"}


class Numbering:
    """Follows the numbers of one channel.

    Attributes:
        missing: Number of messages that never came.
        disordered: Number of messages that came twice or after a later one.
    """

    def __init__(self, channel: str) -> None:
        """Follow one of `NUMBERED`."""
        self.missing = self.disordered = 0
        self._last: int | None = None
        message_type, field = CHANNELS[channel].message_type, NUMBERED[channel]
        self._fingerprint = message_type._get_packed_fingerprint()
        # Only numbers stand before it, so that a message need not be decoded.
        names = message_type.__slots__[: message_type.__slots__.index(field) + 1]
        self._up_to = Struct(">" + "".join(FORMATS[kind] for kind in message_type.__typenames__[: len(names)]))

    def begin(self) -> None:
        """Expect the first message of a trial."""
        self._last = FIRST - 1

    def count(self, data: bytes) -> bool:
        """Count a message; return whether it is of the channel's type. Another one leaves no gap."""
        if not data.startswith(self._fingerprint) or len(data) < FINGERPRINT + self._up_to.size:
            return False
        number, last = self._up_to.unpack_from(data, FINGERPRINT)[-1], self._last
        if last is not None and max(FIRST, last - FARTHEST_BACK) < number <= last:
            self.disordered += 1
            return True
        expected = FIRST if last is None or number <= last else last + 1
        if FIRST <= number <= expected + LONGEST_GAP:
            # Who joins in the middle of a trial has missed nothing.
            self.missing += number - expected if last is not None else 0
            self._last = number
        return True
