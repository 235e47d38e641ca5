"""How a table lies on disk: one npz of plain arrays and a JSON header, with a checksum over both; no pickles."""

import hashlib
import io
import json
import math
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imolo.errors import TableFileError
from imolo.machine.files import open_bounded, whole_file

FORMAT = "imolo-table"
VERSION = 3  # 1 lacked hand_std; 2 knew theta = (k, t_w) alone
MOST_BYTES = 500_000_000  # of all arrays, and of the file; the tables of the shipped configs have up to 140,000,000
MOST_HEADER = 1_000_000  # [bytes]

# What zipfile, zlib and numpy raise on bytes that are not what they should be.
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)


def write_table_file(path: Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write a file that is either whole or not there.

    Args:
        path: Where to.
        header: JSON-able description.
        arrays: Arrays of numbers by name.

    Raises:
        TableFileError: The header is not JSON-able, or the file cannot be written.
    """
    try:
        text = json.dumps({"format": FORMAT, "version": VERSION, **header}, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise TableFileError(f"the origin of the table cannot be stored: {error}; give JSON-able values") from error
    content: dict[str, Any] = {"header": np.frombuffer(text.encode(), dtype=np.uint8), **arrays}
    checksum = np.frombuffer(_checksum(content), dtype=np.uint8)
    try:
        with whole_file(path) as file:
            np.savez_compressed(file, checksum=checksum, **content)
    except OSError as error:
        raise TableFileError(f"table file {path} cannot be written: {error.strerror or error}") from error


def read_table_file(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read and check a file.

    Args:
        path: The file.

    Returns:
        Its header and its arrays by name.

    Raises:
        TableFileError: The file cannot be read, is damaged, is no table or was written by an older or newer imolo.
    """
    try:
        file = open_bounded(path, MOST_BYTES)
    except OSError as error:
        raise TableFileError(f"table file {path} cannot be read: {error.strerror or error}") from error
    try:
        with file, zipfile.ZipFile(file) as archive:
            parts = _parts(archive)
            header = _read_array(archive, parts.pop("header"))
            # Before the arrays are unpacked, which may be large.
            description = _describe(path, header)
            content = {name: _read_array(archive, part) for name, part in parts.items()}
    except _DAMAGE as error:
        raise TableFileError(
            f"table file {path} is damaged or not an imolo table ({' '.join(str(error).split())}); build it again"
        ) from error
    checksum = content.pop("checksum").tobytes()
    if _checksum({"header": header, **content}) != checksum:
        raise TableFileError(f"table file {path} is damaged (its checksum differs); build it again")
    return description, content


def _describe(path: Path, header: NDArray[Any]) -> dict[str, Any]:
    """Return what the header says.

    Raises:
        TableFileError: It is that of something else, or of an older or newer imolo.
    """
    try:
        description: dict[str, Any] = json.loads(header.tobytes())
        is_table = description["format"] == FORMAT
        version = int(description["version"])
    except (LookupError, TypeError, ValueError, RecursionError):
        is_table = False
    if not is_table:
        raise TableFileError(f"{path} is an npz file but not an imolo table; give a file that LookupTable.save wrote")
    if version != VERSION:
        fix = "update imolo" if version > VERSION else "build it again"
        raise TableFileError(f"table file {path} has format version {version}, this imolo reads {VERSION}; {fix}")
    return description


def _parts(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Return the arrays of an archive by name, unread.

    Raises:
        ValueError: They are none of ours, or too large.
    """
    parts = {part.filename.removesuffix(".npy"): part for part in archive.infolist()}
    if not {"header", "checksum"} <= parts.keys():
        raise ValueError("it holds no header")
    if len(parts) < len(archive.infolist()):
        raise ValueError("it holds an array twice")
    if any(part.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for part in parts.values()):
        raise ValueError("it is not compressed as numpy does")
    if parts["header"].file_size > MOST_HEADER or sum(part.file_size for part in parts.values()) > MOST_BYTES:
        raise ValueError(f"it is larger than the {MOST_BYTES / 1e6:g} MB that are read")
    return parts


def _read_array(archive: zipfile.ZipFile, part: zipfile.ZipInfo) -> NDArray[Any]:
    """Unpack an array of numbers, and no more than it is said to have.

    Raises:
        ValueError: It is damaged, or its header is not that of what follows.
    """
    with archive.open(part) as packed:
        # Its sum is checked by this, so that numpy parses no damaged header.
        data = io.BytesIO(packed.read(part.file_size))
    read_header = (
        np.lib.format.read_array_header_1_0
        if np.lib.format.read_magic(data) == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read_header(data)
    if dtype.kind not in "biuf" or data.tell() + math.prod(shape) * dtype.itemsize != part.file_size:
        raise ValueError("it holds other arrays than its headers say")
    data.seek(0)
    array: NDArray[Any] = np.lib.format.read_array(data, allow_pickle=False)
    return array


def _checksum(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.data)
    return digest.digest()
