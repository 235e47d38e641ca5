"""A trial whose bus is on the network has one program alone that commands and plays it."""

from collections.abc import Callable
from pathlib import Path

import played_trials as trials
import pytest
from live.network import URL, namespace

from imolo.config.experiment import ExperimentConfig
from imolo.contracts.trial import EventName
from imolo.errors import TrialVoidError
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.log import read_log
from imolo.messaging.transport import MemoryTransport
from imolo.trials.trial import Bystander, run_trial
from imolo_msgs import trial_event_t

THETA = (0.5, 0.25)


def on_the_network() -> ExperimentConfig:
    return trials.config("mujoco").model_copy(update={"bus": URL})


def disturbed(path: Path, disturb: Callable[[Bus], None]) -> str:
    """Play a trial beside another program on its bus; return why it is void."""
    with namespace():
        other = Bus(URL)
        with pytest.raises(TrialVoidError) as void:
            run_trial(on_the_network(), TRIAL, Bystander(), path, 0.05, lambda _: disturb(other))
        other.close()
    assert f"void: {void.value}" in read_log(path).messages[channels.TRIAL][-1].detail
    return str(void.value)


TRIAL = trials.Trial(trials.TrialKind.TRAINING, 0, 1)


def test_command_of_another_program_voids_the_trial_in_one_line(tmp_path: Path) -> None:
    told = disturbed(tmp_path / "log", lambda bus: bus.publish(channels.ACTUATOR_COMMAND, trials.command(10_000)))
    assert told == f"another program commands the robot on the bus {URL}; stop it, or give it another bus"


def test_second_trial_on_the_bus_voids_the_first_before_anybody_commands(tmp_path: Path) -> None:
    event = trial_event_t()
    event.event = EventName.START.value
    told = disturbed(tmp_path / "log", lambda bus: bus.publish(channels.TRIAL, event))
    assert told.startswith("another program plays a trial on the bus")


def test_bytes_of_a_stranger_and_our_own_commands_void_nothing(tmp_path: Path) -> None:
    with namespace():
        other = Bus(URL)
        sent = []

        def answer(frame: object) -> object:
            sent.append(frame)
            other.publish_raw(channels.ACTUATOR_COMMAND, b"of somebody else")
            other.publish_raw(channels.TRIAL, bytes(48))
            return trials.command(10_000)

        run_trial(on_the_network(), TRIAL, trials.Commander(answer), tmp_path / "log", 0.1)
        other.close()
    log = read_log(tmp_path / "log")
    assert len(log.messages[channels.ACTUATOR_COMMAND]) == len(sent) > 5  # the same bytes, again and again


def test_two_programs_that_say_the_same_are_told_apart() -> None:
    bus, heard = Bus("memq://"), []
    bus.subscribe_foreign(channels.ACTUATOR_COMMAND, heard.append)
    message = trials.command(10_000)
    for _ in range(3):
        bus.publish(channels.ACTUATOR_COMMAND, message)
    bus._transport.publish(channels.ACTUATOR_COMMAND, message.encode())
    bus.drain()
    assert len(heard) == 1


class LateTransport(MemoryTransport):
    """Gives what was sent only to those who wait, as a network does."""

    def __init__(self) -> None:
        super().__init__()
        self._under_way: list[tuple[str, bytes]] = []

    def publish(self, channel: str, data: bytes) -> None:
        self._under_way.append((channel, data))

    def wait(self, timeout: float) -> bool:
        for sent in self._under_way:
            super().publish(*sent)
        self._under_way.clear()
        return True


def test_last_word_of_a_trial_is_waited_for() -> None:
    bus, heard = Bus("memq://"), []
    bus._transport = LateTransport()
    bus.subscribe_foreign(channels.TRIAL, heard.append)
    bus.subscribe_raw(lambda channel, data: heard.append(channel))
    bus.publish(channels.TRIAL, trial_event_t())
    bus.settle(channels.TRIAL)
    assert heard == [channels.TRIAL]
