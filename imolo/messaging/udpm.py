"""URLs of LCM over UDP multicast: checked before LCM sees them, since LCM starts deaf where its port is taken."""

import errno
import ipaddress
import socket

from imolo.errors import BusError, did_you_mean

SCHEME = "udpm://"
DEFAULT = "239.255.76.67:7667"  # of LCM
LOCAL_URL = f"{SCHEME}{DEFAULT}?ttl=0"  # ttl=0 stays on this machine
SETTINGS = {"ttl": (0, 255), "recv_buf_size": (1, 2**31 - 1), "transmit_only": (0, 1)}
# Linux grants at most net.core.rmem_max, by default 200 kB to 4 MB; with 4 MB a burst of 20,000 messages arrives.
RECEIVE_BUFFER = 4_000_000  # [bytes]
MULTICAST_RECIPE = (
    "for udpm:// on one machine: `ip link set lo multicast on; ip route add 224.0.0.0/4 dev lo`, "
    "and ?ttl=0 in the URL; without a network use memq://"
)


def check_url(url: str) -> str:
    """Check that LCM can send and receive on a udpm URL, and ask for a receive buffer that holds a burst.

    Returns:
        The URL, with `recv_buf_size` where it had none.

    Raises:
        BusError: The URL is wrong, no route leads to its group, or another program keeps its port.
    """
    place, _, query = url.removeprefix(SCHEME).partition("?")
    address, _, port_text = (place or DEFAULT).partition(":")
    port = _number("port", port_text or DEFAULT.partition(":")[2], (1, 65535), url)
    try:
        multicast = ipaddress.IPv4Address(address).is_multicast
    except ValueError:
        multicast = False
    if not multicast:
        raise BusError(f"the bus {url!r} names {address!r}; give a multicast address 224.0.0.0 to 239.255.255.255")
    settings = [one.partition("=") for one in query.split("&") if one]
    for name, _, value in settings:
        if name not in SETTINGS:
            raise BusError(
                f"the bus {url!r} has an unknown setting {name!r}{did_you_mean(name, SETTINGS)}; "
                f"known: {', '.join(SETTINGS)}"
            )
        _number(name, value, SETTINGS[name], url)
    _try_to_send(url, address, port)
    _try_to_listen(url, port)
    if not any(name == "recv_buf_size" for name, _, _ in settings):
        query = "&".join((*filter(None, (query,)), f"recv_buf_size={RECEIVE_BUFFER}"))
    return f"{SCHEME}{address}:{port}?{query}"


def _number(name: str, text: str, bounds: tuple[int, int], url: str) -> int:
    lowest, highest = bounds
    if not (text.isascii() and text.isdigit() and lowest <= int(text) <= highest):
        raise BusError(f"the bus {url!r} has {name} {text!r}; give {lowest} to {highest}")
    return int(text)


def _try_to_send(url: str, address: str, port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((address, port))
        except OSError as error:
            raise BusError(f"no multicast route for the bus {url!r} ({error.strerror}); {MULTICAST_RECIPE}") from error


def _try_to_listen(url: str, port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        # As LCM does, so that other programs of ours may listen as well.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("", port))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise BusError(f"cannot listen on UDP port {port} for the bus {url!r}: {error.strerror}") from error
            raise BusError(
                f"UDP port {port} of the bus {url!r} is occupied by a program that does not share it; "
                f"`ss -lunp sport = :{port}` names it: stop it, or give another port"
            ) from error
