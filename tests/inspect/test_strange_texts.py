"""Texts of others in logs: shown as they are, and obeyed by no spreadsheet, terminal, figure or browser."""

import csv
from pathlib import Path

import pytest
from command_line import Run
from recorded_trials import Recorded, write_events

from imolo.inspect.export import ExportFormat, export
from imolo.inspect.names import Names
from imolo.messaging import channels
from imolo.messaging.log_file import LogEvent, read_events
from imolo_msgs import robot_t, trial_event_t


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ("=1+1", "'=1+1"),
        ("+1", "'+1"),
        ("-1", "'-1"),
        ("@x", "'@x"),
        ("\t=x", "'\t=x"),
        ("\n=x", "'\n=x"),
        ("a=1", "a=1"),
        ("", ""),
    ],
)
def test_text_in_a_table_is_no_formula(tmp_path: Path, text: str, cell: str) -> None:
    event = trial_event_t()
    event.detail, event.event_position = text, [-1.0, 0.0, 0.0]
    path = write_events(tmp_path / "log", [LogEvent(0, -7, "TRIAL", event.encode(), 0)])
    (made,) = export(path, ExportFormat.CSV, tmp_path / "out")
    with made.open(newline="") as file:
        (row,) = csv.DictReader(file)
    # Numbers stay numbers.
    assert (row["detail"], row["event_position_0"], row["recorded_utime"]) == (cell, "-1.0", "-7")


def test_terminal_shows_control_characters_and_does_not_obey_them(tmp_path: Path, run: Run) -> None:
    event = trial_event_t()
    event.event = event.detail = "\x1b]0;title\x07\x1b[2J[red]x"
    path = write_events(tmp_path / "log\x1b[31m", [LogEvent(0, 7, "TRIAL", event.encode(), 0)])
    for arguments in (("top", path), ("export", path), ("export", path, "--trial", 3), ("view", path, "--html", "x")):
        _, output, errors = run(*arguments)
        assert "\x1b" not in output + errors
        assert "\x07" not in output + errors


@pytest.mark.parametrize("name", ["\x1b[31mknee", "\n\n", "x" * 5000, "右膝", "$knee_{", ""])
def test_joints_of_any_name_are_drawn(recorded: Recorded, tmp_path: Path, run: Run, name: str) -> None:
    """A figure with room for 5,000 letters takes minutes, and control characters no font has."""

    def renamed(event: LogEvent) -> LogEvent:
        if event.channel != channels.ROBOT:
            return event
        message = robot_t.decode(event.data)
        message.joint_name = [name] * len(message.joint_name)
        return event._replace(data=message.encode())

    path = write_events(tmp_path / "log", map(renamed, read_events(recorded.first)))
    assert run("plot", path, "TRUTH_ROBOT.joint_angle", "--out", "a.png")[::2] == (0, "")
    label = Names.of(path).label("TRUTH_ROBOT", "joint_angle", (0,))
    assert len(label) <= len("[]") + 40
    assert label.isprintable()


def test_view_shows_names_as_text(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is given to Markdown in viser runs the HTML that is in it."""
    import viser

    from imolo.view import viewer

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("Markdown of a log's names")

    legends: list[str] = []
    monkeypatch.setattr(viser.GuiApi, "add_markdown", refuse)
    monkeypatch.setattr(viser.GuiApi, "add_html", lambda _, content: legends.append(content))
    sessions = [
        viewer.RecordedSession(recorded.first, "<b>one</b>"),
        viewer.RecordedSession(recorded.second, "<img src=x>"),
    ]

    def stop(_: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        viewer.serve(sessions, 0, 1.0, stop)
    for session in sessions:
        session.close()
    (legend,) = legends
    assert "&lt;b&gt;one&lt;/b&gt;" in legend
    assert "&lt;img src=x&gt;" in legend
    assert "<img" not in legend
