"""The generated message types are those of the .lcm files, and no two of them can be mistaken for each other."""

import itertools
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from messages import TYPES, messages, plain

from imolo.messaging.channels import CHANNELS

LCMTYPES = Path(__file__).parents[2] / "lcmtypes"
LCM_GEN = Path(sys.executable).with_name("lcm-gen")


def test_checked_in_code_is_what_lcm_gen_writes(tmp_path: Path) -> None:
    definitions = sorted(path.name for path in LCMTYPES.glob("*.lcm"))
    subprocess.run([LCM_GEN, "--python", "--ppath", tmp_path, *definitions], cwd=LCMTYPES, check=True, timeout=30)

    def read(folder: Path) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in (folder / "imolo_msgs").glob("*.py")}

    assert set(read(tmp_path)) == {"__init__.py", *(name.replace(".lcm", ".py") for name in definitions)}
    assert read(LCMTYPES) == read(tmp_path)


def test_every_definition_has_a_class() -> None:
    assert set(TYPES) == {path.stem for path in LCMTYPES.glob("*.lcm")}


def test_fingerprints_of_all_types_differ() -> None:
    # LCM hashes the fields, not the name of the struct: two structs with the same fields would be one type.
    assert len({one._get_packed_fingerprint() for one in TYPES.values()}) == len(TYPES)


@pytest.mark.parametrize(("sent", "expected"), list(itertools.permutations(TYPES, 2)))
def test_no_type_decodes_another(sent: str, expected: str) -> None:
    with pytest.raises(ValueError, match="Decode error"):
        TYPES[expected].decode(TYPES[sent]().encode())


@pytest.mark.parametrize("channel", CHANNELS)
@given(data=st.data())
def test_every_channel_round_trips(channel: str, data: st.DataObject) -> None:
    message_type = CHANNELS[channel].message_type
    message = data.draw(messages(message_type))
    encoded = message.encode()
    decoded = message_type.decode(encoded)
    assert plain(decoded) == plain(message)
    assert decoded.encode() == encoded


def test_channel_names_fit_into_an_lcm_packet() -> None:
    # LCM_MAX_CHANNEL_NAME_LENGTH is 63.
    assert all(name.isascii() and 0 < len(name) <= 63 for name in CHANNELS)


def test_channels_are_found_by_their_own_name() -> None:
    assert all(name == channel.name for name, channel in CHANNELS.items())
