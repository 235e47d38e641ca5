"""A network namespace of the test's own: loopback with a multicast route, and nothing that can leave the machine."""

import contextlib
import ctypes
import os
import subprocess
from collections.abc import Iterator

import pytest
from requirements import OPTIONAL, REQUIRED

URL = "udpm://239.255.76.67:7667?ttl=0"
CLONE_NEWNET = 0x40000000


def need_netns() -> None:
    """Skip a test that cannot make a namespace, or fail it where IMOLO_REQUIRE says that it must run."""
    problem = OPTIONAL["netns"]()
    if problem and "netns" in REQUIRED:
        pytest.fail(problem)
    elif problem:
        pytest.skip(problem)


@contextlib.contextmanager
def namespace(*, route: bool = True) -> Iterator[None]:
    """Put this thread, and all processes that it starts, into a new namespace, which ends with the last of them."""
    need_netns()
    outside = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    try:
        call("unshare", CLONE_NEWNET)
        try:
            ip("link", "set", "lo", "up")
            ip("link", "set", "lo", "multicast", "on")
            if route:
                ip("route", "add", "224.0.0.0/4", "dev", "lo")
            yield
        finally:
            call("setns", outside, CLONE_NEWNET)
    finally:
        os.close(outside)


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, timeout=10)


def call(name: str, *arguments: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if getattr(libc, name)(*arguments) != 0:
        raise OSError(ctypes.get_errno(), f"{name} failed")
