"""The message bus: LCM with our channels, and errors that say what to do."""

import select
import struct
from collections.abc import Callable
from typing import Any

import lcm

from imolo.channels import CHANNELS
from imolo.errors import BusError, did_you_mean

MULTICAST_RECIPE = (
    "for udpm:// on one machine: `ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo`, "
    "and ?ttl=0 in the URL; without a network use memq://"
)


class Bus:
    """Typed publish and subscribe over one LCM instance.

    `memq://` stays inside this instance, in strict order: what a handler publishes is delivered after what was already
    waiting. Every other LCM URL works as well.
    """

    def __init__(self, url: str = "memq://") -> None:
        """Open the bus.

        Raises:
            BusError: LCM cannot open `url`.
        """
        try:
            self._lcm = lcm.LCM(url)
        except RuntimeError as error:
            raise BusError(f"cannot open the LCM bus {url!r}; {MULTICAST_RECIPE}") from error

    def publish(self, channel: str, message: Any) -> None:
        """Encode and send a message.

        Raises:
            BusError: The channel is not in the table, or the message is not of its type or incomplete.
        """
        wanted = _message_type(channel)
        if not isinstance(message, wanted):
            raise BusError(f"{channel} carries {wanted.__name__}, not {type(message).__name__}")
        try:
            data = message.encode()
        except (struct.error, TypeError, IndexError) as error:
            raise BusError(f"a message for {channel} cannot be encoded: {error}") from error
        self._lcm.publish(channel, data)

    def subscribe(self, channel: str, handler: Callable[[Any], None]) -> None:
        """Call `handler` with every decoded message of a channel, from within `drain`.

        Raises:
            BusError: The channel is not in the table.
        """
        decode = _message_type(channel).decode
        self._lcm.subscribe(channel, lambda _, data: handler(decode(data)))

    def subscribe_raw(self, handler: Callable[[str, bytes], None]) -> None:
        """Call `handler` with channel and bytes of every message on the bus, from within `drain`; none is dropped."""
        self._lcm.subscribe(".*", handler).set_queue_capacity(0)

    def drain(self) -> None:
        """Handle every waiting message, those included that handlers publish meanwhile."""
        while self._lcm.handle_timeout(0) > 0:
            pass

    def wait(self, timeout: float) -> None:
        """Wait for a message for `timeout` [s] at most, and handle all that is there."""
        if select.select((self._lcm.fileno(),), (), (), max(timeout, 0.0))[0]:
            self.drain()


def _message_type(channel: str) -> type[Any]:
    if channel not in CHANNELS:
        raise BusError(f"unknown channel {channel!r}{did_you_mean(channel, CHANNELS)}")
    return CHANNELS[channel].message_type
