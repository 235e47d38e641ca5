"""Real-time priority for the programs that a clock on the wall drives."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

THREADS = Path("/proc/self/task")
# Of SCHED_FIFO, where 1 is lowest: above all ordinary programs, below the interrupts of a real-time kernel (50).
BOARD_PRIORITY, BACKEND_PRIORITY, PLANNER_PRIORITY = 30, 20, 10


def claim_priority(priority: int) -> str:
    """Ask that this program be woken before all ordinary ones, as control loops are (SCHED_FIFO, see sched(7)).

    Without it a busy machine wakes a program milliseconds late. It sleeps most of the time, so others hardly notice. It
    holds for all threads that there are: LCM has one that receives.

    Args:
        priority: From 1 to 99.

    Returns:
        What it is now, in words.
    """
    try:
        _set_for_all_threads(os.SCHED_FIFO, priority)
    except (AttributeError, FileNotFoundError):
        return "ordinary priority (real-time priority needs Linux)"
    except PermissionError:
        return "ordinary priority (real-time priority needs root, or an rtprio limit in /etc/security/limits.conf)"
    return f"real-time priority {priority}"


@contextlib.contextmanager
def claimed_priority(priority: int) -> Iterator[str]:
    """Claim a priority, say what it is now, and be an ordinary program again at the end."""
    granted = claim_priority(priority)
    try:
        yield granted
    finally:
        if granted.startswith("real-time"):
            _set_for_all_threads(os.SCHED_OTHER, 0)


def _set_for_all_threads(policy: int, priority: int) -> None:
    for thread in THREADS.iterdir():
        os.sched_setscheduler(int(thread.name), policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
