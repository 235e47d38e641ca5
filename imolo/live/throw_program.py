"""`imolo throw`: asks the backend for balls and tells how they went."""

import time

from imolo.live.identity import Identity, Role
from imolo.live.node import Node
from imolo.live.program import Console, Stop, run_node
from imolo.messaging import channels
from imolo.messaging.bus import UNREADABLE, Bus
from imolo_msgs import throw_report_t, throw_request_t

REPEAT = 0.2  # [s] between two requests, until all is done


class ThrowRequest:
    """Asks for a number of balls, again and again, until they are all thrown; a backend that comes late gets the rest.

    Attributes:
        left: Number of balls that have not been thrown yet.
    """

    def __init__(self, bus: Bus, node: Node, count: int, console: Console) -> None:
        """Join the network and ask for `count` balls."""
        self.left = count
        self._bus, self._node, self._console = bus, node, console
        self._requester = time.time_ns()
        self._asked = count
        self._backend = 0
        self._told = ""
        self._next = 0.0
        bus.subscribe_raw(self._on_report, channels.THROW_REPORT)

    def turn(self) -> None:
        """Ask again if it is time."""
        backend = self._node.peer(Role.BACKEND)
        if backend is None:
            self._tell("waiting for a backend")
            return
        if backend.instance != self._backend:
            # What the last one had not done when it went is asked of its successor.
            self._backend, self._asked = backend.instance, self.left
            self._requester += 1
            self._next = 0.0
        if self.left and time.monotonic() >= self._next:
            self._next = time.monotonic() + REPEAT
            request = throw_request_t()
            request.requester, request.num_throws = self._requester, self._asked
            self._bus.publish(channels.THROW_REQUEST, request)

    def _on_report(self, _: str, data: bytes) -> None:
        try:
            report = throw_report_t.decode(data)
        except UNREADABLE:
            self._bus.pass_over(channels.THROW_REPORT)
            return
        if (report.reporting_backend, report.reported_requester) != (self._backend, self._requester):
            return
        self.left = min(self.left, report.throws_asked - report.throws_done)
        self._tell(report.report)

    def _tell(self, text: str) -> None:
        if text != self._told:
            self._told = text
            self._console.say(text)


def run_throw(url: str, count: int, stop: Stop, console: Console) -> int:
    """Run the program; return the number of balls that were not thrown.

    Raises:
        BusError: The bus cannot be opened.
    """
    bus = Bus(url)
    node = Node(bus, Identity(Role.OPERATOR), console.say)
    node.activity = "asking for balls"
    request = ThrowRequest(bus, node, count, console)

    def turn() -> None:
        request.turn()
        if not request.left:
            stop.ask()

    run_node(node, bus.wait, stop, turn)
    return request.left
