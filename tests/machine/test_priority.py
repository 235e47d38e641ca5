"""Real-time priority, where the system grants it."""

import subprocess
import sys

PROGRAM = """
import os, threading
from imolo.machine.priority import claimed_priority
def real_time():
    threads = os.listdir("/proc/self/task")
    return {os.sched_getscheduler(int(thread)) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO for thread in threads}
wait = threading.Event()
threading.Thread(target=wait.wait).start()
with claimed_priority(1) as granted:
    print(granted)
    print(*real_time())
print(*real_time())
wait.set()
"""


def test_all_threads_get_the_priority_for_a_while_or_the_program_says_why_not() -> None:
    said, granted, kept = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60.0
    ).stdout.splitlines()
    assert said == "real-time priority 1" if granted == "True" else said.startswith("ordinary priority (real-time")
    assert kept == "False"
