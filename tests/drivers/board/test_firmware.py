"""The C structs of `make headers`, as an author of firmware uses them: compiled, and the same bytes as ours."""

import subprocess
import sys
from pathlib import Path

import pytest
from board_link import command
from hypothesis import given, settings
from hypothesis import strategies as st
from messaging.messages import messages
from requirements import needs

from imolo_drivers.board.framing import PAYLOADS, FrameType, encode_frame

ROOT = Path(__file__).parents[3]
SOURCE = Path(__file__).with_name("firmware.c")
PATIENCE = 60.0  # [s]
pytestmark = needs("cc")


@pytest.fixture(scope="module")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("firmware")
    tools = f"BIN={Path(sys.executable).parent}"
    make = ["make", "--assume-old=.venv/.ready", "headers", f"HEADERS={folder}", tools]
    subprocess.run(make, cwd=ROOT, check=True, capture_output=True, timeout=PATIENCE)
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", f"-I{folder}"]
    program = folder / "firmware"
    sources = sorted(folder.glob("*.c"))
    assert len(sources) == len(PAYLOADS) + 1  # a channel is a part of the welcome
    done = subprocess.run(
        ["gcc", *strict, "-o", program, SOURCE, *sources], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stderr
    return program


def run(firmware: Path, data: bytes) -> "subprocess.CompletedProcess[bytes]":
    return subprocess.run([firmware], input=data, capture_output=True, timeout=PATIENCE)


@given(data=st.data())
@settings(max_examples=30)
def test_firmware_reads_and_writes_the_same_bytes(firmware: Path, data: st.DataObject) -> None:
    every_type = [data.draw(messages(PAYLOADS[frame_type])) for frame_type in FrameType]
    stream = b"".join(encode_frame(message, number, 1 - number) for number, message in enumerate(every_type))
    done = run(firmware, stream)
    assert (done.returncode, done.stdout) == (0, stream)


def test_firmware_finds_the_targets_of_the_valves(firmware: Path) -> None:
    sent = command(1_000_000, sequence=7, pressure=1.25e5)
    told = run(firmware, encode_frame(sent, 0, 0)).stderr.split()
    assert list(map(int, told[:3])) == [7, 1_000_000, 2]
    phases = [told[3 + 9 * phase : 12 + 9 * phase] for phase in range(2)]
    assert [int(switch) for switch, *_ in phases] == list(sent.switch_utime)
    assert [list(map(float, targets)) for _, *targets in phases] == [list(row) for row in sent.target]


@pytest.mark.parametrize(
    ("start", "stop", "byte", "complaint"),
    [(0, None, b"X", b"magic"), (5, None, b"\x0b", b"crc"), (40, None, b"X", b"crc"), (0, 60, b"I", b"length")],
)
def test_firmware_refuses_a_damaged_frame(
    firmware: Path, start: int, stop: int | None, byte: bytes, complaint: bytes
) -> None:
    whole = encode_frame(command(0), 0, 0)
    damaged = (whole[:start] + byte + whole[start + 1 :])[:stop]
    done = run(firmware, damaged)
    assert (done.returncode, done.stdout, done.stderr.strip()) == (1, b"", complaint)
