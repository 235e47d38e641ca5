"""A session of whole programs with a stranger on its network."""

import re
import struct
import time
from pathlib import Path

import pytest
from live_table import Learned
from network import URL
from programs import PATIENCE, lab

from imolo.contracts.trial import EventName
from imolo.messaging import channels
from imolo.messaging.bus import Bus
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import read_log
from imolo_msgs import actuator_command_t, mocap_frame_t

NOISE = struct.pack(">q", 0x1234567890ABCDEF) + bytes(40)  # of a type of somebody else
STRANGER = 7


@pytest.mark.usefixtures("network")
def test_session_outlives_strangers_and_follows_none_of_them(learned: Learned, tmp_path: Path) -> None:
    bus = Bus(URL)
    commands = learned.config.motion.commands(learned.config.training.motions[0], 400_000)
    with lab(learned.config_path, learned.table_path, tmp_path, "realtime") as there:
        backend, planner = there.backend(), there.planner()
        throw = there.throw(1)
        backend.wait_for(rf"planner {planner.pid} is here")
        bus.subscribe(channels.MOCAP, lambda frame: bus.publish(*answer(frame)))

        def answer(frame: mocap_frame_t) -> tuple[str, actuator_command_t]:
            for channel in CHANNELS:
                bus.publish_raw(channel, NOISE)
            return channels.ACTUATOR_COMMAND, commands.to_message(frame.utime, 1, STRANGER)

        deadline = time.monotonic() + PATIENCE
        while not any(re.search(r"ball 0( is void|: )", line) for line in backend.lines):
            assert time.monotonic() < deadline, "the first trial does not end"
            bus.wait(0.05)
        bus.close()
        backend.wait_for(r"commander 7 commands the robot beside planner")
        backend.wait_for(r"ball 0 is void, to be repeated: stop the other program on this bus")
        backend.wait_for(r"ball 0: (touch|ball_landed)")
        assert (throw.wait(), planner.stop(), backend.stop()) == (0, 0, 0)
    void = read_log(sorted((tmp_path / "void").glob("hit_000_*.lcmlog"))[0])
    assert STRANGER not in {message.commander for message in void.messages[channels.ACTUATOR_COMMAND]}
    assert void.messages[channels.TRIAL][-1].event == EventName.END
    for program in (backend, planner):
        assert not any("Traceback" in line for line in program.lines)
