"""`imolo planner`: the planner as a program of its own, in lock-step or in real time, as the backend says."""

import gc
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from imolo.config.experiment import ExperimentConfig
from imolo.contracts.planner import Planner
from imolo.contracts.registry import PLANNERS
from imolo.errors import ConfigError, did_you_mean
from imolo.live.identity import Identity, Role, shared_sections
from imolo.live.lockstep import Answerer, Said
from imolo.live.node import Node
from imolo.live.program import Console, Stop, run_node
from imolo.live.streams import Latency, Streams, is_start
from imolo.machine.priority import PLANNER_PRIORITY, claim_priority
from imolo.messaging import channels
from imolo.messaging.bus import UNREADABLE, Bus
from imolo.method.table import LookupTable
from imolo_msgs import step_request_t


class _Inside(Bus):
    """The planner's own bus, without a queue: what it is told it hears, and what it says is heard, at once."""

    def __init__(self, hear: Callable[[str, bytes], None], strange: Callable[[str], None]) -> None:
        """Hand everything that is published to `hear`, and the channel of what cannot be read to `strange`."""
        super().__init__()
        self._hear, self._tell_strange = hear, strange

    def publish_raw(self, channel: str, data: bytes) -> None:
        """Hand a message over."""
        self._hear(channel, data)

    def tell(self, channel: str, data: bytes) -> None:
        """Let the planner hear a message."""
        self._transport.publish(channel, data)
        self.drain()

    def pass_over(self, channel: str) -> None:
        """Tell of what cannot be read."""
        self._tell_strange(channel)


class PlannerProgram:
    """Hosts a planner on a bus of its own and carries messages between that and the network."""

    def __init__(self, bus: Bus, controller: Planner, identity: Identity, console: Console) -> None:
        """Join the network.

        Args:
            bus: The network.
            controller: The planner.
            identity: What this program is.
            console: Where to print.
        """
        self._bus, self._console = bus, console
        self._node = Node(bus, identity, console.say)
        self._answerer = Answerer(self._node.instance, self._answer)
        self._streams, self._latency = Streams(), Latency()
        self._skipped = self._unreadable = 0
        self._paced = False
        self._backend = 0
        self._said: list[Said] = []
        self._inside = _Inside(self._hear, self._pass_over)
        self._controller = controller
        controller.attach(self._inside)
        bus.subscribe_raw(self._on_request, channels.STEP_REQUEST)
        bus.subscribe_raw(self._on_event, channels.TRIAL)
        bus.subscribe_newest(channels.MOCAP, self._on_frame, self._skip)

    def run(self, stop: Stop) -> None:
        """Answer until stopped."""
        self._node.activity = "waiting for a backend"
        # What is there now stays; the collector need not look at it again in the middle of a motion.
        gc.collect()
        gc.freeze()
        run_node(self._node, self._bus.wait, stop, self._turn)
        self._console.say(f"stopped; {self._status()}")

    def _turn(self) -> None:
        backend = self._node.peer(Role.BACKEND)
        if backend is None:
            self._node.activity = "waiting for a backend"
        elif self._node.activity == "waiting for a backend":
            self._node.activity = "ready"
        self._console.status(self._status)

    def _status(self) -> str:
        skipped = f", {self._skipped} skipped" if self._skipped else ""
        skipped += f", {self._unreadable} unreadable" if self._unreadable else ""
        repeated = f", {self._answerer.repeated} answers repeated" if self._answerer.repeated else ""
        return (
            f"{self._node.activity} | {self._streams.describe(channels.MOCAP)}{skipped}{repeated} | "
            f"frame to command {self._latency}"
        )

    def _on_request(self, _: str, data: bytes) -> None:
        try:
            asking = step_request_t.decode(data).asking_backend
        except UNREADABLE:
            self._bus.pass_over(channels.STEP_REQUEST)
            return
        if self._node.works_with(Role.BACKEND, asking):
            reply = self._answerer.answer(data)
            if reply is not None:
                self._bus.publish_raw(channels.STEP_ANSWER, reply)

    def _answer(self, request: step_request_t) -> Sequence[Said]:
        if request.previous_step == 0:
            self._backend = request.asking_backend
            if request.paced and not self._paced:
                self._console.say(f"real time; {claim_priority(PLANNER_PRIORITY)}")
            self._paced = bool(request.paced)
            # In lock-step an answer says who gives it, and the log's bytes are those of a single process.
            self._controller.commander = self._node.instance if self._paced else 0
            self._node.activity = "planning in " + ("real time" if self._paced else "lock-step")
            self._streams.begin_trial()
        return self._tell(request.asked.inner_channel, request.asked.inner_data)

    def _on_event(self, channel: str, data: bytes) -> None:
        # The start comes as a request; to hear it twice would reset a planner that is at work.
        if not is_start(data):
            self._overhear(channel, data)

    def _on_frame(self, channel: str, data: bytes) -> None:
        for said in self._overhear(channel, data):
            self._bus.publish_raw(*said)

    def _overhear(self, channel: str, data: bytes) -> Sequence[Said]:
        """Return what the planner says to a message that was not sent to it alone."""
        if not (self._paced and self._node.works_with(Role.BACKEND, self._backend)):
            return ()
        return self._tell(channel, data)

    def _pass_over(self, channel: str) -> None:
        self._unreadable += 1
        self._bus.pass_over(channel)

    def _hear(self, channel: str, data: bytes) -> None:
        if self._paced and channel == channels.ACTUATOR_COMMAND:
            # Before its reasons, and before those who hear them are awake and in its way.
            self._bus.publish_raw(channel, data)
        else:
            self._said.append((channel, data))

    def _skip(self, data: bytes) -> None:
        if self._paced:
            self._skipped += 1
            self._streams.count(channels.MOCAP, data)

    def _tell(self, channel: str, data: bytes) -> Sequence[Said]:
        """Tell the planner and return what it says, but for what has been sent already."""
        begin = time.perf_counter()
        self._said.clear()
        unreadable = self._unreadable
        self._inside.tell(channel, data)
        if self._unreadable > unreadable:
            return ()
        self._streams.count(channel, data)
        if channel == channels.MOCAP:
            self._latency.add(time.perf_counter() - begin)
        return tuple(self._said)


def run_planner(
    config: ExperimentConfig, url: str, table_path: Path, method: str, stop: Stop, console: Console
) -> None:
    """Run the program.

    Raises:
        ConfigError: The method is unknown.
        TableFileError: The table cannot be read, or is for another robot.
        BusError: The bus cannot be opened, or carries another planner.
    """
    if method not in config.methods:
        raise ConfigError(
            f"unknown method {method!r}{did_you_mean(method, config.methods)}; known: {', '.join(config.methods)}"
        )
    bus = Bus(url)
    plugin = PLANNERS.load(config.methods[method].controller.name)
    planner = plugin.create(config, method, table_path, lambda _: None)
    planner.warm_up()
    # What the planner commands is that of the table, where there is one.
    template = LookupTable.load(table_path, motion=type(config.motion)).template if plugin.learns else None
    identity = Identity(Role.PLANNER, config.robot.name, sections=shared_sections(config, template))
    program = PlannerProgram(bus, planner, identity, console)
    console.say(f"method {method!r}, table {table_path} of {config.robot.name}, on {url}")
    program.run(stop)
