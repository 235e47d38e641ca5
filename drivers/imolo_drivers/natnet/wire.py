"""What decoder and encoder must agree on: message ids, layouts and what differs between the versions of NatNet.

Where each fact comes from is in docs/natnet.md.
"""

from enum import IntEnum
from struct import Struct

from imolo.errors import NatNetVersionError

Version = tuple[int, int]
SUPPORTED: tuple[Version, ...] = ((3, 0), (3, 1), (4, 0), (4, 1))


class MessageId(IntEnum):
    """The first two bytes of a packet."""

    CONNECT = 0
    SERVER_INFO = 1
    REQUEST = 2
    RESPONSE = 3
    REQUEST_MODEL_DEFINITIONS = 4
    MODEL_DEFINITIONS = 5
    FRAME = 7
    MESSAGE_STRING = 8
    DISCONNECT = 9
    KEEP_ALIVE = 10
    ECHO_REQUEST = 12
    ECHO_RESPONSE = 13
    DISCOVERY = 14
    UNRECOGNIZED_REQUEST = 100


class DefinitionType(IntEnum):
    """What a model definition describes."""

    MARKER_SET = 0
    RIGID_BODY = 1
    SKELETON = 2
    FORCE_PLATE = 3
    DEVICE = 4
    CAMERA = 5
    ASSET = 6


NAME_BYTES = 256  # the name in the fixed part of connect and server info, padded with zeros
MAX_NAME = NAME_BYTES - 1  # bytes of any name without the zero at its end
MAX_PACKET = 65507  # the most that UDP over IPv4 carries

HEADER = Struct("<HH")  # message id, bytes that follow
COUNT = Struct("<i")
VECTOR = Struct("<3f")
VERSIONS = Struct("<8B")  # of the program, of its NatNet
CONNECTION = Struct("<QHB4s")  # ticks per second, data port, is it multicast, group
ECHO = Struct("<Q")
ECHO_ANSWER = Struct("<QQ")
RIGID_BODY = Struct("<i3f4ffH")  # id, position, quaternion xyzw, mean error, flags
MARKER = Struct("<I3ffHf")  # id, position, size, flags, residual
CHANNEL_OWNER = Struct("<ii")  # id, number of channels
TIMES = Struct("<IIdQQQ")  # timecode, subframe, software time, mid-exposure, received, transmitted
PRECISION_TIME = Struct("<II")  # seconds, fraction
FLAGS = Struct("<H")
END = Struct("<i")
BODY_PLACE = Struct("<ii3f")  # id, parent id, offset
FORCE_PLATE_SHAPE = Struct("<ff3f144f12f")  # width, length, origin, 12 x 12 calibration, four corners
TWO_NUMBERS = Struct("<ii")
CAMERA_POSE = Struct("<3f4f")
ASSET_MARKER = Struct("<i3ffH")  # id, position, size, flags


def check_version(version: Version) -> None:
    """Raise unless packets of this version can be read and written.

    Raises:
        NatNetVersionError: Another version.
    """
    if version not in SUPPORTED:
        raise NatNetVersionError(
            f"NatNet {version[0]}.{version[1]} is not supported, only {', '.join(f'{a}.{b}' for a, b in SUPPORTED)}; "
            "use a version of Motive that speaks one of these"
        )


def has_sizes(version: Version) -> bool:
    """Tell whether sections say their length in bytes."""
    return version >= (4, 1)


def has_assets(version: Version) -> bool:
    """Tell whether frames hold assets."""
    return version >= (4, 1)


def has_body_marker_names(version: Version) -> bool:
    """Tell whether the definition of a rigid body names its markers."""
    return version >= (4, 0)


def may_have_precision_time(version: Version) -> bool:
    """Tell whether a frame may hold a precision time; the length of its end tells whether it does."""
    return version >= (4, 0)
