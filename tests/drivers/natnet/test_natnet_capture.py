"""A capture of a real OptiTrack system against the printout of the vendor's client and against another decoder."""

import gzip
import re
from collections.abc import Iterator
from decimal import ROUND_HALF_UP, Decimal

import natnet.data_descriptions
import natnet.data_frame
import numpy as np
from natnet.packet_buffer import PacketBuffer
from natnet.version import Version as ReferenceVersion
from natnet_capture import FOLDER, VERSION, frames, packets, recording
from natnet_pair import run_until

from imolo_drivers.natnet.client import NatNetClient
from imolo_drivers.natnet.config import NatNetConfig, NatNetServerConfig
from imolo_drivers.natnet.decoder import decode
from imolo_drivers.natnet.encoder import encode
from imolo_drivers.natnet.messages import Frame, MarkerSetDefinition, RigidBodyDefinition
from imolo_drivers.natnet.playback import Playback

PRINTED_FRAMES = 251
OF_A_FRAME = re.compile(
    r"FrameID|Timestamp|Software|System|Timecode|Other|Rigid Bod|\tx|\t-?\d|Skeletons|Labeled Marker|Force Plate|Device"
)


def printout() -> list[str]:
    with gzip.open(FOLDER / "SampleClient_output.txt.gz", "rt", encoding="utf-8") as file:
        return file.read().splitlines()


def two_places(value: float) -> str:
    """Round as Windows' printf of that time does: to 17 digits, then halves away from zero."""
    return str(Decimal(f"{value:.16e}").quantize(Decimal("0.01"), ROUND_HALF_UP))


def as_printed(frame: Frame) -> Iterator[str]:
    """What the vendor's client prints of a frame."""
    clock = recording().server.clock_frequency
    yield f"FrameID : {frame.number}"
    yield f"Timestamp : {two_places(frame.timestamp)}"
    yield f"Software latency : {two_places(1e3 * (frame.transmitted - frame.data_received) / clock)} milliseconds"
    yield f"System latency : {two_places(1e3 * (frame.transmitted - frame.mid_exposure) / clock)} milliseconds"
    yield f"Timecode : 00:00:00:0{frame.timecode[0]}.{frame.timecode[1]}"
    yield f"Other Markers [Count={len(frame.other_markers)}]"
    for place, (x, y, z) in enumerate(frame.other_markers):
        yield f"Other Marker {place} : {two_places(x)}\t{two_places(y)}\t{two_places(z)}"
    yield f"Rigid Bodies [Count={len(frame.rigid_bodies)}]"
    for body in frame.rigid_bodies:
        yield f"Rigid Body [ID={body.body_id}  Error={two_places(body.mean_error)}  Valid={body.tracked:d}]"
        yield "\tx\ty\tz\tqx\tqy\tqz\tqw"
        yield "".join(f"\t{two_places(value)}" for value in (*body.position, *body.quaternion))
    yield f"Skeletons [Count={len(frame.skeletons)}]"
    yield f"Labeled Markers [Count={len(frame.markers)}]"
    for marker in frame.markers:
        x, y, z = map(two_places, marker.position)
        yield (
            f"Labeled Marker [ModelID={marker.model_id}, MarkerID={marker.marker_id}, Occluded={marker.occluded:d}, "
            f"PCSolved={bool(marker.flags & 2):d}, ModelSolved={bool(marker.flags & 4):d}] "
            f"[size={two_places(marker.size)}] [pos={x},{y},{z}]"
        )
    yield f"Force Plate [Count={len(frame.force_plates)}]"
    yield f"Device [Count={len(frame.devices)}]"


def test_frames_are_what_the_vendors_client_printed() -> None:
    lines = printout()
    begin = next(place for place, line in enumerate(lines) if line.startswith("FrameID"))
    printed = [line for line in lines[begin:] if OF_A_FRAME.match(line)]
    ours = [line for frame in frames()[:PRINTED_FRAMES] for line in as_printed(frame)]
    assert sum(line.startswith("FrameID") for line in printed) == PRINTED_FRAMES
    assert ours == printed


def test_handshake_is_what_the_vendors_client_printed() -> None:
    lines = printout()
    server = recording().server
    assert f"Application: {server.name} (ver. {'.'.join(map(str, server.server_version))})" in lines
    assert f"NatNet Version: {server.natnet_version[0]}.{server.natnet_version[1]}.0.0" in lines
    body, *sets = recording().definitions.definitions
    assert isinstance(body, RigidBodyDefinition)
    assert (body.name, body.body_id, body.parent_id, len(body.markers)) == ("RaceQuad", 2, -1, 5)
    for definition in sets:
        assert isinstance(definition, MarkerSetDefinition)
        begin = lines.index(f"MarkerSet Name : {definition.name}") + 1
        assert tuple(lines[begin : begin + 5]) == definition.marker_names


def test_all_518_frames_follow_each_other() -> None:
    numbers = [frame.number for frame in frames()]
    assert numbers == list(range(162734, 162734 + 518))
    exposures = np.array([frame.mid_exposure for frame in frames()]) / recording().server.clock_frequency
    np.testing.assert_allclose(np.diff(exposures), 1 / 120, rtol=0.02)


def test_packets_come_out_of_the_encoder_as_they_were_recorded() -> None:
    assert [encode(frame, VERSION) for frame in frames()] == list(packets())


def test_another_decoder_reads_the_same() -> None:
    for frame, packet in zip(frames(), packets(), strict=True):
        buffer = PacketBuffer(packet)
        buffer.read("HH")
        reference = natnet.data_frame.DataFrame.read_from_buffer(buffer, ReferenceVersion(*VERSION))
        assert frame.number == reference.prefix.frame_number
        assert frame.other_markers == reference.unlabeled_marker_pos
        markers = [
            (marker.model_id, marker.marker_id, marker.pos, marker.size, marker.param, marker.residual)
            for marker in reference.labeled_markers
        ]
        assert markers == [
            (marker.model_id, marker.marker_id, marker.position, marker.size, marker.flags, marker.residual)
            for marker in frame.markers
        ]
        (body,) = reference.rigid_bodies
        assert (body.id_num, body.pos, body.rot) == (
            frame.rigid_bodies[0].body_id,
            frame.rigid_bodies[0].position,
            frame.rigid_bodies[0].quaternion,
        )
        suffix = reference.suffix
        assert (suffix.timestamp, suffix.stamp_camera_mid_exposure) == (frame.timestamp, frame.mid_exposure)


def test_the_marker_of_no_model_is_the_only_unlabelled_one() -> None:
    for frame in frames():
        assert [marker.marker_id for marker in frame.labelled] == [1, 2, 3, 4, 5]
        assert frame.unlabelled.shape == (1, 3)
        # What Motive calls other markers repeats those of the rigid body.
        assert frame.other_markers == tuple(marker.position for marker in frame.labelled)


def test_an_occluded_marker_is_missing_among_the_labelled_ones() -> None:
    frame = decode((FOLDER / "mocapframe_packet_occluded_v3.bin").read_bytes(), VERSION)
    assert isinstance(frame, Frame)
    assert [marker.marker_id for marker in frame.labelled] == [2, 3, 4, 5]
    assert [len(markers.positions) for markers in frame.marker_sets] == [5, 5]
    assert not frame.unlabelled.size


def test_played_over_udp_the_client_gets_the_same_frames() -> None:
    with Playback(recording(), NatNetServerConfig(command_port=0), speed=float("inf")) as playback:
        received: list[Frame] = []
        with NatNetClient(NatNetConfig(command_port=playback.port)) as client:
            run_until(playback, client, received, lambda: len(received) >= len(frames()))
            assert tuple(received) == frames()
            assert client.definitions == recording().definitions
            assert (client.lost, client.late, client.unreadable) == (0, 0, 0)
