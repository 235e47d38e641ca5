"""Claims about the file of a table."""

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rough_tables import ROUGH, SHARP, TABLE, fitted, rough_table

from imolo.errors import TableFileError
from imolo.method import table_file
from imolo.method.forward_model import GPR, PAPER_SVR, ForwardModelConfig
from imolo.method.table import LookupTable
from imolo.method.table_file import VERSION


@pytest.fixture(scope="module")
def saved() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.npz"
        rough_table("voxel").save(path)
        return path.read_bytes()


def load(content: bytes, robot: str | None = None) -> LookupTable:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.npz"
        path.write_bytes(content)
        return LookupTable.load(path, robot)


def assert_same(a: LookupTable, b: LookupTable) -> None:
    for name in ("position", "time", "theta"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        np.testing.assert_array_equal(getattr(a.training, name), getattr(b.training, name))
    assert (a.grid, a.template, a.forward_model) == (b.grid, b.template, b.forward_model)
    assert (a.robot, a.origin) == (b.robot, b.origin)


def test_table_survives_its_file(saved: bytes) -> None:
    assert_same(load(saved, "testbot"), rough_table("voxel"))


@pytest.mark.parametrize("config", [PAPER_SVR, GPR])
def test_model_is_refitted_from_the_file(config: ForwardModelConfig, tmp_path: Path) -> None:
    model = fitted(config)
    LookupTable.build(model, ROUGH, np.random.default_rng(0), robot="testbot").save(tmp_path / "t.npz")
    again = LookupTable.load(tmp_path / "t.npz").refit()
    np.testing.assert_array_equal(
        again.predict(TABLE.theta[:50], TABLE.time[:50]), model.predict(TABLE.theta[:50], TABLE.time[:50])
    )


@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_truncated_file_is_refused(saved: bytes, data: st.DataObject) -> None:
    length = data.draw(st.integers(0, len(saved) - 1))
    with pytest.raises(TableFileError, match="damaged"):
        load(saved[:length])


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_file_with_flipped_bytes_is_refused_or_read_unharmed(saved: bytes, data: st.DataObject) -> None:
    # The directory of a zip file, its last kilobyte, is the part that carries no sum of its own.
    where = st.integers(0, len(saved) - 1) | st.integers(len(saved) - 1000, len(saved) - 1)
    content = bytearray(saved)
    for place in data.draw(st.lists(where, min_size=1, max_size=3, unique=True)):
        content[place] ^= data.draw(st.integers(1, 255))
    table, refusal = None, ""
    try:
        table = load(bytes(content))
    except TableFileError as error:
        refusal = str(error)
    assert "\n" not in refusal
    if table is not None:
        assert_same(table, rough_table("voxel"))


def test_table_for_another_robot_is_refused(saved: bytes) -> None:
    with pytest.raises(TableFileError, match="for robot 'testbot', not 'liberobot'"):
        load(saved, "liberobot")


def test_table_of_a_newer_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as newer:
        newer.setattr(table_file, "VERSION", VERSION + 1)
        TABLE.save(tmp_path / "t.npz")
    with pytest.raises(TableFileError, match=f"format version {VERSION + 1}, this imolo reads {VERSION}; update imolo"):
        LookupTable.load(tmp_path / "t.npz")


@pytest.mark.parametrize("version", range(1, VERSION))
def test_table_of_an_older_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: int) -> None:
    with monkeypatch.context() as older:
        older.setattr(table_file, "VERSION", version)
        TABLE.save(tmp_path / "t.npz")
    with pytest.raises(TableFileError, match=f"format version {version}, this imolo reads {VERSION}; build it again"):
        LookupTable.load(tmp_path / "t.npz")


def test_edited_number_is_noticed(tmp_path: Path) -> None:
    TABLE.save(tmp_path / "t.npz")
    with np.load(tmp_path / "t.npz") as archive:
        content = dict(archive)
    content["theta"] = content["theta"] + 0.01
    np.savez(tmp_path / "t.npz", **content)
    with pytest.raises(TableFileError, match="its checksum differs"):
        LookupTable.load(tmp_path / "t.npz")


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    header = np.frombuffer(json.dumps({"format": "other", "version": 1}).encode(), dtype=np.uint8)
    writers = {
        "not an imolo table": [
            lambda: path.write_text("hello"),
            lambda: np.savez(path, numbers=np.arange(3)),
            lambda: np.savez(path, header=header, checksum=header),
            lambda: np.savez(path, header=np.array([{}], dtype=object), checksum=header),
        ],
    }
    for named, writes in writers.items():
        for write in writes:
            write()
            with pytest.raises(TableFileError, match=named):
                LookupTable.load(path)


def test_unreadable_and_unwritable_places_are_named(tmp_path: Path) -> None:
    with pytest.raises(TableFileError, match="cannot be read: No such file"):
        LookupTable.load(tmp_path / "missing.npz")
    with pytest.raises(TableFileError, match="cannot be read: Is a directory"):
        LookupTable.load(tmp_path)
    with pytest.raises(TableFileError, match="cannot be written: No such file"):
        TABLE.save(tmp_path / "missing" / "t.npz")


def test_interrupted_save_leaves_the_old_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    path = tmp_path / "t.npz"
    rough_table("voxel").save(path)
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(TableFileError, match="No space left"):
        TABLE.save(path)
    assert_same(LookupTable.load(path), rough_table("voxel"))
    assert [file.name for file in tmp_path.iterdir()] == ["t.npz"]


def test_origin_that_is_not_json_is_refused(tmp_path: Path) -> None:
    for value in ({1, 2}, float("nan")):
        table = LookupTable.build(SHARP, ROUGH, np.random.default_rng(0), robot="testbot", origin={"value": value})
        with pytest.raises(TableFileError, match="origin"):
            table.save(tmp_path / "t.npz")
