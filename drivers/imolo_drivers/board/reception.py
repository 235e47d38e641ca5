"""Who is let in to the board: version, types, role and secret of a client, and what it is told then."""

import hmac

from imolo.method.commands import to_microseconds
from imolo_drivers.board.board import Board
from imolo_drivers.board.config import BoardConfig
from imolo_drivers.board.framing import VERSION
from imolo_drivers.board.handshake import ClientRole, type_mismatch
from imolo_drivers.board.refusal import RefusalCode, RefusedError, quote
from imolo_msgs import board_channel_t, board_hello_t, board_welcome_t

NO_SECRET = "name the same file as `secret` on both sides (imolo arm --secret FILE)"


def check_hello(hello: board_hello_t) -> None:
    """Check that board and client can understand each other.

    Raises:
        RefusedError: They cannot.
    """
    if hello.hello_version != VERSION:
        older = "the client" if hello.hello_version < VERSION else "the board"
        reason = f"the client speaks version {hello.hello_version} of the protocol, this board {VERSION}"
        raise RefusedError(RefusalCode.VERSION, f"{reason}; update imolo at {older}")
    if different := type_mismatch(hello.hello_type, hello.hello_fingerprint):
        reason = f"the client has other message types: {different}; run both from the same version of imolo"
        raise RefusedError(RefusalCode.TYPES, reason)
    if hello.client_role not in list(ClientRole):
        role = quote(hello.client_role)
        raise RefusedError(RefusalCode.ROLE, f"unknown role {role!r}; known: {', '.join(ClientRole)}")


def check_proof(given: bytes, expected: bytes) -> None:
    """Check that the other end knows the secret.

    Raises:
        RefusedError: It does not.
    """
    if not hmac.compare_digest(given, expected):
        raise RefusedError(RefusalCode.SECRET, f"the client does not know the secret of this board; {NO_SECRET}")


def make_welcome(config: BoardConfig, board: Board, controller: str) -> board_welcome_t:
    """Return what the board tells of itself.

    Args:
        config: Of the board.
        board: Its state.
        controller: Who the controller is; empty if there is none.
    """
    message = board_welcome_t()
    message.welcome_version = VERSION
    message.board_name, message.board_robot = config.name, config.robot
    message.controller_session, message.controller_name = board.session, controller
    message.num_board_channels, message.board_channels = len(config.channels), _channels(config)
    message.watchdog_time = to_microseconds(config.watchdog)
    message.state_interval = to_microseconds(1.0 / config.state_rate)
    message.is_dry_run = int(board.dry_run)
    message.entered_at_welcome = board.entered
    message.state_at_welcome, message.cause_at_welcome = board.state, board.cause
    return message


def _channels(config: BoardConfig) -> list[board_channel_t]:
    messages = []
    for channel in config.channels:
        message = board_channel_t()
        message.channel_name, message.channel_unit = channel.name, channel.unit
        message.lowest_target, message.highest_target = channel.lowest, channel.highest
        message.target_limit, message.slew_limit = config.limit(channel), config.slew_limit(channel)
        messages.append(message)
    return messages
