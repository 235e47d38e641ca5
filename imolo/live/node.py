"""A program among others: it sends its heartbeat, hears those of the others, and says who comes and goes."""

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from imolo.errors import BusError
from imolo.live.identity import Identity, Role, mismatch, protocol
from imolo.messaging import channels
from imolo.messaging.bus import UNREADABLE, Bus
from imolo_msgs import heartbeat_t

BEAT = 0.1  # [s] between two heartbeats
SILENCE = 1.0  # [s] without a heartbeat until a program counts as lost, assumed: ten beats, for a busy machine
MOST_PEERS = 32  # programs of one session, and of those that have left it that are remembered; assumed
ECHO = 2.0  # [s] until a program must have heard its own heartbeat
ALONE = (Role.BACKEND, Role.PLANNER)  # of which a bus carries one each


@dataclass
class Peer:
    """Another program.

    Attributes:
        identity: What it is.
        instance: Which start of it; a later one is larger.
        pid: Its process.
        refused: Why it must not be worked with; empty where it may.
        activity: What it says it is doing.
        seen: When it was heard last [s].
    """

    identity: Identity
    instance: int
    pid: int
    refused: str
    activity: str
    seen: float

    def __str__(self) -> str:
        return f"{self.identity.role} {self.pid}"


class Node:
    """A place on the bus, and the peers that are known there.

    Attributes:
        instance: Which start of this program; a later one is larger.
        activity: What to tell the others.
    """

    def __init__(
        self, bus: Bus, identity: Identity, say: Callable[[str], None], now: Callable[[], float] = time.monotonic
    ) -> None:
        """Join the bus.

        Args:
            bus: Where the others are.
            identity: What this program is.
            say: Prints a line for the user.
            now: Clock of this machine [s].
        """
        self.instance = time.time_ns()
        self.activity = "starting"
        self._bus, self._identity, self._say, self._now = bus, identity, say, now
        self._peers: dict[int, Peer] = {}
        self._gone: deque[int] = deque(maxlen=MOST_PEERS)
        self._crowded = False
        self._told = ""
        self._unreadable = False
        self._begin = now()
        self._next = self._begin
        self._heard_itself = self._settled = False
        bus.subscribe_raw(self._on_heartbeat, channels.HEARTBEAT)

    def peer(self, role: Role) -> Peer | None:
        """Return the program of a role that is alive and may be worked with; None if there is none."""
        fitting = [peer for peer in self._peers.values() if peer.identity.role is role and not peer.refused]
        return max(fitting, key=lambda peer: peer.instance, default=None)

    def works_with(self, role: Role, instance: int) -> bool:
        """Return whether a program of a role is alive and may be worked with."""
        peer = self._peers.get(instance)
        return peer is not None and peer.identity.role is role and not peer.refused

    def tend(self) -> None:
        """Send a heartbeat when it is due or there is news, and give up peers that are silent."""
        now = self._now()
        if now >= self._next or self.activity != self._told:
            self._beat(now)
        for peer in [peer for peer in self._peers.values() if now - peer.seen > SILENCE]:
            self._forget(peer, f"{peer} is lost: silent for {now - peer.seen:.1f} s")
        if not self._heard_itself and now - self._begin > ECHO:
            self._heard_itself = True
            self._say(
                "nothing comes back from the bus, not even from this program: does `ip link show lo` say MULTICAST? "
                "If not: ip link set lo multicast on"
            )

    def close(self) -> None:
        """Tell the others that this program leaves."""
        self._beat(self._now(), leaving=1)

    def _beat(self, now: float, leaving: int = 0) -> None:
        self._next, self._told = now + BEAT, self.activity
        message = heartbeat_t()
        message.beat_utime = round(now * 1e6)
        message.role = self._identity.role.value
        message.instance = self.instance
        message.pid = os.getpid()
        message.protocol = protocol()
        message.node_robot = self._identity.robot
        message.clock_mode = self._identity.clock
        message.activity = self.activity
        message.leaving = leaving
        message.num_sections = len(self._identity.sections)
        message.section = list(self._identity.sections)
        message.section_digest = list(self._identity.sections.values())
        self._bus.publish(channels.HEARTBEAT, message)

    def _on_heartbeat(self, _: str, data: bytes) -> None:
        try:
            message = heartbeat_t.decode(data)
            role = Role(message.role)
        except UNREADABLE:
            if not self._unreadable:
                self._unreadable = True
                self._say("a program of another version of imolo is on this bus; it is passed over")
            return
        if message.instance == self.instance:
            self._heard_itself = True
            # All that others said before this beat has been heard; whoever was here first has been met.
            self._settled |= message.beat_utime >= round((self._begin + SILENCE) * 1e6)
        elif message.instance not in self._gone:
            self._hear(role, message)

    def _hear(self, role: Role, message: heartbeat_t) -> None:
        peer = self._peers.get(message.instance)
        if peer is None and (message.leaving or self._is_crowded()):
            return
        if peer is None:
            peer = self._welcome(role, message)
        peer.seen, peer.activity = self._now(), message.activity
        if message.leaving:
            self._gone.append(peer.instance)
            self._forget(peer, f"{peer} has left")

    def _is_crowded(self) -> bool:
        """Return whether there are more programs than any session has, and say so once."""
        if len(self._peers) < MOST_PEERS:
            return False
        if not self._crowded:
            self._crowded = True
            self._say(f"more than {MOST_PEERS} programs are on this bus; newcomers are passed over, give another --bus")
        return True

    def _welcome(self, role: Role, message: heartbeat_t) -> Peer:
        sections = dict(zip(message.section, message.section_digest, strict=True))
        identity = Identity(role, message.node_robot, message.clock_mode, sections)
        refused = mismatch(self._identity, identity, message.protocol)
        peer = Peer(identity, message.instance, message.pid, refused, message.activity, self._now())
        earlier = role is self._identity.role and role in ALONE and message.instance < self.instance
        if earlier and not self._settled:
            raise BusError(f"another {peer} is on this bus already; stop it, or give another --bus")
        self._peers[peer.instance] = peer
        if earlier:
            # A newcomer gives way; a program that is at work does not.
            self._say(f"another {peer} has come to this bus; it is passed over")
        else:
            self._say(f"{peer} is refused, nothing will move: {refused}" if refused else f"{peer} is here")
        # The newcomer need not wait for the next beat.
        self._next = 0.0
        return peer

    def _forget(self, peer: Peer, why: str) -> None:
        del self._peers[peer.instance]
        self._say(why)
