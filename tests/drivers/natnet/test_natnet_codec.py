"""Encoder and decoder against each other, against another decoder, and against damaged packets."""

import dataclasses
import resource
import struct
import tracemalloc
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from natnet.data_descriptions import DataDescriptions
from natnet.data_frame import DataFrame
from natnet.packet_buffer import PacketBuffer
from natnet.version import Version as ReferenceVersion
from natnet_capture import packets
from natnet_messages import any_message, definitions, frames

from imolo.errors import NatNetError, NatNetVersionError
from imolo_drivers.natnet import messages as m
from imolo_drivers.natnet.decoder import decode
from imolo_drivers.natnet.encoder import encode
from imolo_drivers.natnet.wire import HEADER, SUPPORTED, MessageId, Version

EXAMPLE = m.Frame(
    7,
    0.5,
    markers=(m.LabelledMarker(1, 2, (0.25, 0.5, 0.75)),),
    marker_sets=(m.MarkerSet("all", ((0.0, 1.0, 2.0),)),),
    rigid_bodies=(m.RigidBody(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 0.0),),
    force_plates=(m.AnalogChannels(1, ((0.5, 1.5), ())),),
    assets=(m.Asset(5, (), (m.LabelledMarker(5, 1, (0.0, 0.0, 0.0)),)),),
)
FAST = settings(max_examples=25, suppress_health_check=list(HealthCheck), deadline=None)

versions = pytest.mark.parametrize("version", SUPPORTED)


@versions
@FAST
@given(data=st.data())
def test_every_message_survives_encoding_and_decoding(version: Version, data: st.DataObject) -> None:
    message = data.draw(any_message(version))
    assert decode(encode(message, version), version) == message


@versions
@FAST
@given(data=st.data())
def test_another_decoder_reads_our_frames(version: Version, data: st.DataObject) -> None:
    frame = data.draw(frames(version))
    buffer = PacketBuffer(encode(frame, version))
    buffer.read("HH")
    reference = DataFrame.read_from_buffer(buffer, ReferenceVersion(*version))
    assert [(body.id_num, body.pos, body.rot) for body in reference.rigid_bodies] == [
        (body.body_id % 2**32, body.position, body.quaternion) for body in frame.rigid_bodies
    ]
    assert [(marker.model_id, marker.marker_id, marker.pos, marker.param) for marker in reference.labeled_markers] == [
        (marker.model_id, marker.marker_id, marker.position, marker.flags) for marker in frame.markers
    ]
    assert [marker_set.marker_pos_list for marker_set in reference.marker_sets] == [
        marker_set.positions for marker_set in frame.marker_sets
    ]
    assert [device.channel_arrays for device in (*reference.force_plates, *reference.devices)] == [
        device.channels for device in (*frame.force_plates, *frame.devices)
    ]
    assert [len(skeleton.rigid_bodies) for skeleton in reference.skeletons] == [
        len(skeleton.bodies) for skeleton in frame.skeletons
    ]
    assert [len(asset.markers) for asset in reference.assets or ()] == [len(asset.markers) for asset in frame.assets]
    assert reference.suffix.timestamp == frame.timestamp
    assert reference.suffix.stamp_transmit == frame.transmitted


@versions
@FAST
@given(data=st.data())
def test_another_decoder_reads_our_model_definitions(version: Version, data: st.DataObject) -> None:
    # Its force plates have three corners, ours four as in the vendor's NatNetTypes.h, so these are left out.
    ours = data.draw(definitions(version))
    ours = m.ModelDefinitions(tuple(one for one in ours.definitions if not isinstance(one, m.ForcePlateDefinition)))
    buffer = PacketBuffer(encode(ours, version))
    buffer.read("HH")
    reference = DataDescriptions.read_from_buffer(buffer, ReferenceVersion(*version))
    assert buffer.pointer == len(buffer.data)
    assert [(one.name, one.marker_names) for one in reference.marker_sets] == [
        (one.name, one.marker_names) for one in ours.definitions if isinstance(one, m.MarkerSetDefinition)
    ]
    assert [
        (one.name, [(marker.pos, marker.name or "") for marker in one.markers]) for one in reference.rigid_bodies
    ] == [
        (one.name, [(marker.position, marker.name) for marker in one.markers])
        for one in ours.definitions
        if isinstance(one, m.RigidBodyDefinition)
    ]
    assert [(one.name, [marker.marker_id for marker in one.marker_descriptions]) for one in reference.assets] == [
        (one.name, [marker.marker_id % 2**32 for marker in one.markers])
        for one in ours.definitions
        if isinstance(one, m.AssetDefinition)
    ]


def test_messages_have_the_numbers_of_the_vendor() -> None:
    """NatNetTypes.h; what our two ends agree on alone would be no NatNet."""
    vendor = (0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 12, 13, 14, 100)
    assert tuple(MessageId) == vendor


def test_messages_cannot_be_changed() -> None:
    """Those who share one, as the emulator's clients do, rely on it."""
    kinds = [kind for kind in vars(m).values() if dataclasses.is_dataclass(kind)]
    assert len(kinds) > 20
    assert all(kind.__dataclass_params__.frozen for kind in kinds)


@versions
def test_a_packet_cut_short_anywhere_is_named_so(version: Version) -> None:
    packet = encode(EXAMPLE, version)
    for length in range(len(packet)):
        with pytest.raises(NatNetError, match="truncated packet"):
            decode(packet[:length], version)


@versions
def test_a_frame_whose_end_is_missing_is_refused_even_if_the_header_agrees(version: Version) -> None:
    whole = encode(EXAMPLE, version)
    without_end = len(whole) - 4  # the last four bytes are no part of the frame in every program that sends them
    for length in range(HEADER.size, len(whole)):
        packet = HEADER.pack(MessageId.FRAME, length - HEADER.size) + whole[HEADER.size : length]
        if length == without_end:
            assert decode(packet, version) == decode(whole, version)
            continue
        with pytest.raises(NatNetError):
            decode(packet, version)


@versions
def test_a_frame_read_as_another_layout_is_refused(version: Version) -> None:
    packet = encode(EXAMPLE, version)
    for other in SUPPORTED:
        if (other >= (4, 1)) != (version >= (4, 1)):
            with pytest.raises(NatNetError):
                decode(packet, other)


@pytest.mark.parametrize("version", [(2, 9), (2, 11), (3, 2), (4, 2), (5, 0), (0, 0)])
def test_an_unknown_version_is_refused_and_the_known_ones_are_told(version: Version) -> None:
    told = rf"NatNet {version[0]}\.{version[1]} is not supported, only 3\.0, 3\.1, 4\.0, 4\.1"
    with pytest.raises(NatNetVersionError, match=told):
        decode(encode(EXAMPLE, (3, 0)), version)
    with pytest.raises(NatNetVersionError, match=told):
        encode(EXAMPLE, version)
    server = m.ServerInfo("Motive", (1, 9, 0, 0), version, 1000, 1511, None)
    with pytest.raises(NatNetVersionError, match=told):
        decode(encode(server, (3, 0)), None)


def test_frames_before_the_handshake_are_refused() -> None:
    with pytest.raises(NatNetError, match="before the server told"):
        decode(encode(EXAMPLE, (3, 0)), None)


@pytest.mark.parametrize(
    ("packet", "reason"),
    [
        (HEADER.pack(77, 0), "unknown message 77"),
        (HEADER.pack(MessageId.ECHO_RESPONSE, 3) + b"abc", "16 bytes expected"),
        (HEADER.pack(MessageId.MODEL_DEFINITIONS, 9) + struct.pack("<iib", 1, 9, 0), "unknown model definition 9"),
        (HEADER.pack(MessageId.MODEL_DEFINITIONS, 10) + struct.pack("<ii", 1, 0) + b"ab", "has no end"),
        (encode(m.ServerInfo("Motive", (3, 1, 0, 0), (4, 1), 1000, 1511, None), (4, 1))[:-15], "truncated packet"),
        (HEADER.pack(MessageId.SERVER_INFO, 264) + bytes(260) + bytes((3, 1, 0, 0)), "is too short: it tells no clock"),
        (HEADER.pack(MessageId.MODEL_DEFINITIONS, 4) + struct.pack("<i", -1), "counts -1"),
    ],
)
def test_what_is_wrong_is_told(packet: bytes, reason: str) -> None:
    with pytest.raises(NatNetError, match=reason):
        decode(packet, (3, 0))


@pytest.mark.parametrize(
    ("encoded", "name"),
    [
        ("Schl\u00e4ger".encode(), "Schl\u00e4ger"),
        ("Schl\u00e4ger".encode("cp1252"), "Schl\u00e4ger"),
        ("\u6746".encode("gbk") + b"1", "\u00b8\u00cb1"),
        (b"\xff\x81\x8d", "\u00ff\\x81\\x8d"),
    ],
)
def test_a_name_in_any_alphabet_is_read(encoded: bytes, name: str) -> None:
    packet = HEADER.pack(MessageId.MODEL_DEFINITIONS, 13 + len(encoded))
    packet += struct.pack("<ii", 1, 0) + encoded + b"\0" + struct.pack("<i", 0)
    assert decode(packet, (3, 0)) == m.ModelDefinitions((m.MarkerSetDefinition(name, ()),))


@versions
@pytest.mark.parametrize("count", [2**31 - 1, -1, -(2**31), 2**28])
def test_a_count_that_lies_costs_no_memory(version: Version, count: int) -> None:
    packet = bytearray(encode(EXAMPLE, version))
    tracemalloc.start()
    try:
        for place in range(HEADER.size, len(packet) - 4):
            damaged = bytes(packet[:place]) + struct.pack("<i", count) + bytes(packet[place + 4 :])
            try:
                decode(damaged, version)
            except NatNetError:
                continue
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_what_does_not_fit_cannot_be_encoded() -> None:
    for message in (
        m.Frame(2**31, 0.0),
        m.Frame(0, 0.0, mid_exposure=-1),
        m.Frame(0, 0.0, markers=(m.LabelledMarker(0, 2**16, (0.0, 0.0, 0.0)),)),
        m.Frame(0, 0.0, other_markers=((0.0, 0.0, 1e300),)),
        m.Frame(0, 0.0, other_markers=((0.0, 0.0, 0.0),) * 6000),
        m.ModelDefinitions((m.MarkerSetDefinition("long" * 64, ()),)),
        m.ModelDefinitions((m.MarkerSetDefinition("with\0zero", ()),)),
    ):
        with pytest.raises(NatNetError):
            encode(message, (4, 1))


def mutate(packet: bytes, rng: Random) -> bytes:
    """Damage a packet: bytes, numbers, length; four of five keep a header that agrees with their length."""
    damaged = bytearray(packet)
    for _ in range(rng.randrange(1, 4)):
        place = rng.randrange(len(damaged))
        match rng.randrange(5):
            case 0:
                damaged[place] = rng.randrange(256)
            case 1:
                damaged[place : place + 4] = struct.pack("<i", rng.choice(INTERESTING))
            case 2:
                del damaged[max(place, 1) :]
            case 3:
                begin = rng.randrange(len(damaged))
                damaged[place:place] = damaged[begin : begin + rng.randrange(1, 40)]
            case 4:
                damaged[place : place + 4] = rng.randbytes(4)
    if rng.random() < 0.8 and len(damaged) >= HEADER.size:
        struct.pack_into("<H", damaged, 2, len(damaged) - HEADER.size)
    return bytes(damaged)


INTERESTING = (0, 1, -1, 2, 255, 256, 0x7FFF, 0x8000, 0xFFFF, 2**31 - 1, -(2**31))


def seeds(version: Version) -> list[bytes]:
    """Packets of every kind."""
    found: list[bytes] = [encode(EXAMPLE, version)]

    @settings(max_examples=150, derandomize=True, database=None, suppress_health_check=list(HealthCheck), deadline=None)
    @given(any_message(version))
    def collect(message: m.Message) -> None:
        found.append(encode(message, version))

    collect()
    if version == (3, 0):
        found += packets()[::100]
    return [packet for packet in found if len(packet) < 2000]


def fuzz(version: Version, rounds: int) -> int:
    """Return how many damaged packets could still be read."""
    rng = Random(repr(version))
    packets_of_all_kinds = seeds(version)
    readable = 0
    for _ in range(rounds):
        packet = mutate(rng.choice(packets_of_all_kinds), rng)
        try:
            message = decode(packet, version)
        except NatNetError:
            continue
        readable += 1
        if isinstance(message, m.Frame | m.ModelDefinitions):
            # What was read is what is there: it comes out the same when written and read again.
            written = encode(message, version)
            assert encode(decode(written, version), version) == written
    return readable


@versions
def test_damaged_packets_are_read_or_refused(version: Version) -> None:
    assert 0 < fuzz(version, 2_000) < 2_000


@pytest.mark.slow
@versions
def test_a_million_damaged_packets_are_read_or_refused(version: Version) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert 0 < fuzz(version, 250_000) < 250_000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # [kB]
