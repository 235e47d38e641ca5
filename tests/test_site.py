"""The site: its reference says everything, and its pages suit all eyes and a phone."""

import importlib
import inspect
import pkgutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path
from types import ModuleType

import pytest
import typer.main
from requirements import needs

import imolo.contracts
from imolo.command_line.main import app
from imolo.messaging.channels import CHANNELS
from tools.screens import Browser, browse
from tools.site import api, command_line, configuration, messages

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


def test_page_of_the_reference_is_never_gone_while_another_site_is_built(tmp_path: Path) -> None:
    """Sphinx looks for the pages first and reads them one after the other."""
    api.write(tmp_path)
    (tmp_path / "imolo.gone.md").write_text("# imolo.gone\n", encoding="utf-8")
    (page,) = tmp_path.glob("imolo.tasks.md")
    seen = []
    with ThreadPoolExecutor() as pool:
        other = pool.submit(api.write, tmp_path)
        while not other.done():
            seen.append("automodule:: imolo.tasks" in page.read_text(encoding="utf-8"))
        other.result()
    assert all(seen)
    assert not (tmp_path / "imolo.gone.md").exists()


def public_names(module: ModuleType) -> list[str]:
    """Return classes and functions that a module defines itself."""
    things = {name: thing for name, thing in vars(module).items() if callable(thing)}  # a TypeVar is not
    found = [name for name, thing in things.items() if getattr(thing, "__module__", "") == module.__name__]
    return [
        f"{module.__name__}.{name}" for name in found if not name.startswith("_") and inspect.getdoc(vars(module)[name])
    ]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the site, built without a warning."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", ROOT / "docs", folder]
    built = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.slow
def test_site_holds_every_public_name_of_the_contracts(site: Path) -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in (site / "reference/api").glob("*.html"))
    package = imolo.contracts
    for found in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        for name in public_names(importlib.import_module(found.name)):
            assert f'id="{name}"' in text, name


LOOK = """(async () => {
  const found = [], size = (element) => parseFloat(getComputedStyle(element).fontSize);
  const { scrollWidth, clientWidth } = document.documentElement;
  if (scrollWidth > clientWidth) found.push(`${scrollWidth} px wide`);
  for (const element of document.querySelectorAll("body *")) {
    const says = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    const small = says && element.getClientRects().length && size(element) < 9;
    if (small) found.push(`small: ${element.outerHTML.slice(0, 200)}`);
  }
  return found;
})()"""
AXE = """(async () => {
  const { violations } = await axe.run(document, %s);
  return violations
    .filter((one) => ["serious", "critical"].includes(one.impact))
    .map((one) => `${one.id}: ${one.nodes[0].html.slice(0, 200)}`);
})()"""
IN_LIGHT, IN_DARK = AXE % '{ resultTypes: ["violations"] }', AXE % '{ runOnly: ["color-contrast"] }'


@pytest.mark.slow
@pytest.mark.parametrize("mark", [pytest.param(None, marks=needs("chromium", "axe"))], ids=["axe"])
def test_every_page_is_accessible_and_fits_a_phone(site: Path, mark: None) -> None:
    """No serious finding of axe-core, in light or dark; at 390 px no text below 9 px, and no scrolling sideways."""
    axe = files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8")
    pages = sorted(site.rglob("*.html"))

    async def look(browser: Browser) -> dict[str, list[str]]:
        found = {}
        for page in pages:
            await browser.color_scheme("light")
            await browser.open(page)
            await browser.run(axe)
            said = await browser.run(LOOK) + await browser.run(IN_LIGHT)
            await browser.color_scheme("dark")
            found[str(page.relative_to(site))] = said + await browser.run(IN_DARK)
        return found

    found = browse(pages[0], 390, 844, look)
    assert len(found) > 60
    assert {page: said for page, said in found.items() if said} == {}
