"""`imolo` on a bad network: run as `python chaos.py SEED SHARE COMMAND ...`.

Of all packets that the program sends, the share is lost, the share is sent twice, and the share is held back for up to
20 ms, behind later ones.
"""

import heapq
import itertools
import random
import sys
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import lcm

import imolo.messaging.transport
from imolo.command_line.main import main

LONGEST_DELAY = 0.02  # [s]


class ChaoticLCM:
    """LCM with a bad network behind `udpm://`; everything else is as it is."""

    rng = random.Random(0)
    share = 0.0

    def __init__(self, url: str) -> None:
        self._lcm = lcm.LCM(url)
        self._chaotic = url.startswith("udpm://")
        self._held: list[tuple[float, int, str, bytes]] = []
        self._order = itertools.count()

    def publish(self, channel: str, data: bytes) -> None:
        if not self._chaotic:
            self._lcm.publish(channel, data)
            return
        if self._happens():
            return
        for _ in range(2 if self._happens() else 1):
            if self._happens():
                due = time.monotonic() + self.rng.uniform(0.0, LONGEST_DELAY)
                heapq.heappush(self._held, (due, next(self._order), channel, data))
            else:
                self._lcm.publish(channel, data)
        self._release()

    def subscribe(self, channel: str, handler: Callable[[str, bytes], None]) -> Any:
        return self._lcm.subscribe(channel, handler)

    def unsubscribe(self, subscription: Any) -> None:
        self._lcm.unsubscribe(subscription)

    def handle_timeout(self, timeout: int) -> int:
        self._release()
        return int(self._lcm.handle_timeout(timeout))

    def fileno(self) -> int:
        return int(self._lcm.fileno())

    def _happens(self) -> bool:
        return self.rng.random() < self.share

    def _release(self) -> None:
        while self._held and self._held[0][0] <= time.monotonic():
            _, _, channel, data = heapq.heappop(self._held)
            self._lcm.publish(channel, data)


if __name__ == "__main__":
    _, seed, share, *command = sys.argv
    ChaoticLCM.rng, ChaoticLCM.share = random.Random(int(seed)), float(share)
    imolo.messaging.transport.lcm = SimpleNamespace(LCM=ChaoticLCM)  # type: ignore[attr-defined]
    sys.argv = ["imolo", *command]
    main()
