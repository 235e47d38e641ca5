"""Programs that do not belong on the bus: nothing they say moves the robot or ends a program, and they are told of."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from tries import tries

from imolo.config.loading import config_for
from imolo.errors import TrialVoidError
from imolo.inspect.statistics import BusStatistics
from imolo.live.identity import Identity, Role, shared_sections
from imolo.live.lockstep import Asker
from imolo.live.node import MOST_PEERS, SILENCE, Node
from imolo.live.planner_program import PlannerProgram
from imolo.live.program import Console, Stop
from imolo.live.recorder_program import CHUNK, RecorderProgram
from imolo.live.remote_planner import VENTED, LockstepPlanner, RealtimePlanner
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log_file import read_events
from imolo_drivers.board.command import is_newer
from imolo_msgs import actuator_command_t, envelope_t, heartbeat_t, mocap_frame_t, step_answer_t, step_request_t

CONFIG = config_for("mujoco")
BACKEND = Identity(Role.BACKEND, "liberobot", "realtime", shared_sections(CONFIG))
PLANNER = Identity(Role.PLANNER, "liberobot", "", shared_sections(CONFIG))
NOISE = struct.pack(">q", 0x1234567890ABCDEF) + bytes(40)  # of a type of somebody else
STRANGER = 7


class Said(Console):
    """Keeps the lines."""

    def __init__(self) -> None:
        super().__init__("test")
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)


class Stage:
    """The backend's side of a trial in real time, in which the test is planner and stranger."""

    def __init__(self) -> None:
        self.bus, self.inside, self.console = Bus(), Bus(), Said()
        self.node = Node(self.bus, BACKEND, self.console.say)
        self.planner = Node(self.bus, PLANNER, lambda _: None)
        self.meet()
        self.trial = RealtimePlanner(CONFIG, self.bus, self.node, Stop(), self.console)
        self.trial.begin()
        self.trial.attach(self.inside)
        self.heard: list[actuator_command_t] = []
        self.inside.subscribe(channels.ACTUATOR_COMMAND, self.heard.append)

    def meet(self) -> None:
        self.planner._beat(0.0)
        self.bus.drain()

    def frame(self, utime: int) -> None:
        message = mocap_frame_t()
        message.utime = utime
        self.inside.publish(channels.MOCAP, message)
        self.inside.drain()

    def command(self, utime: int, commander: int, sequence: int = 1) -> None:
        commands = CONFIG.motion.commands(CONFIG.training.motions[0], 100_000)
        self.bus.publish(channels.ACTUATOR_COMMAND, commands.to_message(utime, sequence, commander))

    def step(self, utime: int) -> None:
        self.meet()
        self.trial.after_slice(utime)
        self.inside.drain()


def test_command_of_the_planner_moves_the_robot() -> None:
    stage = Stage()
    stage.frame(1000)
    stage.command(1000, stage.planner.instance)
    stage.step(1000)
    assert [message.commander for message in stage.heard] == [stage.planner.instance]
    assert stage.trial.lost == ""


@pytest.mark.parametrize("order", [("planner", "stranger"), ("stranger", "planner"), ("stranger",)])
@pytest.mark.parametrize("answers", [True, False], ids=["answers the frame", "answers no frame"])
def test_second_commander_vents_the_robot_and_voids_the_trial(order: tuple[str, ...], answers: bool) -> None:
    """Also where its command comes at once with one of the planner, of which the newest alone would be followed."""
    stage = Stage()
    stage.frame(1000)
    stage.command(1000, stage.planner.instance)
    stage.step(1000)
    stage.frame(9000)
    for who in order:
        if who == "planner":
            stage.command(9000, stage.planner.instance, 2)
        else:
            stage.command(9000 if answers else 12_345, STRANGER)
    stage.step(9000)
    stage.step(10_000)
    vent = stage.heard[-1]
    assert STRANGER not in {message.commander for message in stage.heard}
    assert np.array_equal(vent.target, [[channel.released for channel in CONFIG.simulation.actuators.channels]])
    assert vent.switch_utime[0] <= 10_000
    (line,) = (line for line in stage.console.lines if "commands the robot beside planner" in line)
    assert "commander 7" in line
    assert line.endswith("all channels are released")
    # Nothing is followed any more.
    stage.command(9000, stage.planner.instance, 3)
    stage.step(11_000)
    with pytest.raises(TrialVoidError, match="commander 7 commands the robot beside planner"):
        stage.step(10_000 + round(VENTED * 1e6))
    assert stage.heard[-1] is vent


@pytest.mark.parametrize("sequence", [2**31 - 1, -5, -1, -(2**31)])
def test_vent_is_newer_than_what_it_follows_past_the_end_of_the_numbers(sequence: int) -> None:
    """A valve board refuses commands that are not."""
    stage = Stage()
    stage.frame(1000)
    stage.command(1000, stage.planner.instance, sequence)
    stage.step(1000)
    stage.command(1000, STRANGER)
    stage.step(2000)
    followed, vent = stage.heard
    assert followed.command_sequence == sequence
    assert is_newer(vent.command_sequence, sequence)


def test_stranger_who_commands_at_the_very_end_voids_the_trial_as_well() -> None:
    stage = Stage()
    stage.command(0, STRANGER)
    stage.bus.drain()
    assert "commander 7" in stage.trial.lost  # which the program looks at when the trial has ended


def test_heartbeat_of_another_planner_voids_no_trial() -> None:
    stage = Stage()
    stage.bus.publish(channels.HEARTBEAT, heartbeat(stage.planner, 2**62))
    stage.step(1000)
    assert stage.trial.lost == ""


def heartbeat(node: Node, instance: int) -> heartbeat_t:
    """Return the heartbeat of a program that is like another one, but for when it was started."""
    caught: list[heartbeat_t] = []
    bus, own = Bus(), node.instance
    bus.subscribe(channels.HEARTBEAT, caught.append)
    node.instance, node._bus, network = instance, bus, node._bus
    node._beat(0.0)
    node.instance, node._bus = own, network
    bus.drain()
    return caught[0]


def test_answer_of_another_planner_is_not_heard() -> None:
    bus = Bus()
    waits = 0

    def watch() -> None:
        nonlocal waits
        waits += 1
        if waits == 2:
            answer(1, b"right")

    def answer(planner: int, data: bytes) -> None:
        message, said = step_answer_t(), envelope_t()
        message.answering_planner, message.answered_backend, message.answered_step = planner, 5, 1
        said.inner_channel, said.inner_data, said.inner_size = channels.PLAN, data, len(data)
        message.answers, message.num_answers = [said], 1
        bus.publish(channels.STEP_ANSWER, message)

    asker = Asker(bus, 5, watch)
    bus.subscribe_raw(lambda *_: answer(STRANGER, b"wrong") if waits < 2 else None, channels.STEP_REQUEST)
    bus.publish_raw(channels.STEP_ANSWER, NOISE)
    assert asker.ask(1, channels.TRIAL, b"", True, False) == [(channels.PLAN, b"right")]


class Listener:
    """A planner that notes what it hears."""

    commander = 0

    def __init__(self) -> None:
        self.frames: list[int] = []

    def attach(self, bus: Bus) -> None:
        bus.subscribe(channels.MOCAP, lambda frame: self.frames.append(frame.utime))
        bus.subscribe(channels.TRIAL, lambda _: None)

    def warm_up(self) -> None:
        pass


def request(backend: int, number: int, channel: str, data: bytes) -> step_request_t:
    message = step_request_t()
    message.asking_backend, message.step_number, message.previous_step = backend, number, number - 1
    message.asked = envelope_t()
    message.asked.inner_channel, message.asked.inner_data, message.asked.inner_size = channel, data, len(data)
    return message


def test_noise_in_a_request_is_passed_over_and_told_once(caplog: pytest.LogCaptureFixture) -> None:
    bus, listener = Bus(), Listener()
    backend = Node(bus, BACKEND, lambda _: None)
    PlannerProgram(bus, listener, PLANNER, Said())
    backend._beat(0.0)
    frame = mocap_frame_t()
    frame.utime = 8333
    asked = [(channels.MOCAP, NOISE), (channels.TRIAL, b""), ("NOBODY", NOISE), (channels.MOCAP, NOISE)]
    for number, inner in enumerate([*asked, (channels.MOCAP, frame.encode())], start=1):
        bus.publish_raw(channels.STEP_REQUEST, NOISE)
        bus.publish(channels.STEP_REQUEST, request(backend.instance, number, *inner))
        bus.publish(channels.STEP_REQUEST, request(STRANGER, number, *inner))
    bus.drain()
    assert listener.frames == [8333]
    told = sorted(record.message.split()[0] for record in caplog.records)
    assert told == [channels.MOCAP, channels.STEP_REQUEST, channels.TRIAL]


def test_heartbeat_of_another_backend_does_not_part_planner_and_backend() -> None:
    bus, listener = Bus(), Listener()
    backend = Node(bus, BACKEND, lambda _: None)
    PlannerProgram(bus, listener, PLANNER, Said())
    backend._beat(0.0)
    bus.publish(channels.HEARTBEAT, heartbeat(backend, 2**62))
    frame = mocap_frame_t()
    frame.utime = 8333
    bus.publish(channels.STEP_REQUEST, request(backend.instance, 1, channels.MOCAP, frame.encode()))
    bus.drain()
    assert listener.frames == [8333]


def test_crowd_of_programs_is_told_once_and_remembered_no_more() -> None:
    bus, said = Bus(), []
    node = Node(bus, PLANNER, said.append)
    for number in range(1, 3 * MOST_PEERS):
        bus.publish(channels.HEARTBEAT, heartbeat(node, node.instance + number))
    bus.drain()
    assert len(node._peers) == MOST_PEERS
    assert sum("is here" in line for line in said) == MOST_PEERS
    assert sum("newcomers are passed over" in line for line in said) == 1


@pytest.mark.parametrize("identity", [BACKEND, PLANNER])
def test_newcomer_gives_way_and_a_program_at_work_does_not(identity: Identity) -> None:
    bus, said, now = Bus(), [], 0.0
    node = Node(bus, identity, said.append, lambda: now)
    early = heartbeat(node, node.instance - 1)
    for now in np.arange(0.0, SILENCE + 0.3, 0.1).tolist():  # noqa: B007 (the clock reads it)
        node.tend()
        bus.drain()
    for _ in range(3):
        bus.publish(channels.HEARTBEAT, early)
        bus.drain()
    assert sum("has come to this bus; it is passed over" in line for line in said) == 1


def spoofed(rng: np.random.Generator, planner: int) -> tuple[str, bytes]:
    """Return what a stranger may send: noise, other types, parts of types, types of ours that say nothing true."""
    channel = str(rng.choice(list(CHANNELS)))
    message = CHANNELS[str(rng.choice(list(CHANNELS)))].message_type()
    if isinstance(message, heartbeat_t):
        # Started later; to one that was there before, a backend that is at its beginning gives way.
        message.instance = planner + int(rng.integers(1, 2**40))
        message.role = str(rng.choice(["backend", "planner", "nobody"]))
    if isinstance(message, step_answer_t):
        message.answering_planner = planner
    if isinstance(message, actuator_command_t) and channel == channels.ACTUATOR_COMMAND:
        return channel, NOISE  # a true one is a second commander, which voids the trial; that is tested above
    whole = message.encode()
    if rng.random() < 0.3:
        whole = whole[: rng.integers(len(whole) + 1)]
    if rng.random() < 0.3:
        whole += rng.bytes(int(rng.integers(1, 50)))
    return channel, rng.bytes(int(rng.integers(60))) if rng.random() < 0.2 else whole


def test_spoofed_messages_move_nothing_and_cost_no_memory() -> None:
    stage, rng, count = Stage(), np.random.default_rng(1), tries(2000)
    stage.frame(1000)
    stage.command(1000, stage.planner.instance)
    stage.step(1000)
    before = 0
    tracemalloc.start()
    try:
        for number in range(count):
            stage.bus.publish_raw(*spoofed(rng, stage.planner.instance))
            if number % 50 == 0:
                stage.bus.drain()
            if number == count // 2:
                before = tracemalloc.get_traced_memory()[0]
        stage.bus.drain()
        assert tracemalloc.get_traced_memory()[0] - before < 200_000
    finally:
        tracemalloc.stop()
    stage.inside.drain()
    assert stage.trial.lost == ""
    assert [message.commander for message in stage.heard] == [stage.planner.instance]
    # One line for each program that seems to be there, and there are not more of them than a session has.
    assert len(stage.console.lines) < MOST_PEERS + 20
    assert len(stage.node._peers) <= MOST_PEERS


def test_session_of_many_balls_keeps_its_memory_and_its_files(tmp_path: Path) -> None:
    """Recorder, planner and the statistics of `imolo top`, all on one bus."""
    balls, frames = tries(100), 20
    bus, heard = Bus(), 0

    class Counting(Listener):
        def attach(self, bus: Bus) -> None:
            bus.subscribe(channels.MOCAP, self.count)

        def count(self, _: mocap_frame_t) -> None:
            nonlocal heard
            heard += 1

    backend, statistics = Node(bus, BACKEND, lambda _: None), BusStatistics()
    recorder = RecorderProgram(bus, tmp_path / "session.lcmlog", Said())
    PlannerProgram(bus, Counting(), PLANNER, Said())
    bus.subscribe_raw(lambda channel, data: statistics.add(channel, data, 0.0))
    backend._beat(0.0)
    frame, number, used, descriptors = mocap_frame_t(), 0, [], []
    tracemalloc.start()
    try:
        for ball in range(balls):
            for step in range(frames):
                number += 1
                frame.utime = 8333 * (step + 1)
                asked = request(backend.instance, number, channels.MOCAP, frame.encode())
                bus.publish(channels.STEP_REQUEST, asked)
                bus.publish(channels.MOCAP, frame)
                bus.drain()
            if ball in (balls // 2, balls - 1):
                used.append(tracemalloc.get_traced_memory()[0])
                descriptors.append(len(list(Path("/proc/self/fd").iterdir())))
    finally:
        tracemalloc.stop()
        recorder._file.close()
    assert heard == balls * frames
    assert used[1] - used[0] < 200_000 + CHUNK
    assert descriptors[0] == descriptors[1]
    assert sum(event.channel == channels.MOCAP for event in read_events(tmp_path / "session.lcmlog")) == balls * frames


@pytest.mark.parametrize("channel", [channels.TRIAL, channels.MOCAP, "", "NOWHERE"])
def test_a_planner_that_speaks_as_the_backend_makes_the_trial_void(channel: str) -> None:
    bus, inside, console = Bus(), Bus(), Said()
    node, planner = Node(bus, BACKEND, console.say), Node(bus, PLANNER, lambda _: None)
    planner._beat(0.0)
    bus.drain()
    trial = LockstepPlanner(CONFIG, bus, node, Stop(), console)
    trial.begin()
    trial.attach(inside)
    heard = []
    inside.subscribe_raw(lambda channel, _: heard.append(channel))

    def answer(_: str, data: bytes) -> None:
        request = step_request_t.decode(data)
        reply = step_answer_t()
        reply.answering_planner, reply.answered_backend = planner.instance, node.instance
        reply.answered_step, reply.num_answers, reply.answers = request.step_number, 1, [envelope_t()]
        reply.answers[0].inner_channel = channel
        reply.answers[0].inner_data, reply.answers[0].inner_size = NOISE, len(NOISE)
        bus.publish(channels.STEP_ANSWER, reply)

    bus.subscribe_raw(answer, channels.STEP_REQUEST)
    inside.publish(channels.MOCAP, mocap_frame_t())
    with pytest.raises(TrialVoidError, match=f"speaks on '{channel}'; it may on ACTUATOR_COMMAND"):
        inside.drain()
    inside.drain()
    assert heard == []
