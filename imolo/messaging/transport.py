"""What carries encoded messages: a queue in this process, or LCM."""

import select
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import lcm

from imolo.errors import BusError
from imolo.messaging import udpm

MEMORY = "memq://"
ANY = ".*"

Handler = Callable[[str, bytes], None]


class Transport(Protocol):
    """Publish and subscribe of bytes; handlers are called in the order in which they subscribed."""

    def publish(self, channel: str, data: bytes) -> None:
        """Send."""

    def subscribe(self, channel: str, handler: Handler) -> None:
        """Hear a channel, or all of them (`ANY`)."""

    def handle_waiting(self) -> None:
        """Call the handlers for all that waits, and for what they send meanwhile."""

    def wait(self, timeout: float) -> bool:
        """Wait for `timeout` [s] at most, and return whether a message waits."""

    def close(self) -> None:
        """Let go of all handlers."""


class MemoryTransport:
    """A queue within the process, in strict order. LCM's own, by the same name, takes three system calls a message."""

    def __init__(self) -> None:
        """Start empty."""
        self._waiting: deque[tuple[str, bytes]] = deque()
        self._subscriptions: list[tuple[str, Handler]] = []
        self._handlers: dict[str, tuple[Handler, ...]] = {}

    def publish(self, channel: str, data: bytes) -> None:
        """Send."""
        self._waiting.append((channel, data))

    def subscribe(self, channel: str, handler: Handler) -> None:
        """Hear a channel, or all of them."""
        self._subscriptions.append((channel, handler))
        self._handlers.clear()

    def handle_waiting(self) -> None:
        """Call the handlers for all that waits."""
        waiting = self._waiting
        while waiting:
            channel, data = waiting.popleft()
            for handler in self._handlers.get(channel) or self._find_handlers(channel):
                handler(channel, data)

    def wait(self, timeout: float) -> bool:
        """Wait where nothing waits; another thread may send meanwhile."""
        if not self._waiting:
            time.sleep(timeout)
        return bool(self._waiting)

    def close(self) -> None:
        """Let go of all handlers."""
        self._subscriptions.clear()
        self._handlers.clear()

    def _find_handlers(self, channel: str) -> tuple[Handler, ...]:
        found = tuple(handler for wanted, handler in self._subscriptions if wanted in (channel, ANY))
        self._handlers[channel] = found
        return found


class LcmTransport:
    """LCM by URL. Queues are unbounded: LCM's own limit of 30 would keep the oldest messages and lose the newest."""

    def __init__(self, url: str) -> None:
        """Open it.

        Raises:
            BusError: LCM cannot open `url`, no route leads to it, or its port is occupied.
        """
        if url.startswith(udpm.SCHEME):
            url = udpm.check_url(url)
        try:
            self._lcm = lcm.LCM(url)
        except (RuntimeError, UnicodeEncodeError) as error:
            raise BusError(f"cannot open the LCM bus {url!r}; {udpm.MULTICAST_RECIPE}") from error
        self._subscriptions: list[Any] = []

    def publish(self, channel: str, data: bytes) -> None:
        """Send."""
        self._lcm.publish(channel, data)

    def subscribe(self, channel: str, handler: Handler) -> None:
        """Hear a channel, or all of them."""
        subscription = self._lcm.subscribe(channel, handler)
        subscription.set_queue_capacity(0)
        self._subscriptions.append(subscription)

    def handle_waiting(self) -> None:
        """Call the handlers for all that waits."""
        while self._lcm.handle_timeout(0) > 0:
            pass

    def wait(self, timeout: float) -> bool:
        """Wait for a message."""
        return bool(select.select((self._lcm.fileno(),), (), (), timeout)[0])

    def close(self) -> None:
        """Let go of all handlers.

        They refer to what refers to the bus, and LCM takes no part in Python's collection of such circles: its two file
        descriptors would stay open, and from 1024 on its `select` crashes.
        """
        while self._subscriptions:
            self._lcm.unsubscribe(self._subscriptions.pop())
