"""Real-time priority, where the system grants it."""

import subprocess
import sys

PROGRAM = """
import os, threading
from imolo.priority import claim_priority
wait = threading.Event()
threading.Thread(target=wait.wait).start()
print(claim_priority(1))
policies = {os.sched_getscheduler(int(thread)) & ~os.SCHED_RESET_ON_FORK for thread in os.listdir("/proc/self/task")}
print(*(policy == os.SCHED_FIFO for policy in policies))
wait.set()
"""


def test_all_threads_get_the_priority_or_the_program_says_why_not() -> None:
    said, granted = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60.0
    ).stdout.splitlines()
    assert said == "real-time priority 1" if granted == "True" else said.startswith("ordinary priority (real-time")
