"""Arguments and options that commands of several folders share."""

import os
from typing import Annotated

import typer

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""The default of `Jobs`: the cores that this process may use, as `taskset` and containers set them."""

MOST_BALLS, LARGEST_SEED = 2**31 - 1, 2**63 - 1  # what messages hold

Config = Annotated[
    str, typer.Argument(metavar="CONFIG", help="A backend by name, or a YAML as `imolo config` writes it.")
]
Bus = Annotated[str, typer.Option(help="LCM URL.")]
Method = Annotated[str, typer.Option(help="Method of the config whose planner is used.")]
Jobs = Annotated[int, typer.Option(min=1, help="Number of processes.", show_default="one per core")]
