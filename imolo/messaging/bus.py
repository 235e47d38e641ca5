"""The message bus: LCM with our channels, and errors that say what to do."""

import contextlib
import logging
import struct
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from imolo.errors import BusError, did_you_mean
from imolo.messaging.channels import CHANNELS
from imolo.messaging.transport import ANY, MEMORY, LcmTransport, MemoryTransport, Transport

logger = logging.getLogger(__name__)

UNREADABLE = (ValueError, struct.error, MemoryError, OverflowError)
"""What a generated class raises for bytes that hold no message of its type."""

_STRANGE: dict[str, set[str]] = {}
"""Channels of a network, by URL, of which this program has said that others speak on them."""


class Bus:
    """Typed publish and subscribe.

    `memq://` stays inside this instance, in strict order: what a handler publishes is delivered after what was already
    waiting. Every other URL is LCM's.
    """

    def __init__(self, url: str = MEMORY) -> None:
        """Open the bus.

        Raises:
            BusError: LCM cannot open `url`, no route leads to it, or its port is occupied.
        """
        self._transport: Transport = MemoryTransport() if url.startswith(MEMORY) else LcmTransport(url)
        self._strange = set[str]() if url.startswith(MEMORY) else _STRANGE.setdefault(url, set())
        self._newest: dict[str, tuple[Callable[[str, bytes], None], bytes]] = {}
        self._own: dict[str, Counter[bytes]] = {}  # what is on its way from here, where others are told apart

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
        self.publish_raw(channel, data)

    def subscribe(self, channel: str, handler: Callable[[Any], None]) -> None:
        """Call `handler` with every decoded message of a channel, from within `drain`; others are passed over.

        Raises:
            BusError: The channel is not in the table.
        """
        decode = _message_type(channel).decode

        def hear(_: str, data: bytes) -> None:
            try:
                message = decode(data)
            except UNREADABLE:
                self.pass_over(channel)
            else:
                handler(message)

        self._transport.subscribe(channel, hear)

    def pass_over(self, channel: str) -> None:
        """Say once that a channel carries what is no message of its type, over all trials on one network."""
        if channel not in self._strange:
            self._strange.add(channel)
            logger.warning(
                "%s carries what is no %s, from another program or another version of imolo; it is passed over",
                *(channel, _message_type(channel).__name__),
            )

    def publish_raw(self, channel: str, data: bytes) -> None:
        """Send a message that is already encoded."""
        if channel in self._own:
            self._own[channel][data] += 1
        self._transport.publish(channel, data)

    def subscribe_raw(self, handler: Callable[[str, bytes], None], channel: str = ANY) -> None:
        """Call `handler` with channel and bytes of every message of the channel, or of all, from within `drain`."""
        self._transport.subscribe(channel, handler)

    def subscribe_foreign(self, channel: str, handler: Callable[[Any], None]) -> None:
        """Call `handler` with every decoded message of a channel that did not come from this bus object.

        Two programs that say the same are told apart by how often it is heard.
        """
        own = self._own.setdefault(channel, Counter())
        decode = _message_type(channel).decode

        def hear(_: str, data: bytes) -> None:
            if own[data]:
                own[data] -= 1
                return
            with contextlib.suppress(*UNREADABLE):
                handler(decode(data))

        self._transport.subscribe(channel, hear)

    def subscribe_newest(
        self, channel: str, handler: Callable[[str, bytes], None], skipped: Callable[[bytes], None] = lambda _: None
    ) -> None:
        """Call `handler` with the newest message alone, where several are waiting, and `skipped` with the others.

        For control, where an answer to an old frame would only delay the one to the newest.
        """

        def keep(_: str, data: bytes) -> None:
            if channel in self._newest:
                skipped(self._newest[channel][1])
            self._newest[channel] = (handler, data)

        self._transport.subscribe(channel, keep)

    def drain(self) -> None:
        """Handle every waiting message, those included that handlers publish meanwhile."""
        while True:
            self._transport.handle_waiting()
            if not self._newest:
                return
            newest, self._newest = self._newest, {}
            for channel, (handler, data) in newest.items():
                handler(channel, data)

    def settle(self, channel: str, timeout: float = 5.0) -> None:
        """Handle messages until all that this bus sent on a channel has come back, which over a network takes a while.

        Args:
            channel: One of those that `subscribe_foreign` hears.
            timeout: After which it counts as lost [s].
        """
        deadline = time.monotonic() + timeout
        self.drain()
        while self._own[channel].total() > 0 and (left := deadline - time.monotonic()) > 0:
            self.wait(left)

    def wait(self, timeout: float) -> None:
        """Wait for a message for `timeout` [s] at most, and handle all that is there."""
        if self._transport.wait(max(timeout, 0.0)):
            self.drain()

    def close(self) -> None:
        """Let go of all handlers."""
        self._transport.close()


def _message_type(channel: str) -> type[Any]:
    if channel not in CHANNELS:
        raise BusError(f"unknown channel {channel!r}{did_you_mean(channel, CHANNELS)}")
    return CHANNELS[channel].message_type
