"""Messages to the bytes of a NatNet packet: what a client says, and what Motive says, for the emulator."""

from collections.abc import Callable, Sequence
from functools import singledispatch
from socket import inet_aton
from struct import error as StructError  # noqa: N812
from struct import pack
from typing import TypeVar

from imolo.errors import NatNetError
from imolo_drivers.natnet import messages as m
from imolo_drivers.natnet import wire
from imolo_drivers.natnet.wire import DefinitionType, MessageId, Version

T = TypeVar("T")


def encode(message: m.Message, version: Version) -> bytes:
    """Return the packet of a message; what `version` has no place for is left out (assets, names of body markers).

    Raises:
        NatNetVersionError: `version` is not supported.
        NatNetError: A number does not fit into its field, or the packet is too long.
    """
    wire.check_version(version)
    try:
        number, body = _body(message, version)
    except (StructError, OverflowError, OSError) as error:
        raise NatNetError(f"{type(message).__name__} cannot be encoded: {error}") from None
    if wire.HEADER.size + len(body) > wire.MAX_PACKET:
        raise NatNetError(f"{type(message).__name__} has {len(body)} bytes, more than a UDP packet holds")
    return wire.HEADER.pack(number, len(body)) + body


@singledispatch
def _body(message: m.Message, version: Version) -> tuple[MessageId, bytes]:
    raise NatNetError(f"{type(message).__name__} is not a NatNet message")


@_body.register
def _(message: m.Frame, version: Version) -> tuple[MessageId, bytes]:
    parts = [
        wire.COUNT.pack(message.number),
        _section(version, message.marker_sets, _marker_set),
        _section(version, message.other_markers, _vector),
        _section(version, message.rigid_bodies, _rigid_body),
        _section(version, message.skeletons, _skeleton),
        _section(version, message.assets, _asset) if wire.has_assets(version) else b"",
        _section(version, message.markers, _marker),
        _section(version, message.force_plates, _channels),
        _section(version, message.devices, _channels),
        wire.TIMES.pack(
            *message.timecode, message.timestamp, message.mid_exposure, message.data_received, message.transmitted
        ),
    ]
    if message.precision_time is not None and wire.may_have_precision_time(version):
        parts.append(wire.PRECISION_TIME.pack(*message.precision_time))
    parts += [wire.FLAGS.pack(message.flags), wire.END.pack(0)]
    return MessageId.FRAME, b"".join(parts)


@_body.register
def _(message: m.ModelDefinitions, version: Version) -> tuple[MessageId, bytes]:
    definitions = [
        definition
        for definition in message.definitions
        if wire.has_assets(version) or not isinstance(definition, m.AssetDefinition)
    ]
    parts = [wire.COUNT.pack(len(definitions))]
    for definition in definitions:
        kind, content = _definition(definition, version)
        parts += [wire.COUNT.pack(kind), _sized(version, content)]
    return MessageId.MODEL_DEFINITIONS, b"".join(parts)


@_body.register
def _(message: m.ServerInfo, version: Version) -> tuple[MessageId, bytes]:
    group = message.multicast_group
    return MessageId.SERVER_INFO, b"".join(
        [
            _padded_name(message.name),
            wire.VERSIONS.pack(*message.server_version, *message.natnet_version, 0, 0),
            wire.CONNECTION.pack(
                message.clock_frequency, message.data_port, group is not None, inet_aton(group or "0.0.0.0")
            ),
        ]
    )


@_body.register
def _(message: m.Connect, version: Version) -> tuple[MessageId, bytes]:
    number = MessageId.DISCOVERY if isinstance(message, m.Discovery) else MessageId.CONNECT
    versions = wire.VERSIONS.pack(0, 0, 0, 0, *message.natnet_version, 0, 0)
    return number, _padded_name(message.name) + versions


@_body.register
def _(message: m.Request, version: Version) -> tuple[MessageId, bytes]:
    return MessageId.REQUEST, _string(message.command)


@_body.register
def _(message: m.Response, version: Version) -> tuple[MessageId, bytes]:
    return MessageId.RESPONSE, message.content


@_body.register
def _(message: m.ModelDefinitionsRequest, version: Version) -> tuple[MessageId, bytes]:
    return MessageId.REQUEST_MODEL_DEFINITIONS, b""


@_body.register
def _(message: m.MessageString, version: Version) -> tuple[MessageId, bytes]:
    return MessageId.MESSAGE_STRING, _string(message.text)


@_body.register
def _(message: m.Disconnect, version: Version) -> tuple[MessageId, bytes]:
    return MessageId.DISCONNECT, b""


@_body.register
def _(message: m.KeepAlive, version: Version) -> tuple[MessageId, bytes]:
    return MessageId.KEEP_ALIVE, b""


@_body.register
def _(message: m.EchoRequest, version: Version) -> tuple[MessageId, bytes]:
    return MessageId.ECHO_REQUEST, wire.ECHO.pack(message.sent)


@_body.register
def _(message: m.EchoResponse, version: Version) -> tuple[MessageId, bytes]:
    return MessageId.ECHO_RESPONSE, wire.ECHO_ANSWER.pack(message.sent, message.received)


@_body.register
def _(message: m.UnrecognizedRequest, version: Version) -> tuple[MessageId, bytes]:
    return MessageId.UNRECOGNIZED_REQUEST, b""


def _string(text: str) -> bytes:
    return text.encode() + b"\0"


def _name(name: str) -> bytes:
    encoded = name.encode()
    if len(encoded) > wire.MAX_NAME or b"\0" in encoded:
        raise NatNetError(
            f"the name {name[:20]!r} cannot be sent: {len(encoded)} bytes, at most {wire.MAX_NAME} without 0"
        )
    return encoded + b"\0"


def _padded_name(name: str) -> bytes:
    return _name(name).ljust(wire.NAME_BYTES, b"\0")


def _sized(version: Version, content: bytes) -> bytes:
    return wire.COUNT.pack(len(content)) + content if wire.has_sizes(version) else content


def _list(things: Sequence[T], pack: Callable[[T], bytes]) -> bytes:
    return wire.COUNT.pack(len(things)) + b"".join(map(pack, things))


def _section(version: Version, things: Sequence[T], pack: Callable[[T], bytes]) -> bytes:
    return wire.COUNT.pack(len(things)) + _sized(version, b"".join(map(pack, things)))


def _vector(vector: m.Vector3) -> bytes:
    return wire.VECTOR.pack(*vector)


def _marker_set(markers: m.MarkerSet) -> bytes:
    return _name(markers.name) + _list(markers.positions, _vector)


def _rigid_body(body: m.RigidBody) -> bytes:
    return wire.RIGID_BODY.pack(body.body_id, *body.position, *body.quaternion, body.mean_error, body.flags)


def _skeleton(skeleton: m.Skeleton) -> bytes:
    return wire.COUNT.pack(skeleton.skeleton_id) + _list(skeleton.bodies, _rigid_body)


def _asset(asset: m.Asset) -> bytes:
    return wire.COUNT.pack(asset.asset_id) + _list(asset.bodies, _rigid_body) + _list(asset.markers, _marker)


def _marker(marker: m.LabelledMarker) -> bytes:
    if not 0 <= marker.marker_id <= 0xFFFF:
        raise NatNetError(f"marker_id {marker.marker_id} does not fit into 16 bits")
    number = marker.model_id << 16 | marker.marker_id
    return wire.MARKER.pack(number, *marker.position, marker.size, marker.flags, marker.residual)


def _channels(device: m.AnalogChannels) -> bytes:
    samples = [wire.COUNT.pack(len(channel)) + pack(f"<{len(channel)}f", *channel) for channel in device.channels]
    return wire.CHANNEL_OWNER.pack(device.device_id, len(samples)) + b"".join(samples)


def _definition(definition: m.Definition, version: Version) -> tuple[DefinitionType, bytes]:
    match definition:
        case m.MarkerSetDefinition():
            return DefinitionType.MARKER_SET, _name(definition.name) + _list(definition.marker_names, _name)
        case m.RigidBodyDefinition():
            return DefinitionType.RIGID_BODY, _body_definition(definition, version)
        case m.SkeletonDefinition(name, skeleton_id, bodies):
            return DefinitionType.SKELETON, _name(name) + wire.COUNT.pack(skeleton_id) + _bodies(bodies, version)
        case m.ForcePlateDefinition():
            return DefinitionType.FORCE_PLATE, _force_plate_definition(definition)
        case m.DeviceDefinition():
            return DefinitionType.DEVICE, _device_definition(definition)
        case m.CameraDefinition(name, position, quaternion):
            return DefinitionType.CAMERA, _name(name) + wire.CAMERA_POSE.pack(*position, *quaternion)
        case m.AssetDefinition(name, asset_type, asset_id, bodies, markers):
            ids = wire.TWO_NUMBERS.pack(asset_type, asset_id)
            return DefinitionType.ASSET, _name(name) + ids + _bodies(bodies, version) + _list(markers, _asset_marker)


def _bodies(bodies: Sequence[m.RigidBodyDefinition], version: Version) -> bytes:
    return _list(bodies, lambda body: _body_definition(body, version))


def _body_definition(body: m.RigidBodyDefinition, version: Version) -> bytes:
    parts = [_name(body.name), wire.BODY_PLACE.pack(body.body_id, body.parent_id, *body.offset)]
    parts.append(_list([marker.position for marker in body.markers], _vector))
    parts += [wire.COUNT.pack(marker.active_label) for marker in body.markers]
    if wire.has_body_marker_names(version):
        parts += [_name(marker.name) for marker in body.markers]
    return b"".join(parts)


def _force_plate_definition(plate: m.ForcePlateDefinition) -> bytes:
    shape = (plate.width, plate.length, *plate.origin, *plate.calibration, *plate.corners)
    return b"".join(
        [
            wire.COUNT.pack(plate.plate_id),
            _name(plate.serial_number),
            wire.FORCE_PLATE_SHAPE.pack(*shape),
            wire.TWO_NUMBERS.pack(plate.plate_type, plate.channel_type),
            _list(plate.channel_names, _name),
        ]
    )


def _device_definition(device: m.DeviceDefinition) -> bytes:
    return b"".join(
        [
            wire.COUNT.pack(device.device_id),
            _name(device.name) + _name(device.serial_number),
            wire.TWO_NUMBERS.pack(device.device_type, device.channel_type),
            _list(device.channel_names, _name),
        ]
    )


def _asset_marker(marker: m.AssetMarkerDefinition) -> bytes:
    return _name(marker.name) + wire.ASSET_MARKER.pack(marker.marker_id, *marker.position, marker.size, marker.flags)
