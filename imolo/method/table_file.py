"""How a table lies on disk: one npz of plain arrays and a JSON header, with a checksum over both; no pickles."""

import contextlib
import hashlib
import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imolo.errors import TableFileError

FORMAT = "imolo-table"
VERSION = 3  # 1 lacked hand_std; 2 knew theta = (k, t_w) alone

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
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            np.savez_compressed(file, checksum=checksum, **content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise TableFileError(f"table file {path} cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


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
        data = path.read_bytes()
    except OSError as error:
        raise TableFileError(f"table file {path} cannot be read: {error.strerror or error}") from error
    try:
        content = _unpack(data)
    except _DAMAGE as error:
        raise TableFileError(
            f"table file {path} is damaged or not an imolo table ({' '.join(str(error).split())}); build it again"
        ) from error
    header = content.pop("header")
    checksum = content.pop("checksum").tobytes()
    try:
        description = json.loads(header.tobytes())
        is_table = description["format"] == FORMAT
        version = int(description["version"])
    except (LookupError, TypeError, ValueError):
        is_table = False
    if not is_table:
        raise TableFileError(f"{path} is an npz file but not an imolo table; give a file that LookupTable.save wrote")
    if version > VERSION:
        raise TableFileError(
            f"table file {path} has format version {version}, this imolo reads {VERSION}; update imolo"
        )
    if version < VERSION:
        raise TableFileError(
            f"table file {path} has format version {version}, this imolo reads {VERSION}; build it again"
        )
    if _checksum({"header": header, **content}) != checksum:
        raise TableFileError(f"table file {path} is damaged (its checksum differs); build it again")
    return description, content


def _unpack(data: bytes) -> dict[str, NDArray[Any]]:
    # The sums inside the zip are checked first, so that numpy parses no damaged array header.
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        damaged = archive.testzip()
        if damaged is not None:
            raise zipfile.BadZipFile(f"bad checksum of {damaged}")
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        content = {name: archive[name] for name in archive.files}
    if not {"header", "checksum"} <= content.keys() or not all(isinstance(a, np.ndarray) for a in content.values()):
        raise ValueError("it holds no header")
    return content


def _checksum(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.digest()
