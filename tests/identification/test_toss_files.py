"""Files of tosses: what is wrong with them is said in one line, with line and value."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_tosses import CUBE, cube_config, parabolas, rows, thrown, write

from imolo.errors import TrainingDataError
from imolo.identification.free_body import BodyConfig, digest, read_tosses

Table = list[dict[str, Any]]


def test_a_toss_survives_the_way_into_a_file_and_back(tmp_path: Path) -> None:
    tosses = thrown(cube_config(), number=2, duration=0.2)
    read = read_tosses(write(tmp_path / "tosses.csv", rows(tosses)))
    for one, other in zip(tosses, read, strict=True):
        for name in ("time", "position", "rotation", "velocity", "angular_velocity"):
            np.testing.assert_allclose(getattr(other, name), getattr(one, name), atol=1e-12)


def test_velocities_that_were_not_measured_are_those_of_the_first_two_frames(tmp_path: Path) -> None:
    table = [
        {key: value for key, value in row.items() if "_s" not in key[2:] or key == "time_s"}
        for row in rows(parabolas())
    ]
    tosses = read_tosses(write(tmp_path / "tosses.csv", table))
    for toss in tosses:
        np.testing.assert_allclose(toss.velocity, (toss.position[1] - toss.position[0]) / toss.time[1])


def without(name: str) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for row in table:
            del row[name]

    return change


def put(line: int, name: str, value: object) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        table[line - 2][name] = value  # the header is line 1

    return change


def rename(old: str, new: str) -> Callable[[Table], None]:
    def change(table: Table) -> None:
        for row in table:
            row[new] = row.pop(old)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("z_m"), "the column 'z_m' is not there"),
        (rename("z_m", "z_mm"), "did you mean 'z_mm'"),
        (without("vz_m_s"), "the column 'vz_m_s' is not there"),
        (put(5, "x_m", "nan"), "line 5: a value is not finite"),
        (put(5, "x_m", "inf"), "line 5: a value is not finite"),
        (put(5, "x_m", "abc"), "line 5: could not convert"),
        (put(5, "x_m", ""), "line 5: could not convert"),
        (put(5, "time_s", 0.0), "line 5: time_s 0 of toss '0' does not come after"),
        (put(5, "qw", 2.0), "a quaternion of toss '0' has the length 2"),
        (lambda table: table.__delitem__(slice(5, None)), "toss '0' has 5 frames; needed are 10"),
    ],
)
def test_a_fault_is_named_with_its_place(tmp_path: Path, change: Callable[[Table], None], message: str) -> None:
    table = rows(parabolas(number=2))
    change(table)
    with pytest.raises(TrainingDataError) as raised:
        read_tosses(write(tmp_path / "tosses.csv", table))
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the column 'toss' is not there"),
        (b"\xff\xfe\x00", "is no CSV text"),
        (b"toss,time_s,x_m,y_m,z_m,qw,qx,qy,qz\n", "holds no frames"),
    ],
)
def test_a_file_without_recordings_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "tosses.csv").write_bytes(content)
    with pytest.raises(TrainingDataError, match=message):
        read_tosses(tmp_path / "tosses.csv")


def test_a_missing_file_and_a_missing_toss_are_named(tmp_path: Path) -> None:
    with pytest.raises(TrainingDataError, match="cannot read the recordings"):
        read_tosses(tmp_path / "none.csv")
    path = write(tmp_path / "tosses.csv", rows(parabolas(number=2)))
    with pytest.raises(TrainingDataError, match="holds no toss '7'"):
        read_tosses(path, ["7"])


def test_the_digest_is_that_of_the_recordings_and_the_body(tmp_path: Path) -> None:
    tosses, urdf = parabolas(), tmp_path / "body.urdf"
    urdf.write_text("<robot/>", encoding="utf-8")
    others = [digest(parabolas(noise=1e-6)), digest(tosses, urdf)]
    assert digest(tosses) == digest(parabolas())
    assert digest(tosses) not in others


@pytest.mark.parametrize(
    "said", [{}, {"sides": (0.1, 0.1, 0.1)}, {"urdf": "a.urdf", "mass": 1.0}, {"urdf": "a.urdf", "inertia": (1, 1, 1)}]
)
def test_a_body_is_a_box_or_a_urdf(said: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="sides and mass of a box, or the urdf"):
        BodyConfig(**said)
    assert CUBE.mass == 0.4
