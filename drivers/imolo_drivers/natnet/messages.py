"""What NatNet says; positions are in Motive's own frame [m], quaternions are x, y, z, w.

Every message is immutable and compares by value. Fields stand in the order of the wire.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imolo_drivers.natnet.wire import Version

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Array = npt.NDArray[np.float64]

OCCLUDED = 0x01
UNLABELLED = 0x10
TRACKED = 0x01
RECORDING = 0x01
MODELS_CHANGED = 0x02


@dataclass(frozen=True)
class MarkerSet:
    """The markers of one asset, by place in its definition; the set "all" holds those of all assets."""

    name: str
    positions: tuple[Vector3, ...]


@dataclass(frozen=True)
class RigidBody:
    """A pose; bodies of a skeleton have its id in the upper half of theirs."""

    body_id: int
    position: Vector3
    quaternion: Quaternion
    mean_error: float
    flags: int = TRACKED

    @property
    def tracked(self) -> bool:
        """Whether the cameras saw it in this frame."""
        return bool(self.flags & TRACKED)


@dataclass(frozen=True)
class Skeleton:
    """The bodies of one skeleton."""

    skeleton_id: int
    bodies: tuple[RigidBody, ...]


@dataclass(frozen=True)
class LabelledMarker:
    """One entry of the list of markers, which also holds those that belong to no model.

    `model_id` and `marker_id` are the halves of the 32 bits on the wire: the streaming id of the model and the place of
    the marker in it, from 1; a marker of no model has model 0 and a running number. `residual` is in mm per ray.
    """

    model_id: int
    marker_id: int
    position: Vector3
    size: float = 0.0
    flags: int = 0
    residual: float = 0.0

    @property
    def occluded(self) -> bool:
        """Whether no camera saw it; its position then is a guess of Motive's."""
        return bool(self.flags & OCCLUDED)

    @property
    def belongs_to_model(self) -> bool:
        """Whether Motive knows which marker of which model it is."""
        return self.model_id != 0 and not self.flags & UNLABELLED

    @property
    def seen(self) -> bool:
        """Whether the position was measured: neither occluded nor without a value."""
        return not self.occluded and all(map(math.isfinite, self.position))


@dataclass(frozen=True)
class Asset:
    """A trained marker set (NatNet 4.1); the `marker_id` of its markers is the place in it."""

    asset_id: int
    bodies: tuple[RigidBody, ...]
    markers: tuple[LabelledMarker, ...]


@dataclass(frozen=True)
class AnalogChannels:
    """Samples of a force plate or device within one frame, one tuple a channel."""

    device_id: int
    channels: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Frame:
    """One frame of the cameras.

    `timestamp` [s] is Motive's software clock. `mid_exposure`, `data_received` and `transmitted` are ticks of the
    server's clock; 0 where the cameras do not tell. `precision_time` is seconds and fraction of an external clock; None
    where the frame has none. `other_markers` is a list for older clients that repeats the markers of rigid bodies
    without ids; `unlabelled` is what to use.
    """

    number: int
    timestamp: float
    mid_exposure: int = 0
    markers: tuple[LabelledMarker, ...] = ()
    marker_sets: tuple[MarkerSet, ...] = ()
    other_markers: tuple[Vector3, ...] = ()
    rigid_bodies: tuple[RigidBody, ...] = ()
    skeletons: tuple[Skeleton, ...] = ()
    assets: tuple[Asset, ...] = ()
    force_plates: tuple[AnalogChannels, ...] = ()
    devices: tuple[AnalogChannels, ...] = ()
    timecode: tuple[int, int] = (0, 0)
    data_received: int = 0
    transmitted: int = 0
    precision_time: tuple[int, int] | None = None
    flags: int = 0

    @property
    def labelled(self) -> tuple[LabelledMarker, ...]:
        """The markers that belong to a model, occluded ones included."""
        return tuple(marker for marker in self.markers if marker.belongs_to_model)

    @property
    def unlabelled(self) -> Array:
        """Positions of the seen markers that belong to no model, such as the ball [m], shape (N, 3)."""
        positions = [marker.position for marker in self.markers if marker.seen and not marker.belongs_to_model]
        return np.array(positions, dtype=np.float64).reshape(-1, 3)

    @property
    def models_changed(self) -> bool:
        """Whether the model definitions are to be asked for again."""
        return bool(self.flags & MODELS_CHANGED)


@dataclass(frozen=True)
class MarkerSetDefinition:
    """Names of the markers of one asset, in the order of `LabelledMarker.marker_id`."""

    name: str
    marker_names: tuple[str, ...]


@dataclass(frozen=True)
class BodyMarkerDefinition:
    """A marker of a rigid body; before NatNet 4.0 its name is empty, see the marker set of the body's name."""

    position: Vector3
    active_label: int = 0
    name: str = ""


@dataclass(frozen=True)
class RigidBodyDefinition:
    """A rigid body; `body_id` is the `model_id` of its markers, `parent_id` is -1 outside a skeleton."""

    name: str
    body_id: int
    parent_id: int = -1
    offset: Vector3 = (0.0, 0.0, 0.0)
    markers: tuple[BodyMarkerDefinition, ...] = ()


@dataclass(frozen=True)
class SkeletonDefinition:
    """A skeleton."""

    name: str
    skeleton_id: int
    bodies: tuple[RigidBodyDefinition, ...]


@dataclass(frozen=True)
class ForcePlateDefinition:
    """A force plate: its calibration has 12 x 12 numbers, row by row; its four corners follow each other."""

    plate_id: int
    serial_number: str
    width: float
    length: float
    origin: Vector3
    calibration: tuple[float, ...]
    corners: tuple[float, ...]
    plate_type: int
    channel_type: int
    channel_names: tuple[str, ...]


@dataclass(frozen=True)
class DeviceDefinition:
    """An analog device."""

    device_id: int
    name: str
    serial_number: str
    device_type: int
    channel_type: int
    channel_names: tuple[str, ...]


@dataclass(frozen=True)
class CameraDefinition:
    """A camera and where it stands."""

    name: str
    position: Vector3
    quaternion: Quaternion


@dataclass(frozen=True)
class AssetMarkerDefinition:
    """A marker of a trained marker set; `marker_id` is that of its `LabelledMarker`."""

    name: str
    marker_id: int
    position: Vector3
    size: float = 0.0
    flags: int = 0


@dataclass(frozen=True)
class AssetDefinition:
    """A trained marker set (NatNet 4.1); `asset_id` is the `model_id` of its markers."""

    name: str
    asset_type: int
    asset_id: int
    bodies: tuple[RigidBodyDefinition, ...]
    markers: tuple[AssetMarkerDefinition, ...]


Definition = (
    MarkerSetDefinition
    | RigidBodyDefinition
    | SkeletonDefinition
    | ForcePlateDefinition
    | DeviceDefinition
    | CameraDefinition
    | AssetDefinition
)


@dataclass(frozen=True)
class ModelDefinitions:
    """All that the server streams, in its order."""

    definitions: tuple[Definition, ...] = ()


@dataclass(frozen=True)
class ServerInfo:
    """Answer to `Connect` and `Discovery`; the clock has `clock_frequency` ticks a second; no group means unicast."""

    name: str
    server_version: tuple[int, int, int, int]
    natnet_version: Version
    clock_frequency: int
    data_port: int
    multicast_group: str | None


@dataclass(frozen=True)
class Connect:
    """A client asks who is there; in unicast it subscribes to the frames."""

    name: str = "imolo"
    natnet_version: Version = (4, 1)


@dataclass(frozen=True)
class Discovery(Connect):
    """A client asks who is there, without connecting."""


@dataclass(frozen=True)
class Request:
    """A command to Motive in words."""

    command: str


@dataclass(frozen=True)
class Response:
    """Answer to a `Request`, as it is."""

    content: bytes


@dataclass(frozen=True)
class ModelDefinitionsRequest:
    """A client asks for `ModelDefinitions`."""


@dataclass(frozen=True)
class MessageString:
    """Text for whoever looks."""

    text: str


@dataclass(frozen=True)
class Disconnect:
    """A unicast client ends."""


@dataclass(frozen=True)
class KeepAlive:
    """A unicast client is still there."""


@dataclass(frozen=True)
class EchoRequest:
    """A client asks for the server's clock; `sent` is any number of its own."""

    sent: int


@dataclass(frozen=True)
class EchoResponse:
    """The number of the `EchoRequest`, and the server's clock [ticks] when it came."""

    sent: int
    received: int


@dataclass(frozen=True)
class UnrecognizedRequest:
    """The server did not know what to do."""


Message = (
    Frame
    | ModelDefinitions
    | ServerInfo
    | Connect
    | Request
    | Response
    | ModelDefinitionsRequest
    | MessageString
    | Disconnect
    | KeepAlive
    | EchoRequest
    | EchoResponse
    | UnrecognizedRequest
)
