"""Write what planner.c needs of a table: the motions, and when each brings the hand where.

python examples/c_planner/write_motions.py TABLE OUT
"""

import sys
from pathlib import Path

from imolo.method.table import LookupTable

table = LookupTable.load(Path(sys.argv[1]))
thetas = sorted({tuple(theta) for theta in table.theta.tolist()})
number = {theta: index for index, theta in enumerate(thetas)}
commands = [table.template.commands(theta, 0) for theta in thetas]
phases, channels = commands[0].targets.shape
with Path(sys.argv[2]).open("w", encoding="ascii") as file:
    file.write(f"{table.robot} {len(thetas)} {phases} {channels} {len(table)}\n")
    for one in commands:
        file.write(" ".join(map(str, [*one.switch_utime, *one.targets.ravel().tolist()])) + "\n")
    for row in table.time.argsort(kind="stable"):
        place = " ".join(f"{value:.3f}" for value in table.position[row])
        file.write(f"{number[tuple(table.theta[row].tolist())]} {round(table.time[row] * 1e6)} {place}\n")
