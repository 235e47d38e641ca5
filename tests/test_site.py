"""The reference of the site says everything: keys with their meaning, messages, commands, names of the contracts."""

import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import typer.main

import imolo.contracts
from imolo.command_line.main import app
from imolo.messaging.channels import CHANNELS
from tools.site import command_line, configuration, messages

ROOT = Path(__file__).parents[1]


def test_every_key_of_a_config_says_what_it_means() -> None:
    seen: set[configuration.Model] = set()
    for roots in configuration.chapters().values():
        for path, model in roots:
            list(configuration.models(path, model, seen))
    assert len(seen) > 40
    nameless = [
        f"{model.__name__}.{key}"
        for model in seen
        for key in model.model_fields
        if not configuration.meaning(model, key)
    ]
    assert nameless == []


def test_type_default_and_unit_of_a_key_are_shown() -> None:
    page = configuration.page()
    assert "| `timestep` | number > 0 and ≤ 0.005 | `0.0001` | s | of the engine, Sec. VI |" in page
    assert "| `until` | number or null | null | s |" in page
    assert "### motion.varied" in page
    assert "### simulation.thrower" in page
    assert "### simulation.actuators.motors" in page


def test_every_message_and_its_fields_are_shown() -> None:
    page = messages.page()
    for channel in CHANNELS.values():
        _, _, section = page.partition(f"## {channel.message_type.__name__}\n")
        section = section.partition("\n## ")[0]
        for field in channel.message_type.__slots__:
            assert f"| `{field}" in section, f"{channel.name}.{field}"


def test_every_command_and_its_options_are_shown() -> None:
    page = command_line.page()
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        assert f"## `imolo {name}`\n" in page
        for parameter in [one for one in command.params if not getattr(one, "hidden", False)]:
            assert any(option in page for option in parameter.opts), f"imolo {name} {parameter.name}"


def public_names(module: ModuleType) -> list[str]:
    """Return classes and functions that a module defines itself."""
    things = {name: thing for name, thing in vars(module).items() if callable(thing)}  # a TypeVar is not
    found = [name for name, thing in things.items() if getattr(thing, "__module__", "") == module.__name__]
    return [
        f"{module.__name__}.{name}" for name in found if not name.startswith("_") and inspect.getdoc(vars(module)[name])
    ]


@pytest.mark.slow
def test_site_is_built_without_a_warning_and_holds_every_public_name_of_the_contracts(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", ROOT / "docs", tmp_path]
    built = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert built.returncode == 0, built.stderr
    text = "".join(page.read_text(encoding="utf-8") for page in (tmp_path / "reference/api").glob("*.html"))
    package = imolo.contracts
    for found in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        for name in public_names(importlib.import_module(found.name)):
            assert f'id="{name}"' in text, name
