"""README and docs show of results what `make pages` wrote: no picture and no table that nobody knows the origin of."""

import re
import sys
from pathlib import Path
from typing import Any

import pytest
import typer.main
from PIL import Image, ImageSequence

from imolo.command_line.main import app

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))
import pages  # noqa: E402

MARKDOWN = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
COMMANDS: Any = typer.main.get_command(app)
TABLES = {block: table for name in pages.PAGES for block, table in pages.shown(name).tables.items()}


def test_every_page_says_where_its_results_come_from() -> None:
    assert {path.stem for path in pages.SHOWN.glob("*.json")} == set(pages.PAGES)
    for name in pages.PAGES:
        origin = pages.shown(name).origin
        assert origin.command.startswith("imolo ")
        assert re.match(r"[0-9a-f]{7,}", origin.commit)
        assert not origin.commit.endswith("-dirty")
        assert origin.machine


def test_every_picture_is_the_one_that_was_drawn_from_these_results() -> None:
    told = {picture: known for name in pages.PAGES for picture, known in pages.shown(name).pictures.items()}
    assert told == {path.name: pages.digest(path) for path in pages.IMAGES.iterdir()}
    assert set(told) == {picture for page in pages.PAGES.values() for picture in page.pictures}


@pytest.mark.parametrize("name", pages.PAGES)
def test_results_of_a_page_can_be_made_anew_by_the_command_that_made_them(name: str) -> None:
    _, command, *words = pages.shown(name).origin.command.split()
    COMMANDS.commands[command].make_context(command, list(words))  # refuses what it does not know
    for word in words:
        assert Path(word).suffix not in (".yaml", ".csv") or any((top / word).is_file() for top in (ROOT, pages.SHOWN))


def test_blocks_of_two_pages_have_different_names() -> None:
    names = [block for name in pages.PAGES for block in pages.shown(name).tables]
    assert len(names) == len(set(names))
    assert all(
        block.startswith(f"{name}-") for name in set(pages.PAGES) - {"demo"} for block in pages.shown(name).tables
    )


@pytest.mark.parametrize("path", sorted(pages.IMAGES.glob("*.gif")), ids=lambda path: path.stem)
def test_what_moves_comes_to_rest_within_five_seconds(path: Path) -> None:
    """WCAG 2.2.2; what repeats or moves for longer needs a button to stop it."""
    with Image.open(path) as picture:
        assert "loop" not in picture.info
        shown = [frame.info["duration"] for frame in ImageSequence.Iterator(picture)]
    assert len(shown) > 1
    assert sum(shown) <= 5000  # [ms]


@pytest.mark.parametrize("path", MARKDOWN, ids=lambda path: path.stem)
def test_tables_hold_the_numbers_of_the_results(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert pages.fill_blocks(text, TABLES) == text
    # A mark that is not closed would hold nothing, and say nothing.
    assert len(pages.BLOCK.findall(text)) == text.count("<!-- pages:") == text.count("<!-- /pages -->")


def test_readme_shows_the_comparison_and_pictures_of_the_same_results() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "<!-- pages:comparison -->" in text
    counted = {cell.strip("*") for row in TABLES["comparison"].rows for cell in row}
    assert set(re.findall(r"\b\d+/\d+\b", text)) <= counted
    assert {"report.png", "trajectories.png"} <= set(pages.shown("demo").pictures)


def test_changed_number_and_changed_picture_are_noticed(tmp_path: Path) -> None:
    block = "<!-- pages:comparison -->\n" + TABLES["comparison"].markdown() + "<!-- /pages -->"
    assert pages.fill_blocks(block, TABLES) == block
    assert pages.fill_blocks(block.replace("20/20", "19/20"), TABLES) == block
    picture = tmp_path / "report.png"
    picture.write_bytes((pages.IMAGES / "report.png").read_bytes() + b"\0")
    assert pages.digest(picture) != pages.shown("demo").pictures["report.png"]
