"""Arguments and options that commands of several folders share."""

import os
from pathlib import Path
from typing import Annotated

import typer

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""The default of `Jobs`: the cores that this process may use, as `taskset` and containers set them."""

ConfigPath = Annotated[Path, typer.Argument(help="YAML of the backend and everything around it, see configs/.")]
Method = Annotated[str, typer.Option(help="Method of the config whose planner is used.")]
Jobs = Annotated[int, typer.Option(min=1, help="Number of processes [default: one per core].", show_default=False)]
