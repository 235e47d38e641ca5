"""The page docs/wire.md names every field of every message that a planner hears or says, and no other."""

import re
from pathlib import Path

import imolo_msgs
from imolo.live import lockstep, node, remote_planner, throw_program
from imolo.messaging.channels import CHANNELS

PAGE = (Path(__file__).parents[2] / "docs" / "wire.md").read_text(encoding="utf-8")
SECTIONS = re.findall(r"^### (?:`(\w+)`|inside): `(\w+)`\n(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL)
WATCHED_ONLY = {"ACTUATOR_STATE", "TRUTH_ROBOT", "TRUTH_BALL"}  # which no planner needs


def test_each_channel_has_its_type_and_every_field() -> None:
    assert {channel for channel, _, _ in SECTIONS} - {""} == set(CHANNELS) - WATCHED_ONLY
    for channel, name, text in SECTIONS:
        if channel:
            assert CHANNELS[channel].message_type.__name__ == name
        rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
        fields = re.findall(r"`(\w+)`", "".join(rows))
        assert sorted(fields) == sorted(getattr(imolo_msgs, name).__slots__), name


def test_times_are_those_of_the_code() -> None:
    assert (node.BEAT, node.SILENCE) == (0.1, 1.0)
    assert (lockstep.FIRST_RESEND, lockstep.LAST_RESEND) == (0.005, 0.1)
    assert (remote_planner.UNANSWERED, throw_program.REPEAT) == (0.2, 0.2)
