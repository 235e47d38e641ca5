"""What the pages name is there: files, commands with their options, fields of messages, and names of Python."""

import ast
import importlib
import re
from pathlib import Path
from typing import Any

import pytest
import typer.main
import yaml

from imolo.command_line.main import app
from imolo.inspect.fields import parse_selector
from imolo.messaging.channels import CHANNELS

ROOT = Path(__file__).parents[1]
PAGES = [
    path
    for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), ROOT / "drivers/README.md")
    if path.is_file() and "api" not in path.parts  # which is generated
]
FOLDERS = r"backends|benchmarks|configs|docs|drivers|examples|imolo(?:_\w+)?|lcmtypes|tools"
COMMANDS: Any = typer.main.get_command(app)

page = pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)


def anchor(heading: str) -> str:
    """Return what leads to a heading, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@page
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", page.read_text(encoding="utf-8")):
        path, _, place = link.partition("#")
        target = page.parent / path if path else page
        assert target.exists(), link
        if place:
            headings = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE)
            assert place in map(anchor, headings), link


@page
def test_files_that_are_named_are_there(page: Path) -> None:
    for name in re.findall(rf"`((?:{FOLDERS})/[\w./*-]+)`", page.read_text(encoding="utf-8")):
        assert any(list((ROOT / above).glob(name.rstrip("/"))) for above in ("", "backends", "drivers")), name


@page
def test_commands_and_options_are_there(page: Path) -> None:
    lines = re.findall(r"(?:^|`)(?:\$ )?imolo ([a-z]\w*)([^`\n#]*)", page.read_text(encoding="utf-8"), re.MULTILINE)
    for name, rest in lines:
        assert name in COMMANDS.commands, f"imolo {name}"
        command, inner = COMMANDS.commands[name], rest.split()
        if hasattr(command, "commands") and inner:
            command = command.commands[inner[0]]
        known = {option for parameter in command.params for option in parameter.opts}
        for option in re.findall(r"--[a-z][\w-]*", rest):
            assert option in {*known, "--help"}, f"imolo {name} {option}"


@page
def test_fields_are_those_of_the_messages(page: Path) -> None:
    for text in re.findall(rf"\b(?:{'|'.join(CHANNELS)})\.[a-z]\w*", page.read_text(encoding="utf-8")):
        parse_selector(text)


def blocks(page: Path, language: str) -> list[str]:
    """Return the blocks of code of a page."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def is_there(name: str) -> bool:
    """Return whether a dotted name of Python leads to something."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            found = getattr(found, part, None)
        return found is not None
    return False


@page
def test_names_of_python_are_there(page: Path) -> None:
    groups = re.findall(r'^\[project\.entry-points\."(.*)"\]', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    for name in re.findall(r"`(imolo(?:_\w+)?(?:\.\w+)+)`", page.read_text(encoding="utf-8")):
        assert name in groups or is_there(name), name
    for code in blocks(page, "python"):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("imolo"):
                for alias in node.names:
                    assert is_there(f"{node.module}.{alias.name}"), ast.unparse(node)


@page
def test_yaml_can_be_read(page: Path) -> None:
    for code in blocks(page, "yaml"):
        yaml.safe_load(code)
