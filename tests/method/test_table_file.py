"""Claims about the file of a table."""

import io
import json
import os
import struct
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rough_tables import ROUGH, SHARP, TABLE, fitted, rough_table
from tries import tries

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


@settings(max_examples=tries(80), deadline=None)
@given(data=st.data())
def test_truncated_file_is_refused(saved: bytes, data: st.DataObject) -> None:
    length = data.draw(st.integers(0, len(saved) - 1))
    with pytest.raises(TableFileError, match="damaged"):
        load(saved[:length])


@settings(max_examples=tries(150), deadline=None)
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


@pytest.mark.parametrize("value", [float("nan"), float("inf"), {1}])
def test_origin_that_json_does_not_have_is_refused(value: object, tmp_path: Path) -> None:
    table = rough_table("voxel")
    table.origin["seed"] = value
    with pytest.raises(TableFileError, match=r"the origin of the table cannot be stored: .*; give JSON-able values"):
        table.save(tmp_path / "t.npz")
    assert list(tmp_path.iterdir()) == []


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


# Files that are made to be large.

BOUND = 300 << 20  # [bytes] of address space beyond what is there: far less than the bombs unpack to
LARGE = 600_000_000  # [bytes] unpacked; 600,000 packed
ROOM = """
import resource, sys
from imolo.errors import TableFileError
from imolo.method.table import LookupTable
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + {bound},) * 2)
from pathlib import Path
for path in sys.argv[1:]:
    try:
        LookupTable.load(Path(path))
    except TableFileError as error:
        print(error)
"""


def npy(shape: tuple[int, ...], data: bytes) -> bytes:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return header.getvalue() + data


def write_bomb(path: Path, header: bytes | None, shape: tuple[int, ...] = (LARGE // 8,), size: int = LARGE) -> None:
    """Write an npz whose array `theta` is said to have a shape and unpacks to so many zeros."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("header", "checksum") if header is not None else ():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.frombuffer(header, dtype=np.uint8))
            archive.writestr(f"{name}.npy", buffer.getvalue())
        with archive.open("theta.npy", "w", force_zip64=True) as member:
            member.write(npy(shape, b""))
            for _ in range(size >> 20):
                member.write(bytes(1 << 20))


def test_large_foreign_and_lying_files_are_refused_in_little_memory(tmp_path: Path) -> None:
    ours = json.dumps({"format": table_file.FORMAT, "version": table_file.VERSION}).encode()
    foreign = json.dumps({"format": "other", "version": 1}).encode()
    small = 64 << 20
    bombs = {
        "holds no header": (None, (LARGE // 8,), LARGE),
        "not an imolo table; give": (foreign, (small // 8,), small),
        "larger than the 500 MB": (ours, (LARGE // 8,), LARGE),
        "other arrays than its headers say": (ours, (10**15,), 1 << 20),
    }
    paths = []
    for number, (header, shape, size) in enumerate(bombs.values()):
        paths.append(tmp_path / f"{number}.npz")
        write_bomb(paths[-1], header, shape, size)
    # The directory of the archive says that it is small.
    lying = bytearray(paths[2].read_bytes())
    said = lying.rindex(b"theta.npy") - 46
    assert lying[said : said + 4] == b"PK\1\2"
    lying[said + 24 : said + 28] = struct.pack("<I", 1 << 20)
    paths.append(tmp_path / "lying.npz")
    paths[-1].write_bytes(lying)
    with (tmp_path / "sparse.npz").open("wb") as sparse:
        sparse.truncate(4 << 30)
    os.mkfifo(tmp_path / "pipe.npz")
    paths += [tmp_path / "sparse.npz", tmp_path / "pipe.npz"]
    ended = subprocess.run(
        [sys.executable, "-c", ROOM.format(bound=BOUND), *paths], capture_output=True, text=True, check=True
    )
    said_of = ended.stdout.splitlines()
    expected = [*bombs, "damaged or not an imolo table", "larger than the 500 MB", "a pipe or a device"]
    assert len(said_of) == len(expected)
    for line, part in zip(said_of, expected, strict=True):
        assert part in line


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_archive_that_numpy_did_not_write_is_refused(saved: bytes, tmp_path: Path, compression: int) -> None:
    with zipfile.ZipFile(io.BytesIO(saved)) as old, zipfile.ZipFile(tmp_path / "t.npz", "w", compression) as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
    with pytest.raises(TableFileError, match="not compressed as numpy does"):
        LookupTable.load(tmp_path / "t.npz")
