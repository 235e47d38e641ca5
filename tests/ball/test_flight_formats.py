"""Files of flights in other units, axes, separators and programs: named, taken by option, or read as they come."""

import csv
import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imolo.ball.bounce import before_bounce
from imolo.ball.csv_format import LENGTHS, TIMES, UPS, CsvFormat
from imolo.ball.flight_file import read_flights, read_tracks
from imolo.errors import TrainingDataError

REAL = Path(__file__).parents[1] / "data" / "ball_flights" / "aimy_robot_simple_0-23.csv"
HEADER = ("flight", "time_s", "x_m", "y_m", "z_m")
TURNS = {"z": np.eye(3), "y": np.eye(3)[[1, 2, 0]], "x": np.eye(3)[[2, 0, 1]]}  # our axes into the file's
TRACKS = dict(list(read_tracks(REAL).items())[:2])
FLIGHTS = {name: before_bounce(track.time, track.position) for name, track in TRACKS.items()}


def as_in(up: str, position: np.ndarray) -> np.ndarray:
    flipped = position * [1.0, -1.0, -1.0] if up.startswith("-") else position
    return flipped @ TURNS[up[-1]].T


def write(path: Path, form: CsvFormat, header: tuple[str, ...] = HEADER) -> None:
    """Write real flights as somebody else would."""
    separator = {"tab": "\t"}.get(form.separator or ",", form.separator or ",")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=separator)
        writer.writerow(header)
        for name, track in TRACKS.items():
            position = as_in(form.up or "z", track.position) * LENGTHS[form.units or "m"]
            for time, place in zip(track.time * TIMES[form.time or "s"], position, strict=True):
                numbers = [f"{value:.9g}".replace(".", form.decimal or ".") for value in (time, *place)]
                writer.writerow([name, *numbers])


FORMATS = [
    CsvFormat(units=units if units != "m" else None, time=time if time != "s" else None, up=up if up != "z" else None)
    for units, time, up in sorted({*product(LENGTHS, TIMES, ["z"]), *product(["m"], ["s"], UPS), ("mm", "ms", "-y")})
]


def options(form: CsvFormat) -> str:
    given = {"--units": form.units, "--time": form.time, "--up": form.up}
    return " ".join(f"{name} {value}" for name, value in given.items() if value)


@pytest.mark.parametrize("form", FORMATS, ids=options)
def test_units_and_axes_are_named_by_how_the_balls_fall_and_taken_by_option(tmp_path: Path, form: CsvFormat) -> None:
    path = tmp_path / "f.csv"
    write(path, form)
    if form != CsvFormat():
        with pytest.raises(TrainingDataError) as caught:
            read_flights(path, 0.3)
        assert f"it looks like {options(form)}; give that" in str(caught.value)
        assert "\n" not in str(caught.value)
    flights = read_flights(path, 0.3, form).flights
    assert list(flights) == list(FLIGHTS)
    for name, flight in flights.items():
        # Nine digits of some metres and half a second.
        np.testing.assert_allclose(flight.time, FLIGHTS[name].time, atol=1e-8)
        np.testing.assert_allclose(flight.position, FLIGHTS[name].position, atol=1e-7)


def test_what_was_said_is_not_doubted(tmp_path: Path) -> None:
    path = tmp_path / "f.csv"
    write(path, CsvFormat(up="y"))
    said = CsvFormat(units="m", time="s", up="z")
    assert read_flights(path, 0.3, said).flights.keys() <= {"0", "1"}
    with pytest.raises(TrainingDataError, match="looks like --up y"):
        read_flights(path, 0.3, CsvFormat(units="m"))


@pytest.mark.parametrize(
    ("header", "parts", "said"),
    [
        (("flight", "time_ms", "x_mm", "y_mm", "z_mm"), "give --time ms --units mm", ("mm", "ms")),
        (("flight", "time_s", "x_mm", "y_mm", "z_mm"), "give --units mm", ("mm", "s")),
        (("Flight", "Time (ms)", "X [cm]", "Y [cm]", "Z [cm]"), "give --time ms --units cm", ("cm", "ms")),
        (("flight", "t", "x", "y", "z"), "give --time with one of s ms us ns --units with one of m cm mm", ("m", "s")),
    ],
)
def test_units_in_the_header_are_named_and_renaming_is_not_advised(
    tmp_path: Path, header: tuple[str, ...], parts: str, said: tuple[str, str]
) -> None:
    path = tmp_path / "f.csv"
    form = CsvFormat(units=said[0], time=said[1])
    write(path, form, header)
    with pytest.raises(TrainingDataError) as caught:
        read_tracks(path)
    assert parts in str(caught.value)
    assert "did you mean" not in str(caught.value)
    np.testing.assert_allclose(read_tracks(path, form)["0"].time, TRACKS["0"].time, atol=1e-8)


@pytest.mark.parametrize(
    "header",
    [
        ("Flight", "Time [s]", "X [m]", "Y [m]", "Z [m]"),
        ("flight", "t (sec)", "x (m)", "y (m)", "z (m)"),
        ("flight", "time_seconds", "x_meters", "y_metres", "z_m"),
    ],
)
def test_metres_and_seconds_by_other_names_are_read_as_they_come(tmp_path: Path, header: tuple[str, ...]) -> None:
    path = tmp_path / "f.csv"
    write(path, CsvFormat(), header)
    np.testing.assert_allclose(read_tracks(path)["0"].position, TRACKS["0"].position, atol=1e-7)


@pytest.mark.parametrize("said", [None, "m", "mm"])
def test_axes_in_different_units_are_refused(tmp_path: Path, said: str | None) -> None:
    path = tmp_path / "f.csv"
    write(path, CsvFormat(), ("flight", "time_s", "x_m", "y_m", "z_mm"))
    with pytest.raises(TrainingDataError, match="'x_m', 'y_m', 'z_mm' are in different units"):
        read_tracks(path, CsvFormat(units=said))


def test_separator_that_excel_names_in_the_first_line_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "f.csv"
    write(path, CsvFormat(separator=";"))
    path.write_text("sep=;\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    for form in (CsvFormat(), CsvFormat(separator=";")):
        np.testing.assert_allclose(read_tracks(path, form)["0"].position, TRACKS["0"].position, atol=1e-7)


def test_columns_between_spaces_are_told(tmp_path: Path) -> None:
    path = tmp_path / "f.csv"
    path.write_text(" ".join(HEADER) + "\n0 0.005 1.5 2.5 3.5\n", encoding="utf-8")
    with pytest.raises(TrainingDataError, match="parted by spaces; write it with commas"):
        read_tracks(path)


def test_blank_value_is_told_as_a_ball_that_was_not_seen(tmp_path: Path) -> None:
    path = tmp_path / "f.csv"
    path.write_text(",".join(HEADER) + "\n0,0.005,1.5,2.5,\n", encoding="utf-8")
    with pytest.raises(TrainingDataError, match="line 2: z_m is '', no finite number; leave samples out"):
        read_tracks(path)


@pytest.mark.parametrize("separator", [";", "tab", "|"])
@pytest.mark.parametrize("decimal", [".", ","])
def test_separators_and_decimal_commas_are_named_one_after_the_other_and_taken(
    tmp_path: Path, separator: str, decimal: str
) -> None:
    path = tmp_path / "f.csv"
    write(path, CsvFormat(separator=separator, decimal=decimal))
    with pytest.raises(TrainingDataError, match="it looks like --separator"):
        read_tracks(path)
    if decimal == ",":
        with pytest.raises(TrainingDataError, match="it looks like --decimal ,"):
            read_tracks(path, CsvFormat(separator=separator))
    tracks = read_tracks(path, CsvFormat(separator=separator, decimal=decimal))
    for name, track in tracks.items():
        np.testing.assert_allclose(track.position, TRACKS[name].position, atol=1e-7)


@pytest.mark.parametrize("row", ['"0"x,0.1,1,2,3', '0,"0.1"1,1,2,3', '"0,0.1,1,2,3'])
def test_text_beside_a_quote_or_a_quote_left_open_is_refused(tmp_path: Path, row: str) -> None:
    path = tmp_path / "f.csv"
    path.write_text(f"{','.join(HEADER)}\n{row}\n0,0.2,1,2,3\n", encoding="utf-8")
    with pytest.raises(TrainingDataError, match="is no CSV text"):
        read_tracks(path)


def test_decimal_commas_between_commas_are_told(tmp_path: Path) -> None:
    path = tmp_path / "f.csv"
    path.write_text(",".join(HEADER) + "\n0,0,005,1,5,2,5,3,5\n", encoding="utf-8")
    with pytest.raises(TrainingDataError, match="line 2: 9 values for 5 columns; with decimal commas"):
        read_tracks(path)


@pytest.mark.parametrize(("count", "advice"), [(6, "mend"), (8, "commas"), (10, "commas"), (11, "mend")])
def test_values_that_are_too_many_for_decimal_commas_are_told_as_that(tmp_path: Path, count: int, advice: str) -> None:
    path = tmp_path / "f.csv"
    path.write_text(f"{','.join(HEADER)}\n{','.join('1' * count)}\n", encoding="utf-8")
    with pytest.raises(TrainingDataError, match=f"line 2: {count} values for 5 columns; .*{advice}"):
        read_tracks(path)


@pytest.mark.parametrize(("text", "decimal"), [("1.234,5", ","), ("1_000", "."), ("1.5", ","), ("1,5", "."), ("", ",")])
def test_number_that_could_be_another_is_refused(tmp_path: Path, text: str, decimal: str) -> None:
    path = tmp_path / "f.csv"
    path.write_text(f"{';'.join(HEADER)}\n0;1;2;3;{text}\n", encoding="utf-8")
    with pytest.raises(TrainingDataError, match="line 2: z_m is"):
        read_tracks(path, CsvFormat(separator=";", decimal=decimal))


@pytest.mark.parametrize("wrong", [{"units": "inch"}, {"time": "min"}, {"up": "w"}, {"separator": "x"}])
def test_unknown_option_is_named_with_what_is_known(wrong: dict[str, str]) -> None:
    with pytest.raises(TrainingDataError, match="unknown --"):
        CsvFormat(**wrong)


# Motive's own export.


def write_motive(path: Path, units: str = "Meters", factor: float = 1.0, extra: bool = False) -> dict[str, np.ndarray]:
    """Write two throws of one marker, a marker that lies there, and a rigid body, y up; return the throws, z up."""
    throws = list(TRACKS.values())
    names = ["Ball", "Robot:Hand", "Robot"]
    kinds = ["Marker", "Marker", "Rigid Body"]
    spare = ["", ""] + ([""] if extra else [])

    def three(words: list[str]) -> list[str]:
        return [word for word in words for _ in range(3)]

    rows: list[list[str]] = [
        ["Format Version", "1.23", "Take Name", "Throws, May", "Export Frame Rate", "180", "Length Units", units]
        + (["Rotation Type"] if extra else []),
        [],
        ["", "Type", *spare[2:], *three(kinds)],
        ["", "Name", *spare[2:], *three(names)],
        ["", "ID", *spare[2:], *three(["1F", "2F", "3F"])],
        *([["", "Parent", *spare[2:], *[""] * 9]] if extra else []),
        [*spare, *["Position"] * 9],
        ["Frame", "Time (Seconds)", *(["TimeCode"] if extra else []), *["X", "Y", "Z"] * 3],
    ]
    start, frame = 0.0, 0
    for throw in throws:
        for time, place in zip(throw.time - throw.time[0] + start, as_in("y", throw.position) * factor, strict=True):
            seen = [f"{value:.6f}" for value in place] if frame != 3 else ["", "", ""]
            code = ["10:00:00:01"] if extra else []
            rows.append([str(frame), f"{time:.6f}", *code, *seen, "0.1", "0.2", "0.3", "1", "1", "1"])
            frame += 1
        start += float(np.ptp(throw.time)) + 5.0
    with path.open("w", newline="", encoding="utf-8-sig") as file:
        csv.writer(file).writerows(rows)
    return {"Ball": np.delete(throws[0].position, 3, axis=0), "Ball, 2": throws[1].position}


@pytest.mark.parametrize(
    ("units", "factor", "extra"), [("Meters", 1.0, False), ("Millimeters", 1000.0, True), ("Centimeters", 100.0, False)]
)
def test_export_of_motive_is_read_as_it_comes(tmp_path: Path, units: str, factor: float, extra: bool) -> None:
    path = tmp_path / "take.csv"
    throws = write_motive(path, units, factor, extra)
    tracks = read_tracks(path)
    # A rigid body would repeat its markers.
    assert tracks.keys() == {*throws, "Robot:Hand", "Robot:Hand, 2"}
    for name, position in throws.items():
        np.testing.assert_allclose(tracks[name].position, position, atol=1e-6)
    recorded = read_flights(path, 0.3)
    assert recorded.flights.keys() == throws.keys()
    assert recorded.left_out.keys() == {"Robot:Hand", "Robot:Hand, 2"}


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("Meters", "Furlongs", "length unit is 'Furlongs'; give --units"),
        ("Frame,Time", "Time,Frame", "no line with Frame,Time"),
        ("Position", "Rotation", "no positions of markers"),
        ("\n5,", "\n5,9", "do not rise"),
        ("0.1,0.2,0.3", "0.1,two,0.3", "'two' is no finite number"),
    ],
)
def test_damaged_export_of_motive_is_told_in_one_line(tmp_path: Path, old: str, new: str, part: str) -> None:
    path = tmp_path / "take.csv"
    write_motive(path)
    text = path.read_text(encoding="utf-8").replace("\r\n", "\n")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(TrainingDataError) as caught:
        read_tracks(path)
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


# Any file at all.

ROOM = """
import resource, sys
from pathlib import Path
from imolo.ball.flight_file import read_tracks
from imolo.errors import TrainingDataError
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (500 << 20),) * 2)
for path in sys.argv[1:]:
    try:
        read_tracks(Path(path))
    except TrainingDataError as error:
        print(error)
"""


def test_files_without_a_bound_are_refused_in_little_memory(tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.csv" for number in range(6)]
    header = ",".join(HEADER) + "\n"
    with paths[0].open("wb") as sparse:
        sparse.truncate(4 << 30)
    os.mkfifo(paths[1])
    paths[2].write_text("," * 20_000_000, encoding="utf-8")
    paths[3].write_text(header + "," * 20_000_000, encoding="utf-8")
    paths[4].write_text(header + '"\n",' * 5_000_000, encoding="utf-8")
    paths[5].write_text(header + '0,1,2,3,"' + "4" * 20_000_000, encoding="utf-8")
    ended = subprocess.run([sys.executable, "-c", ROOM, *paths], capture_output=True, text=True, check=True)
    said = ended.stdout.splitlines()
    assert len(said) == len(paths)
    assert all(str(path) in line and len(line) < 500 for path, line in zip(paths, said, strict=True))


@given(st.text(alphabet='flight,time_s,x_m\n\t;"0123.-eE ', max_size=200) | st.binary(max_size=200))
def test_any_content_is_read_or_refused_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, content: str | bytes
) -> None:
    path = tmp_path_factory.mktemp("csv") / "f.csv"
    for start in (b"", b",".join(name.encode() for name in HEADER) + b"\n", b"Format Version,1.23\n\n"):
        path.write_bytes(start + (content if isinstance(content, bytes) else content.encode()))
        said = ""
        try:
            read_tracks(path)
        except TrainingDataError as error:
            said = str(error)
        assert "\n" not in said
