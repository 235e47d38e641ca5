"""Addresses as a user writes them."""

from imolo.errors import ConfigError
from imolo_drivers.board.server import PORT


def parse_address(text: str, default_port: int = PORT) -> tuple[str, int]:
    """Return host and port of HOST or HOST:PORT.

    Raises:
        ConfigError: It is neither.
    """
    host, colon, port = text.rpartition(":")
    if not colon:
        host, port = text, str(default_port)
    if not host or not port.isdigit() or not int(port) < 65536:
        raise ConfigError(f"{text!r} is no address; give HOST or HOST:PORT, such as 127.0.0.1:{default_port}")
    return host, int(port)
