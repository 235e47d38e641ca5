"""The reference of the command line, from the app itself."""

import re

import typer
import typer.cli
import typer.main

from imolo.command_line.main import app


def page() -> str:
    """Return the commands with their arguments and options, as Markdown."""
    command = typer.main.get_command(app)
    text = typer.cli.get_docs_for_click(obj=command, ctx=typer.Context(command, info_name="imolo"), name="imolo")
    # The list of commands is the page's own table of contents, and cuts what it says.
    _, _, commands = text.partition("\n## ")
    return re.sub(r"^\* `--help`: Show this message and exit\.\n", "", f"## {commands}", flags=re.MULTILINE)
