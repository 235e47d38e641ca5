"""How many processes are taken where nobody says."""

import subprocess
import sys


def test_processes_are_as_many_as_the_cores_that_may_be_used() -> None:
    program = "import os; os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])\n"
    program += "from imolo.command_line.options import CORES; print(CORES)"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ended.stdout == "1\n"
