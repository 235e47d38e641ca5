"""Progress and tables as a terminal shows them, and a pipe."""

import subprocess
import sys
import threading

import pytest
import typer
from rich.console import Console
from rich.table import Table

from imolo.campaigns.summary import TABLE_STYLE
from imolo.command_line import terminal
from imolo.command_line.tables import fit

NUMBERS = ("123±44", "549036", "-0.005", "1.49-1.54")


def wide_table(columns: int) -> Table:
    table = Table(title="Many numbers", caption="What they are.", **TABLE_STYLE)
    table.add_column("backend", no_wrap=True)
    for index in range(columns):
        table.add_column(f"column {index}\nmm", justify="right")
    for row in range(4):
        table.add_row(f"engine{row}", *(NUMBERS[(row + index) % 4] for index in range(columns)))
    return table


def printed(table: Table, width: int) -> str:
    console = Console(width=width, force_terminal=False)
    with console.capture() as capture:
        console.print(fit(table, console))
    return capture.get()


@pytest.mark.parametrize("width", [40, 80, 120])
@pytest.mark.parametrize("columns", [3, 9, 20])
def test_table_leaves_columns_out_and_cuts_no_number(width: int, columns: int) -> None:
    output = printed(wide_table(columns), width)
    assert "…" not in output
    assert max(map(len, output.splitlines())) <= width
    first = next(line for line in output.splitlines() if line.strip().startswith("engine0"))
    shown = len(first.split()) - 1
    assert first.split() == ["engine0", *(NUMBERS[index % 4] for index in range(shown))]
    told = " ".join(output.split()).partition("Not shown, the terminal being")[2]
    assert all((f"column {index} mm" in told) == (index >= shown) for index in range(columns))


def test_table_that_has_the_room_is_left_as_it_is() -> None:
    console = Console(width=80, force_terminal=False)
    with console.capture() as capture:
        console.print(wide_table(3))
    assert printed(wide_table(3), 80) == capture.get()


def test_text_wraps_before_a_column_is_left_out() -> None:
    table = wide_table(4)
    table.add_column("about")
    table.columns[-1]._cells = ["a long text of many short words that goes on and on"] * 4
    output = printed(table, 80)
    assert "Not shown" not in output
    assert all(number in output for number in NUMBERS)


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the lines that are said where the output is no terminal, one every millisecond."""
    lines: list[str] = []
    monkeypatch.setattr(terminal, "PERIOD", 1e-3)
    monkeypatch.setattr(terminal, "console", Console(force_terminal=False))
    monkeypatch.setattr(terminal, "say", lines.append)
    return lines


def test_pipe_hears_how_far_things_are_though_none_of_them_ends(pipe: list[str]) -> None:
    came = threading.Event()

    class Lines(list[str]):
        def append(self, line: str) -> None:
            pipe.append(line)
            if pipe.count("dart 2/20, mujoco 7/35") == 3:
                came.set()

    terminal.say = Lines().append  # type: ignore[assignment]  # undone with the fixture
    with terminal.ProgressBars(lambda: "") as bars:
        bars.show("dart", 2, 20)
        bars.show("mujoco", 7, 35)
        assert came.wait(60.0)


def test_pipe_hears_at_the_end_how_far_things_came(pipe: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal, "PERIOD", 1e6)
    with terminal.ProgressBars(lambda: "") as bars:
        bars.show("dart", 19, 20)
        bars.show("dart", 20, 20)
    assert pipe == ["dart 20/20"]


def test_interruption_of_what_shows_progress_is_exit_code_130(
    pipe: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal, "errors", Console(stderr=True, width=80))
    with pytest.raises(typer.Exit) as ended, terminal.ProgressBars(lambda: "3 are kept"):
        raise KeyboardInterrupt
    assert ended.value.exit_code == 130
    assert capsys.readouterr().err == "imolo: interrupted; 3 are kept\n"


@pytest.mark.parametrize("kind", ["a line", "a status line", "a warning"])
def test_text_of_others_steers_no_terminal(kind: str) -> None:
    """A name that a program, a robot or a camera gives itself is quoted in lines of live programs and in warnings."""
    said = {
        "a line": "program.Console('test').say('\\x1b[2J')",
        "a status line": "program.TERMINAL_STATUS = 0.0; program.Console('test').status(lambda: '\\x1b[2J')",
        "a warning": "main.app = lambda: logging.getLogger('x').warning('%s', '\\x1b[2J'); main.main()",
    }[kind]
    code = f"import logging; from imolo.command_line import main; from imolo.live import program; {said}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stderr.rstrip().endswith(r"\x1b[2J")
