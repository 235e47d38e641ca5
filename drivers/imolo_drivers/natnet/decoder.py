"""Bytes of a NatNet packet to messages; whatever the bytes are, the outcome is a message or a `NatNetError`.

Nothing is made before the packet was seen to be long enough for it, so a count that lies costs no memory.
"""

from collections.abc import Callable
from socket import inet_ntoa
from struct import Struct
from typing import Any, TypeVar

from imolo.errors import NatNetError
from imolo_drivers.natnet import messages as m
from imolo_drivers.natnet import wire
from imolo_drivers.natnet.wire import DefinitionType, MessageId, Version

T = TypeVar("T")


def decode(packet: bytes, version: Version | None) -> m.Message:
    """Decode one packet.

    Args:
        packet: A whole datagram; what follows the length in its header is ignored.
        version: The version that the server announced; None before that, when frames and model definitions cannot be
            read yet.

    Raises:
        NatNetVersionError: `version`, or the one that a `ServerInfo` announces, is not supported.
        NatNetError: The packet is truncated, of an unknown kind, or does not follow the layout of its version.
    """
    if version is not None:
        wire.check_version(version)
    if len(packet) < wire.HEADER.size:
        raise NatNetError(f"truncated packet: {len(packet)} bytes do not hold a header of {wire.HEADER.size}")
    number, size = wire.HEADER.unpack_from(packet)
    if len(packet) - wire.HEADER.size < size:
        raise NatNetError(
            f"truncated packet: message {number} announces {size} bytes, {len(packet) - wire.HEADER.size} came"
        )
    reader = _Reader(packet, wire.HEADER.size, wire.HEADER.size + size)
    if number == MessageId.FRAME:
        return _frame(reader, _known(version, "a frame"))
    if number == MessageId.MODEL_DEFINITIONS:
        return _model_definitions(reader, _known(version, "model definitions"))
    if number not in _SIMPLE:
        raise NatNetError(f"unknown message {number} of {size} bytes")
    return _SIMPLE[number](reader)


def _known(version: Version | None, what: str) -> Version:
    if version is None:
        raise NatNetError(f"{what} came before the server told its version of NatNet")
    return version


class _Reader:
    """A place in a packet, and the end that nothing may be read beyond."""

    def __init__(self, data: bytes, at: int, end: int) -> None:
        self.data = data
        self.at = at
        self.end = end

    @property
    def left(self) -> int:
        """Bytes up to the end."""
        return self.end - self.at

    def read(self, layout: Struct) -> tuple[Any, ...]:
        self._need(layout.size)
        values = layout.unpack_from(self.data, self.at)
        self.at += layout.size
        return values

    def read_all(self, layout: Struct, count: int) -> list[tuple[Any, ...]]:
        self._need(layout.size * count)
        end = self.at + layout.size * count
        values = list(layout.iter_unpack(memoryview(self.data)[self.at : end]))
        self.at = end
        return values

    def floats(self, count: int) -> tuple[float, ...]:
        return self.read(Struct(f"<{count}f")) if 4 * count <= self.left else self._need(4 * count)

    def count(self, smallest: int) -> int:
        """Read how many things of at least `smallest` bytes follow."""
        (count,) = self.read(wire.COUNT)
        if not 0 <= count * smallest <= self.left:
            raise NatNetError(f"damaged packet: byte {self.at - 4} counts {count} things, {self.left} bytes are left")
        return int(count)

    def string(self) -> str:
        end = self.data.find(0, self.at, min(self.end, self.at + wire.MAX_NAME + 1))
        if end < 0:
            raise NatNetError(f"damaged packet: the name at byte {self.at} has no end")
        name = self.data[self.at : end]
        self.at = end + 1
        try:
            return name.decode()
        except UnicodeDecodeError:  # a name in the alphabet of Motive's Windows, most often the Western one
            return name.decode("cp1252", errors="backslashreplace")

    def rest(self) -> bytes:
        rest = self.data[self.at : self.end]
        self.at = self.end
        return rest

    def sized(self, version: Version, read: Callable[["_Reader"], T]) -> T:
        """Read what from NatNet 4.1 on begins with its length, which content of a later revision may exceed."""
        if not wire.has_sizes(version):
            return read(self)
        (size,) = self.read(wire.COUNT)
        if not 0 <= size <= self.left:
            raise NatNetError(f"damaged packet: byte {self.at - 4} begins {size} bytes, {self.left} are left")
        part = _Reader(self.data, self.at, self.at + size)
        self.at += size
        return read(part)

    def _need(self, size: int) -> tuple[float, ...]:
        if size > self.left:
            raise NatNetError(f"damaged packet: {size} bytes expected at byte {self.at}, {self.left} are left")
        return ()


def _frame(reader: _Reader, version: Version) -> m.Frame:
    def section(smallest: int, read: Callable[[_Reader, int], T]) -> T:
        (count,) = reader.read(wire.COUNT)
        return reader.sized(version, lambda part: read(part, _checked(part, count, smallest)))

    (number,) = reader.read(wire.COUNT)
    marker_sets = section(5, lambda part, n: tuple(_marker_set(part) for _ in range(n)))
    other_markers = section(wire.VECTOR.size, _vectors)
    rigid_bodies = section(wire.RIGID_BODY.size, _rigid_bodies)
    skeletons = section(8, lambda part, n: tuple(_skeleton(part) for _ in range(n)))
    assets = section(12, lambda part, n: tuple(_asset(part) for _ in range(n))) if wire.has_assets(version) else ()
    markers = section(wire.MARKER.size, _markers)
    force_plates = section(8, lambda part, n: tuple(_channels(part) for _ in range(n)))
    devices = section(8, lambda part, n: tuple(_channels(part) for _ in range(n)))

    *timecode, timestamp, mid_exposure, data_received, transmitted = reader.read(wire.TIMES)
    precision_time = None
    if wire.may_have_precision_time(version) and reader.left >= wire.PRECISION_TIME.size + wire.FLAGS.size:
        precision_time = reader.read(wire.PRECISION_TIME)
    (flags,) = reader.read(wire.FLAGS)
    if reader.left not in (0, wire.END.size):
        raise NatNetError(
            f"damaged packet: {reader.left} bytes after frame {number}; is it of another version of NatNet than "
            f"{version[0]}.{version[1]}?"
        )
    return m.Frame(
        number=number,
        timestamp=timestamp,
        mid_exposure=mid_exposure,
        markers=markers,
        marker_sets=marker_sets,
        other_markers=other_markers,
        rigid_bodies=rigid_bodies,
        skeletons=skeletons,
        assets=assets,
        force_plates=force_plates,
        devices=devices,
        timecode=(timecode[0], timecode[1]),
        data_received=data_received,
        transmitted=transmitted,
        precision_time=precision_time,
        flags=flags,
    )


def _checked(part: _Reader, count: int, smallest: int) -> int:
    if not 0 <= count * smallest <= part.left:
        raise NatNetError(f"damaged packet: {count} things before byte {part.at}, {part.left} bytes are left for them")
    return count


def _vectors(reader: _Reader, count: int) -> tuple[m.Vector3, ...]:
    return tuple(reader.read_all(wire.VECTOR, count))


def _marker_set(reader: _Reader) -> m.MarkerSet:
    return m.MarkerSet(reader.string(), _vectors(reader, reader.count(wire.VECTOR.size)))


def _rigid_bodies(reader: _Reader, count: int) -> tuple[m.RigidBody, ...]:
    return tuple(
        m.RigidBody(values[0], values[1:4], values[4:8], values[8], values[9])
        for values in reader.read_all(wire.RIGID_BODY, count)
    )


def _skeleton(reader: _Reader) -> m.Skeleton:
    (skeleton_id,) = reader.read(wire.COUNT)
    return m.Skeleton(skeleton_id, _rigid_bodies(reader, reader.count(wire.RIGID_BODY.size)))


def _markers(reader: _Reader, count: int) -> tuple[m.LabelledMarker, ...]:
    return tuple(
        m.LabelledMarker(number >> 16, number & 0xFFFF, (x, y, z), size, flags, residual)
        for number, x, y, z, size, flags, residual in reader.read_all(wire.MARKER, count)
    )


def _asset(reader: _Reader) -> m.Asset:
    (asset_id,) = reader.read(wire.COUNT)
    bodies = _rigid_bodies(reader, reader.count(wire.RIGID_BODY.size))
    return m.Asset(asset_id, bodies, _markers(reader, reader.count(wire.MARKER.size)))


def _channels(reader: _Reader) -> m.AnalogChannels:
    device_id, count = reader.read(wire.CHANNEL_OWNER)
    _checked(reader, count, wire.COUNT.size)
    return m.AnalogChannels(device_id, tuple(reader.floats(reader.count(4)) for _ in range(count)))


def _model_definitions(reader: _Reader, version: Version) -> m.ModelDefinitions:
    definitions = []
    for _ in range(reader.count(9 if wire.has_sizes(version) else 5)):
        (kind,) = reader.read(wire.COUNT)
        if kind not in _DEFINITIONS:
            raise NatNetError(f"damaged packet: unknown model definition {kind} at byte {reader.at - 4}")
        read = _DEFINITIONS[kind]
        definitions.append(reader.sized(version, lambda part, read=read: read(part, version)))  # type: ignore[misc]
    return m.ModelDefinitions(tuple(definitions))


def _names(reader: _Reader) -> tuple[str, ...]:
    return tuple(reader.string() for _ in range(reader.count(1)))


def _marker_set_definition(reader: _Reader, version: Version) -> m.MarkerSetDefinition:
    return m.MarkerSetDefinition(reader.string(), _names(reader))


def _rigid_body_definition(reader: _Reader, version: Version) -> m.RigidBodyDefinition:
    name = reader.string()
    body_id, parent_id, *offset = reader.read(wire.BODY_PLACE)
    named = wire.has_body_marker_names(version)
    count = reader.count(wire.VECTOR.size + wire.COUNT.size + named)
    positions = _vectors(reader, count)
    labels = [label for (label,) in reader.read_all(wire.COUNT, count)]
    names = [reader.string() for _ in range(count)] if named else [""] * count
    markers = tuple(m.BodyMarkerDefinition(*marker) for marker in zip(positions, labels, names, strict=True))
    return m.RigidBodyDefinition(name, body_id, parent_id, (offset[0], offset[1], offset[2]), markers)


def _rigid_body_definitions(reader: _Reader, version: Version) -> tuple[m.RigidBodyDefinition, ...]:
    return tuple(_rigid_body_definition(reader, version) for _ in range(reader.count(1 + wire.BODY_PLACE.size)))


def _skeleton_definition(reader: _Reader, version: Version) -> m.SkeletonDefinition:
    name = reader.string()
    (skeleton_id,) = reader.read(wire.COUNT)
    return m.SkeletonDefinition(name, skeleton_id, _rigid_body_definitions(reader, version))


def _force_plate_definition(reader: _Reader, version: Version) -> m.ForcePlateDefinition:
    (plate_id,) = reader.read(wire.COUNT)
    serial_number = reader.string()
    shape = reader.read(wire.FORCE_PLATE_SHAPE)
    plate_type, channel_type = reader.read(wire.TWO_NUMBERS)
    return m.ForcePlateDefinition(
        plate_id,
        serial_number,
        width=shape[0],
        length=shape[1],
        origin=shape[2:5],
        calibration=shape[5:149],
        corners=shape[149:],
        plate_type=plate_type,
        channel_type=channel_type,
        channel_names=_names(reader),
    )


def _device_definition(reader: _Reader, version: Version) -> m.DeviceDefinition:
    (device_id,) = reader.read(wire.COUNT)
    name, serial_number = reader.string(), reader.string()
    device_type, channel_type = reader.read(wire.TWO_NUMBERS)
    return m.DeviceDefinition(device_id, name, serial_number, device_type, channel_type, _names(reader))


def _camera_definition(reader: _Reader, version: Version) -> m.CameraDefinition:
    name = reader.string()
    pose = reader.read(wire.CAMERA_POSE)
    return m.CameraDefinition(name, pose[:3], pose[3:])


def _asset_definition(reader: _Reader, version: Version) -> m.AssetDefinition:
    name = reader.string()
    asset_type, asset_id = reader.read(wire.TWO_NUMBERS)
    bodies = _rigid_body_definitions(reader, version)
    count = reader.count(1 + wire.ASSET_MARKER.size)
    return m.AssetDefinition(name, asset_type, asset_id, bodies, tuple(_asset_marker(reader) for _ in range(count)))


def _asset_marker(reader: _Reader) -> m.AssetMarkerDefinition:
    name = reader.string()
    marker_id, x, y, z, size, flags = reader.read(wire.ASSET_MARKER)
    return m.AssetMarkerDefinition(name, marker_id, (x, y, z), size, flags)


_DEFINITIONS: dict[int, Callable[[_Reader, Version], m.Definition]] = {
    DefinitionType.MARKER_SET: _marker_set_definition,
    DefinitionType.RIGID_BODY: _rigid_body_definition,
    DefinitionType.SKELETON: _skeleton_definition,
    DefinitionType.FORCE_PLATE: _force_plate_definition,
    DefinitionType.DEVICE: _device_definition,
    DefinitionType.CAMERA: _camera_definition,
    DefinitionType.ASSET: _asset_definition,
}


def _padded_name(reader: _Reader) -> str:
    """Read a name of fixed length; what stands behind its zero is left over from other packets."""
    part = _Reader(reader.data, reader.at, min(reader.end, reader.at + wire.NAME_BYTES))
    name = part.string()
    reader.at = part.end
    return name


def _server_info(reader: _Reader) -> m.ServerInfo:
    name = _padded_name(reader)
    versions = reader.read(wire.VERSIONS)
    natnet_version = (versions[4], versions[5])
    wire.check_version(natnet_version)
    if reader.left < wire.CONNECTION.size:
        raise NatNetError(f"the answer of server {name!r} is too short: it tells no clock, and so no time of exposure")
    clock_frequency, data_port, is_multicast, group = reader.read(wire.CONNECTION)
    if clock_frequency == 0:
        raise NatNetError(f"damaged packet: the clock of server {name!r} has 0 ticks per second")
    return m.ServerInfo(
        name, versions[:4], natnet_version, clock_frequency, data_port, inet_ntoa(group) if is_multicast else None
    )


def _connect(reader: _Reader) -> m.Connect:
    return m.Connect(*_client(reader))


def _discovery(reader: _Reader) -> m.Discovery:
    return m.Discovery(*_client(reader))


def _client(reader: _Reader) -> tuple[str, Version]:
    """Read who asks; clients that only say "Ping" have no version."""
    if reader.left < wire.NAME_BYTES + wire.VERSIONS.size:
        return reader.rest().partition(b"\0")[0].decode(errors="replace"), (0, 0)
    name = _padded_name(reader)
    versions = reader.read(wire.VERSIONS)
    return name, (versions[4], versions[5])


def _text(reader: _Reader) -> str:
    return reader.rest().partition(b"\0")[0].decode(errors="replace")


_SIMPLE: dict[int, Callable[[_Reader], m.Message]] = {
    MessageId.CONNECT: _connect,
    MessageId.SERVER_INFO: _server_info,
    MessageId.REQUEST: lambda reader: m.Request(_text(reader)),
    MessageId.RESPONSE: lambda reader: m.Response(reader.rest()),
    MessageId.REQUEST_MODEL_DEFINITIONS: lambda reader: m.ModelDefinitionsRequest(),
    MessageId.MESSAGE_STRING: lambda reader: m.MessageString(_text(reader)),
    MessageId.DISCONNECT: lambda reader: m.Disconnect(),
    MessageId.KEEP_ALIVE: lambda reader: m.KeepAlive(),
    MessageId.ECHO_REQUEST: lambda reader: m.EchoRequest(*reader.read(wire.ECHO)),
    MessageId.ECHO_RESPONSE: lambda reader: m.EchoResponse(*reader.read(wire.ECHO_ANSWER)),
    MessageId.DISCOVERY: _discovery,
    MessageId.UNRECOGNIZED_REQUEST: lambda reader: m.UnrecognizedRequest(),
}
