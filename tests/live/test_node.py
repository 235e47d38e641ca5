"""Heartbeats: who is here, who is lost, and who must not work with whom."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from imolo.config.experiment import ExperimentConfig
from imolo.config.loading import config_for
from imolo.errors import BusError
from imolo.live import node as node_module
from imolo.live.identity import Identity, Role, mismatch, protocol, shared_sections
from imolo.live.node import ECHO, SILENCE, Node
from imolo.messaging import channels
from imolo.messaging.bus import Bus

CONFIG = config_for("mujoco")
BACKEND = Identity(Role.BACKEND, "liberobot", "realtime", shared_sections(CONFIG))
PLANNER = Identity(Role.PLANNER, "liberobot", "", shared_sections(CONFIG))


class Network:
    """Nodes on one bus, and what they said."""

    def __init__(self) -> None:
        self.bus, self.time = Bus(), 0.0
        self.said: dict[Role, list[str]] = {role: [] for role in Role}

    def join(self, identity: Identity) -> Node:
        return Node(self.bus, identity, self.said[identity.role].append, lambda: self.time)

    def run(self, *nodes: Node, duration: float = 0.3) -> None:
        for _ in range(round(duration / 0.05)):
            self.time += 0.05
            for one in nodes:
                one.tend()
            self.bus.drain()


@pytest.fixture
def network() -> Network:
    return Network()


@pytest.mark.parametrize("order", [(BACKEND, PLANNER), (PLANNER, BACKEND)])
def test_backend_and_planner_find_each_other_in_any_order(network: Network, order: tuple[Identity, Identity]) -> None:
    first = network.join(order[0])
    network.run(first)
    second = network.join(order[1])
    network.run(first, second)
    for one, other in ((first, order[1]), (second, order[0])):
        peer = one.peer(other.role)
        assert peer is not None
        assert peer.identity == other
    assert [len(network.said[role]) for role in (Role.BACKEND, Role.PLANNER)] == [1, 1]


def test_silent_planner_is_lost_and_may_return(network: Network) -> None:
    backend, planner = network.join(BACKEND), network.join(PLANNER)
    network.run(backend, planner)
    network.run(backend, duration=SILENCE - 0.2)
    assert backend.peer(Role.PLANNER) is not None
    network.run(backend, duration=0.4)
    assert backend.peer(Role.PLANNER) is None
    assert "is lost: silent for 1." in network.said[Role.BACKEND][-1]
    network.run(backend, planner)
    assert backend.peer(Role.PLANNER) is not None


def test_planner_that_leaves_is_gone_at_once(network: Network) -> None:
    backend, planner = network.join(BACKEND), network.join(PLANNER)
    network.run(backend, planner)
    planner.close()
    network.bus.drain()
    assert backend.peer(Role.PLANNER) is None
    assert network.said[Role.BACKEND][-1].endswith("has left")


def motion(**changes: object) -> ExperimentConfig:
    return CONFIG.model_copy(update={"motion": CONFIG.motion.model_copy(update=changes)})


@pytest.mark.parametrize(
    ("planner", "why"),
    [
        (replace(PLANNER, robot="atlas"), "it is for robot"),
        (replace(PLANNER, sections=shared_sections(motion(target_range=(0.0, 0.8e6)))), "its config differs in motion"),
        (replace(PLANNER, sections={"motion": "0", "another": "1"}), "its config differs in motion;"),
    ],
)
def test_mismatch_is_told_in_one_line_on_both_sides_and_nobody_works(
    network: Network, planner: Identity, why: str
) -> None:
    nodes = network.join(BACKEND), network.join(planner)
    network.run(*nodes, duration=2.0)
    assert nodes[0].peer(Role.PLANNER) is nodes[1].peer(Role.BACKEND) is None
    (line,) = network.said[Role.BACKEND]
    assert "is refused, nothing will move" in line
    assert why in line
    (line,) = network.said[Role.PLANNER]
    assert "is refused, nothing will move" in line


def test_program_in_another_language_states_what_it_knows_and_is_answered() -> None:
    """It has neither the hash of our message types nor the sections of a config."""
    for sections in ({}, {"motion": BACKEND.sections["motion"]}, {"another": "1"}):
        stranger = replace(PLANNER, sections=sections)
        assert mismatch(BACKEND, stranger, 0) == mismatch(stranger, BACKEND, protocol()) == ""
    assert "it is for robot" in mismatch(BACKEND, replace(PLANNER, robot="atlas", sections={}), 0)


def test_other_message_types_are_refused(network: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "same version of imolo" in mismatch(BACKEND, PLANNER, protocol() + 1)
    backend, planner = network.join(BACKEND), network.join(PLANNER)
    backend.tend()
    monkeypatch.setattr(node_module, "protocol", lambda: 1)
    planner.tend()
    network.bus.drain()
    assert backend.peer(Role.PLANNER) is None
    assert "other message types" in network.said[Role.BACKEND][0]


def test_heartbeat_that_cannot_be_read_is_told_once(network: Network) -> None:
    backend = network.join(BACKEND)
    for _ in range(3):
        network.bus.publish_raw(channels.HEARTBEAT, b"nonsense of another version")
    network.run(backend)
    assert network.said[Role.BACKEND] == ["a program of another version of imolo is on this bus; it is passed over"]


def test_config_of_backend_and_surroundings_may_differ() -> None:
    other = config_for("dart", seed=7, bus="memq://", simulation={"timestep": 5e-4})
    assert shared_sections(other) == shared_sections(CONFIG)


def test_motion_of_the_table_is_what_counts() -> None:
    changed = motion(target_range=(0.0, 0.8e6))
    assert shared_sections(CONFIG, changed.motion) == shared_sections(changed)
    assert shared_sections(changed) != shared_sections(CONFIG)


@pytest.mark.parametrize("identity", [BACKEND, PLANNER])
def test_second_of_its_kind_gives_way(network: Network, identity: Identity) -> None:
    first = network.join(identity)
    network.run(first)
    second = network.join(identity)
    with pytest.raises(BusError, match=rf"another {identity.role} \d+ is on this bus already; stop it"):
        network.run(first, second)


def test_bus_that_does_not_carry_our_own_heartbeat_is_told() -> None:
    said: list[str] = []
    now = 0.0
    deaf = _Deaf()
    node = Node(deaf, BACKEND, said.append, lambda: now)  # type: ignore[arg-type]
    for now in (0.0, ECHO / 2, ECHO + 0.1, 2 * ECHO):  # noqa: B007 (the clock reads it)
        node.tend()
    assert len(said) == 1
    assert "ip link set lo multicast on" in said[0]


class _Deaf:
    def publish(self, channel: str, message: object) -> None:
        pass

    def subscribe_raw(self, handler: Callable[[str, bytes], None], channel: str) -> None:
        pass
