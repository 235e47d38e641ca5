"""What the parts may know of each other: no module outside the robots names one, and no two import each other."""

import ast
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from imolo.contracts.registry import ROBOTS

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "imolo": ROOT / "imolo",
    "imolo_backends": ROOT / "backends" / "imolo_backends",
    "imolo_robots": ROOT / "backends" / "imolo_robots",
    "imolo_drivers": ROOT / "drivers" / "imolo_drivers",
}
TEMPLATES = PACKAGES["imolo"] / "scaffold" / "templates"


def modules() -> dict[str, Path]:
    """Return the file of each module of ours; what `imolo new` copies is none."""
    found = {}
    for package, folder in PACKAGES.items():
        for path in folder.rglob("*.py"):
            if TEMPLATES not in path.parents:
                parts = (package, *path.relative_to(folder).with_suffix("").parts)
                found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(body: list[ast.stmt]) -> Iterator[str]:
    """Yield what a file imports when it is loaded or only for its types; what functions import is not among it."""
    for node in body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            for alias in node.names:
                yield f"{node.module}.{alias.name}"
        elif isinstance(node, ast.If | ast.Try | ast.With):
            yield from imports([child for child in ast.walk(node) if isinstance(child, ast.Import | ast.ImportFrom)])


def graph(files: dict[str, Path]) -> dict[str, set[str]]:
    """Return which of the modules each of them imports."""
    found = {}
    for module, path in files.items():
        named = imports(ast.parse(path.read_text(encoding="utf-8")).body)
        nearest = (name if name in files else name.rpartition(".")[0] for name in named)
        found[module] = {name for name in nearest if name in files and name != module}
    return found


def test_no_modules_import_each_other_in_a_circle() -> None:
    found = graph(modules())
    assert sum(map(len, found.values())) > len(found) > 200
    TopologicalSorter(found).prepare()


def test_circle_for_types_alone_is_seen(tmp_path: Path) -> None:
    first, second = tmp_path / "first.py", tmp_path / "second.py"
    first.write_text("from a.second import two\n")
    second.write_text("if TYPE_CHECKING:\n    import a.first\n")
    with pytest.raises(CycleError):
        TopologicalSorter(graph({"a.first": first, "a.second": second})).prepare()


@pytest.mark.parametrize("package", ["imolo", "imolo_backends", "imolo_drivers"])
def test_no_file_outside_the_robots_names_a_robot(package: str) -> None:
    robots = re.compile("|".join(map(re.escape, {*ROBOTS.names(), "liberobot"})), re.IGNORECASE)
    files = [path for path in PACKAGES[package].rglob("*") if path.suffix in (".py", ".html", ".js")]
    assert len(files) > 15
    named = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in files
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if robots.search(line)
    ]
    assert named == []


def test_no_file_of_an_engine_has_more_than_230_lines() -> None:
    """What engines have in common is the framework's."""
    folder = PACKAGES["imolo_backends"] / "engines"
    lengths = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in folder.glob("*.py")}
    assert {"mujoco_engine.py", "pybullet_engine.py", "dart_engine.py", "ode_engine.py"} < lengths.keys()
    assert {name: length for name, length in lengths.items() if length > 230} == {}
