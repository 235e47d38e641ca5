"""`imolo new robot NAME` and `imolo new engine NAME`; they import what they need themselves."""

from pathlib import Path
from typing import Annotated

import typer

from imolo.command_line.terminal import say

new = typer.Typer(no_args_is_help=True, help="Write the starting files of your own robot or engine.")
app = typer.Typer()
app.add_typer(new, name="new")

Name = Annotated[str, typer.Argument(help="A Python name in small letters, such as my_arm.")]
Folder = Annotated[Path | None, typer.Option(metavar="FOLDER", help="Where to.", show_default="a new folder NAME here")]


@new.command()
def robot(name: Name, out: Folder = None) -> None:
    """Write a robot that runs at once.

    Model, defaults, entry point and test; see docs/adding-a-robot.md.
    """
    _write("robot", name, out, f"imolo check --robot {name}")


@new.command()
def engine(name: Name, out: Folder = None) -> None:
    """Write an engine that runs at once.

    Adapter, entry point and test; see docs/adding-an-engine.md.
    """
    _write("engine", name, out, f"imolo check {name} --only clock")


def _write(kind: str, name: str, out: Path | None, check: str) -> None:
    from imolo.scaffold.files import write_files

    folder = out if out is not None else Path(name)
    for path in write_files(kind, name, folder):
        say(f"{path}")
    say(f"next: pip install --editable {folder}, then {check}")
